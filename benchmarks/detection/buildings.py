"""What stands above vehicles: buildings, trees, poles, and shadows of more of them."""

import cv2
import numpy as np
from numpy import ndarray as Array

from benchmarks.detection.scene import Scene, draw_ribs, get_noise, pick_colour, vary_colour
from benchmarks.detection.vehicles import Colour, get_corners

ROOFS: list[Colour] = [
    (160, 84, 60), (130, 62, 48), (120, 118, 116), (84, 84, 86), (180, 178, 174), (215, 214, 210),
    (96, 78, 66), (70, 100, 96), (110, 120, 132), (146, 128, 104), (60, 60, 62),
]  # fmt: skip


House = tuple[Array, float, Colour, float, tuple[float, float]]


def plan_house(scene: Scene) -> House | None:
    """Plan a building beside the vehicles, and cast its shadow."""
    g = scene.generator
    x, y = scene.pick_place(12)
    size = (g.uniform(6, 45), g.uniform(5, 20))
    heading = scene.grid + g.integers(2) * np.pi / 2 + g.normal(0, 0.03)
    points = get_corners(x, y, heading, *size)
    ground = cv2.convexHull(points.astype(np.float32))
    below = [v for v in scene.vehicles if cv2.pointPolygonTest(ground, (v.x, v.y), True) > -1.5]
    if len(below) > 0.3 * len(scene.vehicles):
        return None
    scene.vehicles = [v for v in scene.vehicles if v not in below]
    height = float(
        g.choice([g.uniform(2.5, 6), g.uniform(6, 22), g.uniform(20, 40)], p=[0.4, 0.5, 0.1])
    )
    scene.cast(scene.high_shadow, points, height)
    return points, height, ROOFS[g.integers(len(ROOFS))], heading, size


def draw_house(
    scene: Scene,
    points: Array,
    height: float,
    colour: Colour,
    heading: float,
    size: tuple[float, float],
) -> None:
    """Draw walls with windows, a roof, and what stands on it."""
    g, canvas, lean = scene.generator, scene.canvas, np.array(scene.canvas.lean)
    roof, wall = vary_colour(colour, g), vary_colour((178, 168, 152), g, 40)
    for k in range(4):
        a, b = points[k], points[(k + 1) % 4]
        tone = tuple(np.array(wall) * g.uniform(0.45, 1.05))
        canvas.fill(np.stack([a, b, b + lean * height, a + lean * height]), tone)
        for up in np.arange(1.2, height - 1, 3.0):  # windows
            for at in np.arange(1.0, np.hypot(*(b - a)) - 1, 2.6):
                p = a + (b - a) / np.hypot(*(b - a)) * at
                q = p + (b - a) / np.hypot(*(b - a)) * 1.3
                low, high = lean * up, lean * (up + 1.5)
                canvas.fill(np.stack([p + low, q + low, q + high, p + high]), (52, 58, 66))
    both = np.concatenate([points, points + lean * height]).astype(np.float32)
    hull = canvas.convert(cv2.convexHull(both)[:, 0])
    cv2.fillPoly(scene.cover, [hull], 255, cv2.LINE_AA, 4)
    canvas.fill(points, roof, height)
    middle = points.mean(0)
    pitched = g.uniform() < 0.5
    if pitched:
        x, y = middle + size[1] / 4 * np.array([-np.sin(heading), np.cos(heading)])
        half = get_corners(x, y, heading, size[0], size[1] / 2)
        canvas.fill(half, tuple(np.clip(np.array(roof) * g.uniform(0.6, 1.3), 0, 255)), height)
    if g.uniform() < 0.5:
        step = np.pi / 2 if g.uniform() < 0.5 and size[1] < size[0] else 0
        draw_ribs(
            scene,
            (*middle, heading + step, *(size if not step else size[::-1])),
            height,
            tuple(np.array(roof) * g.uniform(0.75, 1.1)),
        )
    for _ in range(g.integers(0, 14)):  # chimneys, skylights, dormers, machines, cells
        side = np.array([g.uniform(-0.45, 0.45) * size[0], g.uniform(-0.42, 0.42) * size[1]])
        c, s = np.cos(heading), np.sin(heading)
        at = side @ np.array([[c, s], [-s, c]]) + middle
        long, wide = g.uniform(0.4, 1.6), g.uniform(0.4, 1.4)
        if g.uniform() < 0.4:  # as large as cars
            long, wide = g.permutation([g.uniform(2.5, 6), g.uniform(1.2, 2.6)])
        in_row = g.uniform() < 0.4
        number, gap = (int(g.integers(2, 10)), long * g.uniform(1.05, 2)) if in_row else (1, 0)
        tone, up, seamed = pick_colour(g), g.uniform(0, 1.5), g.uniform() < 0.25
        for k in range(number):
            place = at + k * gap * np.array([c, s])
            x, y = place.tolist()
            if cv2.pointPolygonTest(points.astype(np.float32), (x, y), False) < 0:
                continue
            sun = np.array(canvas.sun) * up * 0.5
            shadow = get_corners(x + sun[0], y + sun[1], heading, long, wide)
            if scene.shade > 0.2:
                canvas.fill(shadow, tuple(np.array(roof) * 0.5), height)
            box = get_corners(x, y, heading, long, wide)
            if up > 0.4:
                canvas.fill_hull(
                    np.r_[box + lean * height, box + lean * (height + up)],
                    tuple(np.array(tone) * 0.6),
                )
            canvas.fill(box, tone, height + up)
            if seamed:
                tones = tuple(np.array(tone) * g.uniform(0.4, 0.9))
                draw_ribs(scene, (*place, heading + np.pi / 2, wide, long), height + up, tones)
    if g.uniform() < 0.5:
        line = [canvas.convert(points, height)]
        cv2.polylines(
            canvas.image, line, True, pick_colour(g), int(g.integers(1, 5)), cv2.LINE_AA, 4
        )
    left, top, across, down = cv2.boundingRect(canvas.convert(points, height) // 16)
    part = np.s_[max(top, 0) : max(top + down, 0), max(left, 0) : max(left + across, 0)]
    if canvas.image[part].size:  # grain, on the roof's bounds: some of the ground gets it too
        noise = get_noise(canvas.image.shape[0], g)[part][..., None] * g.uniform(2, 9)
        canvas.image[part] = np.clip(canvas.image[part] + noise, 0, 255)


def plan_tree(scene: Scene) -> tuple[float, float, float, float] | None:
    """Plan a crown, a few of them over the rims of vehicles, and cast its shadow."""
    g = scene.generator
    radius, height = g.uniform(0.6, 5), g.uniform(2, 12)
    x, y = scene.pick_place(4)
    if scene.vehicles and g.uniform() < 0.3:
        v = scene.vehicles[g.integers(len(scene.vehicles))]
        turn, far = g.uniform(0, 2 * np.pi), radius + g.uniform(0.0, 2.4)
        x, y = v.x + np.cos(turn) * far, v.y + np.sin(turn) * far
    elif any(np.hypot(v.x - x, v.y - y) < radius + 1 for v in scene.vehicles):
        return None
    turns = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    rim = np.stack([np.cos(turns), np.sin(turns)], 1) * radius * g.uniform(0.75, 1.1, (14, 1))
    scene.cast(
        scene.high_shadow, rim + [x, y] + np.array(scene.canvas.sun) * height * 0.6, height * 0.4
    )
    return x, y, radius, height


def cast_from_beyond(scene: Scene) -> None:
    """Cast shadows of towers, crowns and poles that stand outside of the picture."""
    g = scene.generator
    for _ in range(g.choice([0, 1, 3], p=[0.5, 0.3, 0.2])):
        x, y = scene.pick_place()
        points = get_corners(x, y, scene.pick_angle(), g.uniform(6, 60), g.uniform(5, 30))
        cv2.fillPoly(scene.high_shadow, [scene.canvas.convert(points)], 255, cv2.LINE_AA, 4)
    for _ in range(g.choice([0, 4, 15], p=[0.5, 0.3, 0.2])):  # crowns: clumps
        x, y = scene.pick_place()
        for spot in g.normal(0, g.uniform(0.6, 2), (12, 2)):
            at = scene.canvas.convert(np.array([[x, y]]) + spot)[0]
            radius = int(g.uniform(0.3, 1.2) * scene.canvas.scale * 16)
            cv2.circle(scene.high_shadow, at, radius, 255, -1, cv2.LINE_AA, 4)


def draw_tree(scene: Scene, x: float, y: float, radius: float, height: float) -> None:
    """Draw a crown as clumps of leaves, brighter towards the sun; or bare branches."""
    g, canvas = scene.generator, scene.canvas
    sun = np.array(canvas.sun) / max(np.hypot(*canvas.sun), 1e-6)
    base = np.array(
        [(62, 82, 42), (84, 98, 50), (46, 66, 40), (120, 110, 50), (96, 84, 66)][g.integers(5)],
        float,
    )
    base = base * g.uniform(0.6, 1.3)
    clumps = int(12 + 6 * radius**1.5)
    turns, far = g.uniform(0, 2 * np.pi, clumps), radius * np.sqrt(g.uniform(0, 1, clumps))
    spots = np.stack([np.cos(turns), np.sin(turns)], 1) * far[:, None]
    order = np.argsort(-far)
    for spot in spots[order]:
        light = 0.8 - 0.35 * (spot @ sun) / radius + g.normal(0, 0.15)
        tone = np.clip(base * max(light, 0.25), 0, 255)
        size = g.uniform(0.12, 0.32) * radius + 0.2
        at = canvas.convert((np.array([[x, y]]) + spot), height)[0]
        r = int(size * canvas.scale * 16)
        cv2.circle(canvas.image, at, r, tone.tolist(), -1, cv2.LINE_AA, 4)
        cv2.circle(scene.cover, at, r, 255, -1, cv2.LINE_8, 4)


def draw_pole(scene: Scene) -> None:
    """Draw a lamp, a sign or wires above all."""
    g, canvas = scene.generator, scene.canvas
    x, y = scene.pick_place()
    high, lean = g.uniform(4, 10), np.array(canvas.lean)
    arm = np.array([np.cos(scene.grid), np.sin(scene.grid)]) * g.uniform(0.5, 3)
    tone = (200, 200, 200) if g.uniform() < 0.6 else (60, 60, 62)
    path = np.stack([[x, y], np.array([x, y]) + lean * high, np.array([x, y]) + lean * high + arm])
    cv2.polylines(canvas.image, [canvas.convert(path)], False, tone, 1, cv2.LINE_AA, 4)
