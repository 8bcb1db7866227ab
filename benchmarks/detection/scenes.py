"""Streets drawn from above, with truth: grounds, roads, vehicles, clutter, buildings, trees."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from benchmarks.detection.buildings import (
    cast_from_beyond,
    draw_house,
    draw_pole,
    draw_tree,
    plan_house,
    plan_tree,
)
from benchmarks.detection.clutter import (
    draw_bars,
    draw_block,
    draw_cycle,
    draw_flat,
    draw_person,
    draw_wall,
)
from benchmarks.detection.roads import add_vehicle, draw_lot, draw_roads, park_row, shade_vehicle
from benchmarks.detection.scene import GROUNDS, Scene, get_noise, vary_colour
from benchmarks.detection.vehicles import draw_vehicle, get_corners


def draw_scene(
    pixels: int, resolution: float, generator: np.random.Generator
) -> tuple[UInt8[Array, "N N 3"], Float[Array, "M 5"], Float[Array, " M"]]:
    """Draw a square scene.

    Args:
        pixels: side of the picture.
        resolution: metres per pixel.
        generator: source of all choices.

    Returns:
        RGB; vehicles (u, v, heading clockwise from right, length, width; pixels); the share of
        each that is hidden.
    """
    g = generator
    scene = Scene(pixels, resolution, g)
    _draw_ground(scene)
    if g.uniform() < 0.9:
        draw_roads(scene)
    if g.uniform() < 0.35:
        draw_lot(scene)
    for _ in range(g.integers(0, 4)):
        park_row(scene)
    for _ in range(g.integers(0, 5)):
        x, y = scene.pick_place()
        add_vehicle(scene, x, y, scene.pick_angle())
    drawings = [draw_flat, draw_block, draw_bars, draw_wall, draw_person, draw_cycle]
    if g.uniform() < 0.5:  # a quiet hour
        share = g.uniform(0, 0.8)
        scene.vehicles = [v for v in scene.vehicles if g.uniform() > share]
    for _ in range(int(g.choice([5, 20, 45]))):
        drawings[g.choice(len(drawings), p=[0.25, 0.25, 0.12, 0.13, 0.2, 0.05])](scene)
    number = int(g.choice([0, 1, 3, 6], p=[0.25, 0.3, 0.3, 0.15]))
    houses = [plan_house(scene) for _ in range(number)]
    for vehicle in scene.vehicles:
        shade_vehicle(scene, vehicle)
    scene.darken(scene.low_shadow, 1.0)
    for vehicle in scene.vehicles:
        draw_vehicle(scene.canvas, vehicle, g)
    trees = [
        plan_tree(scene) for _ in range(int(g.choice([0, 3, 10, 25], p=[0.25, 0.3, 0.3, 0.15])))
    ]
    cast_from_beyond(scene)
    scene.darken(scene.high_shadow, g.uniform(0.8, 2.5))
    for tree in trees:
        if tree is not None:
            draw_tree(scene, *tree)
    for house in houses:
        if house is not None:
            draw_house(scene, *house)
    for _ in range(g.integers(0, 5)):
        draw_pole(scene)
    return _finish(scene)


def _finish(scene: Scene) -> tuple[Array, Array, Array]:
    rows, hidden = [], []
    for v in scene.vehicles:
        x, y = np.array([v.x, v.y]) + np.array(scene.canvas.lean) * v.height / 2
        if min(x, y) > -v.length and max(x, y) < scene.side + v.length:
            rows.append([x, y, v.heading, v.length, v.width])
            mask = np.zeros_like(scene.cover)
            corners = get_corners(x, y, v.heading, v.length, v.width)
            cv2.fillConvexPoly(mask, scene.canvas.convert(corners), 255, cv2.LINE_8, 4)
            left, top, wide, high = cv2.boundingRect(scene.canvas.convert(corners) // 16)
            box = np.s_[max(top, 0) : max(top + high, 0), max(left, 0) : max(left + wide, 0)]
            inside = mask[box] > 0
            hidden.append(scene.cover[box][inside].mean() / 255 if inside.any() else 0.0)
    size = (scene.pixels, scene.pixels)
    image = cv2.resize(scene.canvas.image, size, interpolation=cv2.INTER_AREA)
    scale = np.array([1, 1, scene.resolution, 1, 1]) / scene.resolution
    return image, np.array(rows).reshape(-1, 5) * scale, np.array(hidden)


def _draw_ground(scene: Scene) -> None:
    g, canvas = scene.generator, scene.canvas
    size = canvas.image.shape[0]
    amount = np.zeros((size, size), np.uint8)
    colour, vary = GROUNDS[g.integers(len(GROUNDS))]
    canvas.image[:] = np.array(vary_colour(colour, g))
    amount[:] = int(vary)
    for _ in range(g.integers(1, 7)):
        colour, vary = GROUNDS[g.integers(len(GROUNDS))]
        x, y = scene.pick_place(5)
        if g.uniform() < 0.6:
            long, wide = g.uniform(4, 60), g.uniform(3, 35)
            points = get_corners(x, y, scene.pick_angle(), long, wide)
        else:
            turn = np.sort(g.uniform(0, 2 * np.pi, 9))
            far = g.uniform(3, 25) * g.uniform(0.6, 1.2, (9, 1))
            points = np.stack([np.cos(turn), np.sin(turn)], 1) * far + [x, y]
        canvas.fill(points, vary_colour(colour, g))
        cv2.fillPoly(amount, [canvas.convert(points)], int(vary), cv2.LINE_8, 4)
        if g.uniform() < 0.4:  # a kerb
            tone = vary_colour((175, 172, 166), g)
            thick = int(g.integers(1, 4))
            cv2.polylines(canvas.image, [canvas.convert(points)], True, tone, thick, cv2.LINE_AA, 4)
        if g.uniform() < 0.25:
            _pave(scene, points)
    field: Array = get_noise(size, g)[..., None] * amount[..., None]
    tinted = field * (1 + g.normal(0, 0.1, 3).astype(np.float32))
    canvas.image[:] = np.clip(canvas.image + tinted, 0, 255)


def _pave(scene: Scene, points: Array) -> None:
    """Draw lines of slabs, stalls of paving or furrows over a polygon."""
    g, canvas = scene.generator, scene.canvas
    mask = np.zeros(canvas.image.shape[:2], np.uint8)
    cv2.fillPoly(mask, [canvas.convert(points)], 255, cv2.LINE_8, 4)
    lines = canvas.image.copy()
    step, way, both = g.uniform(0.6, 4), scene.pick_angle(), g.uniform() < 0.6
    middle, reach = points.mean(0), scene.side
    tone = vary_colour((int(g.choice([60, 120, 190])),) * 3, g)
    for turn in (0, np.pi / 2)[: 1 + both]:
        c, s = np.cos(way + turn), np.sin(way + turn)
        for at in np.arange(-30, 30, step):
            ends = (
                middle + at * np.array([-s, c]) + np.array([[-1], [1]]) * reach * np.array([c, s])
            )
            first, last = canvas.convert(ends)
            cv2.line(lines, first, last, tone, 1, cv2.LINE_AA, 4)
    mixed = cv2.addWeighted(canvas.image, 0.6, lines, 0.4, 0)
    canvas.image[mask > 0] = mixed[mask > 0]
