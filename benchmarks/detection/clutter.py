"""What lies and stands about and is no vehicle: slabs, containers, stairs, walls, pedestrians."""

import cv2
import numpy as np
from numpy import ndarray as Array

from benchmarks.detection.scene import GROUNDS, Scene, draw_ribs, pick_colour, vary_colour
from benchmarks.detection.vehicles import get_corners


def is_free(scene: Scene, points: Array, reach: float) -> bool:
    """Say whether no vehicle stands within reach of the middle of a polygon."""
    middle = points.mean(0)
    return all(np.hypot(*(middle - [v.x, v.y])) > reach + v.length / 2 for v in scene.vehicles)


def draw_flat(scene: Scene) -> None:
    """Draw something flat: a slab, a bed, a sheet, a mat, a lawn, a pool."""
    g = scene.generator
    x, y = scene.pick_place()
    long, wide = [(g.uniform(0.4, 3), g.uniform(0.3, 2)), (g.uniform(2, 9), g.uniform(1, 6))][
        g.integers(2)
    ]
    colour = (
        vary_colour(GROUNDS[g.integers(len(GROUNDS))][0], g)
        if g.uniform() < 0.6
        else pick_colour(g)
    )
    points = get_corners(x, y, scene.pick_angle(), long, wide)
    scene.canvas.fill(points, colour)
    if g.uniform() < 0.4:
        rim, line = pick_colour(g), [scene.canvas.convert(points)]
        cv2.polylines(scene.canvas.image, line, True, rim, 1, cv2.LINE_AA, 4)


def draw_block(scene: Scene) -> None:
    """Draw something low that stands: kiosks, containers, bins, boats, stones, awnings, hedges."""
    g, canvas = scene.generator, scene.canvas
    x, y = scene.pick_place()
    kind = g.choice(["bin", "kiosk", "container", "boat", "hedge", "umbrella", "shelter"])
    long, wide, high = {
        "bin": (g.uniform(0.5, 2), g.uniform(0.4, 1.4), g.uniform(0.6, 1.5)),
        "kiosk": (g.uniform(2, 6), g.uniform(1.8, 4), g.uniform(2.2, 3.2)),
        "container": (g.choice([6.1, 12.2]), 2.45, 2.6),
        "boat": (g.uniform(3, 9), g.uniform(1.3, 3), 0.8),
        "hedge": (g.uniform(2, 20), g.uniform(0.5, 1.6), g.uniform(0.5, 1.8)),
        "umbrella": (g.uniform(1.5, 3.5),) * 2 + (2.3,),
        "shelter": (g.uniform(3, 12), g.uniform(1.2, 2.2), 2.5),
    }[str(kind)]
    heading = scene.pick_angle()
    points = get_corners(x, y, heading, long, wide)
    if kind == "boat":
        points = np.concatenate(
            [
                points[1:3],
                get_corners(x, y, heading, long * 0.5, wide)[3:],
                [np.array([x, y]) + long / 2 * np.array([np.cos(heading), np.sin(heading)])],
                get_corners(x, y, heading, long * 0.5, wide)[:1],
            ]
        )
    if not is_free(scene, points, max(long, wide) / 2):
        return
    scene.cast(scene.low_shadow, points, high)
    top = vary_colour((70, 88, 50), g) if kind == "hedge" else pick_colour(g)
    sides = np.concatenate([points, points + np.array(canvas.lean) * high])
    canvas.fill_hull(sides, tuple(np.array(top) * 0.6))
    canvas.fill(points, top, high)
    if kind in ("container", "shelter", "kiosk") and g.uniform() < 0.6:
        draw_ribs(scene, (x, y, heading, long, wide), high, tuple(np.array(top) * 0.85))
    elif kind in ("bin", "kiosk", "container") and g.uniform() < 0.3:
        inner = get_corners(x, y, heading, long * g.uniform(0.3, 0.9), wide * g.uniform(0.4, 0.9))
        canvas.fill(inner, pick_colour(g), high)
    elif kind == "boat":
        canvas.fill(get_corners(x, y, heading, long * 0.5, wide * 0.6), pick_colour(g), high)


def draw_bars(scene: Scene) -> None:
    """Draw stairs, grids, racks or gratings: parallel bars, perhaps in a dark pit with walls."""
    g = scene.generator
    x, y = scene.pick_place()
    long, wide, heading = g.uniform(2, 10), g.uniform(1.2, 4.5), scene.pick_angle()
    points = get_corners(x, y, heading, long, wide)
    if not is_free(scene, points, long / 2):
        return
    if g.uniform() < 0.6:
        scene.canvas.fill(points, pick_colour(g))
    draw_ribs(scene, (x, y, heading, long, wide), 0.0, pick_colour(g))
    if g.uniform() < 0.5:
        line = [scene.canvas.convert(points)]
        thick = int(g.integers(1, 4))
        cv2.polylines(
            scene.canvas.image, line, bool(g.integers(2)), pick_colour(g), thick, cv2.LINE_AA, 4
        )


def draw_wall(scene: Scene) -> None:
    """Draw a wall, a fence, a kerb or a pipe with its shadow."""
    g = scene.generator
    x, y = scene.pick_place()
    points = get_corners(x, y, scene.pick_angle(), g.uniform(2, 25), g.uniform(0.15, 0.7))
    scene.cast(scene.low_shadow, points, g.uniform(0.3, 2.2))
    scene.canvas.fill(points, pick_colour(g))


def draw_person(scene: Scene) -> None:
    """Draw a few pedestrians."""
    g = scene.generator
    x, y = scene.pick_place()
    for _ in range(g.integers(1, 4)):
        cx, cy = np.array([x, y]) + g.normal(0, 0.8, 2)
        points = get_corners(cx, cy, g.uniform(0, 7), 0.3, 0.5)
        scene.cast(scene.low_shadow, points, 1.6)
        scene.canvas.fill(points, pick_colour(g), 1.4)


def draw_cycle(scene: Scene) -> None:
    """Draw a bicycle or a motorcycle with a rider: not among the vehicles that are looked for."""
    g = scene.generator
    x, y = scene.pick_place()
    heading = scene.pick_angle()
    points = get_corners(x, y, heading, g.uniform(1.7, 2.2), g.uniform(0.3, 0.6))
    scene.cast(scene.low_shadow, points, 1.2)
    scene.canvas.fill(points, pick_colour(g), 0.6)
    scene.canvas.fill(get_corners(x, y, heading, 0.4, 0.6), pick_colour(g), 1.4)
