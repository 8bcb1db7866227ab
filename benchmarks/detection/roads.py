"""Roads with marks and traffic, parking lots and rows of parked cars."""

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.detection.scene import ROADS, Scene, get_noise, vary_colour
from benchmarks.detection.vehicles import Colour, Vehicle, get_corners, make_vehicle


def draw_roads(scene: Scene) -> None:
    """Draw one to three roads with lanes, kerbs and marks, and traffic on them."""
    g = scene.generator
    colour = ROADS[g.integers(len(ROADS))]
    roads = []
    for k in range(g.choice([1, 2, 3], p=[0.5, 0.4, 0.1])):
        way = scene.grid + k * np.pi / 2 + (g.normal(0, 0.2) if k else 0)
        bend = g.normal(0, 0.012) if g.uniform() < 0.4 else 0.0
        lanes = int(g.integers(1, 5)) + (g.uniform() < 0.7)
        roads.append((scene.pick_place(-10), way, bend, lanes, g.uniform(2.8, 3.7)))
    lines = [_trace(*road[:3]) for road in roads]
    for line, (*_, lanes, wide) in zip(lines, roads, strict=True):
        half = lanes * wide / 2 + g.uniform(0.2, 2.8)
        tone = vary_colour((170, 168, 162), g)
        walk = g.uniform(0, 4) if g.uniform() < 0.6 else 0.3
        _draw_strip(scene, line, half + walk, vary_colour((150, 148, 143), g))
        _draw_strip(scene, line, half + 0.2, tone)
    for line, (*_, lanes, wide) in zip(lines, roads, strict=True):
        half = lanes * wide / 2 + 0.2
        _draw_strip(scene, line, half, vary_colour(colour, g, 4))
    noise = get_noise(scene.canvas.image.shape[0], g)[..., None] * g.uniform(1, 5)
    scene.canvas.image[:] = np.clip(scene.canvas.image + noise, 0, 255)
    _draw_patches(scene, colour)
    for line, road in zip(lines, roads, strict=True):
        _mark_road(scene, line, road[3], road[4])
    for line, road in zip(lines, roads, strict=True):
        _fill_road(scene, line, road[3], road[4])


def _trace(start: Array, way: float, bend: float) -> Float[Array, "N 3"]:
    """Trace a road both ways from a place: x, y and way at every metre."""
    s = np.arange(-70.0, 71.0)
    turn = way + bend * s
    xy = np.cumsum(np.stack([np.cos(turn), np.sin(turn)], 1), axis=0)
    return np.c_[xy - xy[70] + start, turn]


def _offset(line: Array, by: float) -> Array:
    return line[:, :2] + by * np.stack([-np.sin(line[:, 2]), np.cos(line[:, 2])], 1)


def _draw_strip(scene: Scene, line: Array, half: float, colour: Colour) -> None:
    scene.canvas.fill(np.concatenate([_offset(line, -half), _offset(line, half)[::-1]]), colour)


def _draw_patches(scene: Scene, colour: Colour) -> None:
    """Draw mended asphalt, dark tracks, oil, covers and puddles."""
    g, canvas = scene.generator, scene.canvas
    for _ in range(g.integers(0, 10)):
        x, y = scene.pick_place()
        points = get_corners(x, y, scene.pick_angle(), g.uniform(0.6, 12), g.uniform(0.5, 3))
        canvas.fill(points, vary_colour(colour, g, 10))
    for _ in range(g.integers(0, 12)):
        x, y = scene.pick_place()
        radius = (g.uniform(0.25, 0.5), g.uniform(0.25, 1.2))
        turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        points = np.stack([x + np.cos(turn) * radius[0], y + np.sin(turn) * radius[1]], 1)
        canvas.fill(points, vary_colour((55, 55, 56), g))


def _mark_road(scene: Scene, line: Array, lanes: int, wide: float) -> None:
    """Draw lane lines, a stop line, stripes of a crossing, arrows and letters."""
    g, canvas = scene.generator, scene.canvas
    if g.uniform() < 0.15:
        return
    white = vary_colour((228, 228, 224), g) if g.uniform() < 0.85 else (215, 175, 70)
    for k in range(lanes + 1):
        by = (k - lanes / 2) * wide
        if g.uniform() < 0.85:
            edge = k in (0, lanes) or g.uniform() < 0.3
            points = _offset(line, by)
            dash, gap = (200, 0) if edge else (int(g.integers(2, 6)), int(g.integers(2, 9)))
            for at in range(0, len(points) - 1, dash + gap):
                part = points[at : at + dash + 1]
                thick = 1 if g.uniform() < 0.5 else 2
                cv2.polylines(
                    canvas.image, [canvas.convert(part)], False, white, thick, cv2.LINE_AA, 4
                )
    at = int(g.integers(20, 120))
    x, y, way = line[at]
    across = np.array([-np.sin(way), np.cos(way)])
    if g.uniform() < 0.4:  # a crossing
        deep = g.uniform(2.5, 5)
        for by in np.arange(-lanes * wide / 2, lanes * wide / 2, g.uniform(0.8, 1.3)):
            cx, cy = np.array([x, y]) + across * (by + 0.4)
            canvas.fill(get_corners(cx, cy, way, deep, 0.5), white)
    if g.uniform() < 0.5:
        canvas.fill(get_corners(x, y, way + np.pi / 2, lanes * wide, 0.4), white)
    for _ in range(g.integers(0, 6)):
        px, py, pw = line[g.integers(10, 130)]
        side = (g.integers(lanes) - lanes / 2 + 0.5) * wide
        cx, cy = px - np.sin(pw) * side, py + np.cos(pw) * side
        if g.uniform() < 0.6:  # an arrow
            canvas.fill(get_corners(cx, cy, pw, 3, 0.25), white)
            head = np.array([[1.4, -0.5], [2.6, 0], [1.4, 0.5]]) * g.choice([-1, 1])
            c, s = np.cos(pw), np.sin(pw)
            canvas.fill(head @ np.array([[c, s], [-s, c]]) + [cx, cy], white)
        else:  # letters
            for step in np.arange(-1, 1.1, 0.5):
                q = get_corners(
                    cx, cy + 0.3 * step, pw + g.choice([0, np.pi / 2]), g.uniform(1, 3), 0.2
                )
                canvas.fill(q, white)


def _fill_road(scene: Scene, line: Array, lanes: int, wide: float) -> None:
    """Put traffic on the lanes of a road, and perhaps parked rows along its kerbs."""
    g = scene.generator
    one_way = g.uniform() < 0.2
    parked = [g.uniform() < 0.3, g.uniform() < 0.3]
    length = len(line) - 1
    for k in range(lanes):
        by = (k - lanes / 2 + 0.5) * wide
        at_kerb = (k == 0 and parked[0]) or (k == lanes - 1 and parked[1])
        turn = np.pi if not one_way and k < lanes / 2 else 0.0
        queue = g.uniform() < 0.35 or at_kerb
        empty = g.uniform() < 0.25 and not at_kerb
        at = g.uniform(0, 12)
        while at < length and not empty:
            x, y, way = line[int(at)] + (line[min(int(at) + 1, length)] - line[int(at)]) * (at % 1)
            if at_kerb:
                by_kerb = by + (-1 if k == 0 else 1) * (wide / 2 - 1.1)
                turn = np.pi * g.integers(2)
                place = by_kerb + g.normal(0, 0.15)
            else:
                place = by + g.normal(0, 0.25)
            heading = (
                way + turn + g.normal(0, 0.03) + (g.normal(0, 0.2) if g.uniform() < 0.05 else 0)
            )
            long = add_vehicle(scene, x - np.sin(way) * place, y + np.cos(way) * place, heading)
            at += long + (g.uniform(0.6, 3.5) if queue else g.uniform(4, 45))


def add_vehicle(scene: Scene, x: float, y: float, heading: float, small: bool = False) -> float:
    """Add a vehicle where it overlaps no other one; returns the length of what was tried."""
    new = make_vehicle(x, y, heading, scene.generator)
    while small and new.length > 5.4:
        new = make_vehicle(x, y, heading, scene.generator)
    corners = get_corners(x, y, heading, new.length + 0.3, new.width + 0.25)
    for old in scene.vehicles:
        if np.hypot(old.x - x, old.y - y) < (old.length + new.length) / 2:
            other = get_corners(old.x, old.y, old.heading, old.length, old.width)
            if (
                cv2.intersectConvexConvex(corners.astype(np.float32), other.astype(np.float32))[0]
                > 0
            ):
                return new.length
    scene.vehicles.append(new)
    return new.length


def park_row(scene: Scene) -> None:
    """Park a row of cars, side by side, oblique, or one behind the other."""
    g = scene.generator
    x, y = scene.pick_place()
    way = scene.pick_angle()
    turn = g.choice([0, np.pi / 2, np.pi / 3, np.pi / 4], p=[0.3, 0.5, 0.1, 0.1])
    gap = g.uniform(5.2, 6.6) if turn == 0 else g.uniform(2.25, 3.0) / np.sin(turn)
    for k in range(g.integers(2, 14)):
        if g.uniform() < 0.85:
            spot = np.array([x, y]) + k * gap * np.array([np.cos(way), np.sin(way)])
            heading = way + turn + np.pi * g.integers(2) + g.normal(0, 0.03)
            add_vehicle(scene, spot[0], spot[1], heading, small=True)


def draw_lot(scene: Scene) -> None:
    """Draw a parking lot with lines of stalls, half full."""
    g, canvas = scene.generator, scene.canvas
    origin, way = scene.pick_place(-8), scene.pick_angle()
    c, s = np.cos(way), np.sin(way)
    axes = np.array([[c, s], [-s, c]])
    stalls, rows = int(g.integers(5, 16)), int(g.integers(1, 4))
    wide, deep, aisle = g.uniform(2.3, 2.8), g.uniform(4.7, 5.4), g.uniform(5.5, 7)
    size = np.array([stalls * wide + 4, rows * (2 * deep + aisle)])
    x, y = size / 2 @ axes + origin
    lot = get_corners(x, y, way, size[0], size[1])
    canvas.fill(lot, vary_colour(ROADS[g.integers(5)], g))
    share, lined = g.uniform(0.1, 0.95), g.uniform() < 0.7
    for row in range(rows):
        for side in (0, 1):
            base = row * (2 * deep + aisle) + side * (deep + aisle)
            for k in range(stalls):
                if lined:
                    x, y = np.array([k * wide + 2, base + deep / 2]) @ axes + origin
                    canvas.fill(get_corners(x, y, way + np.pi / 2, deep, 0.12), (215, 215, 212))
                if g.uniform() < share:
                    spot = np.array([(k + 0.5) * wide + 2, base + deep / 2 + g.normal(0, 0.2)])
                    turn = np.pi / 2 + np.pi * g.integers(2) + g.normal(0, 0.03)
                    x, y = spot @ axes + origin
                    add_vehicle(scene, x, y, way + turn, small=True)


def shade_vehicle(scene: Scene, v: Vehicle) -> None:
    """Darken the ground below a vehicle and cast its shadow."""
    below = get_corners(v.x, v.y, v.heading, v.length * 1.01, v.width * 1.06)
    scene.canvas.fill(below, (38, 38, 40))
    scene.cast(
        scene.low_shadow,
        get_corners(v.x, v.y, v.heading, v.length * 0.96, v.width),
        v.height * 0.85,
    )
