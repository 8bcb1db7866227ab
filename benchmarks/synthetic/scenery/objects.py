"""Objects on the drawn ground, with their shadows: houses, trees, parked cars."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from benchmarks.synthetic.exact import blur, pack, premultiply, warp
from benchmarks.synthetic.scenery.canvas import (
    GRAIN,
    PATCH,
    Canvas,
    Window,
    fill,
    make_rectangle,
    rasterize_shape,
    sample_noise,
)
from benchmarks.synthetic.scenery.day import (
    PALETTES,
    Day,
    compute_shadow_depth,
    compute_shadow_offset,
)
from benchmarks.synthetic.scenery.scenery import Building, Scenery, Tree
from benchmarks.synthetic.scenery.sprites import draw_tree, draw_vehicle
from benchmarks.synthetic.scenery.texture import ROWS_BLENDED, Colour, darken, to_share
from geoaim.base.geometry import transform_points

PAINTS: tuple[Colour, ...] = (
    (206, 208, 210), (236, 236, 233), (40, 42, 46), (128, 132, 137), (64, 68, 74),
    (118, 24, 26), (38, 66, 112), (168, 152, 118), (222, 222, 220), (52, 78, 66),
)  # fmt: skip
TILES: tuple[Colour, ...] = ((150, 94, 74), (112, 108, 108), (134, 78, 62), (92, 90, 96))
FLAT_ROOFS: tuple[Colour, ...] = ((158, 155, 150), (120, 118, 118))
CAR_HEIGHT_M = 1.3
TREE_HEIGHT_PER_RADIUS = 1.6
CONTRAST = (0.75, 1.45)  # slopes of the cameras' tone curves at their middle
TONE_STEPS = 4  # steps of the tone curve per grey level
TONE_MIDDLE = 0.47  # share of white at which the tone curve is steepest
HAZE = (7.0, 8.0, 11.0)  # grey levels added by the air


@dataclass(frozen=True)
class _Stamp:
    """A sprite on the plan: its centre (metres), heading and height (metres)."""

    place: Float[Array, "2"]
    heading: float
    sprite: UInt8[Array, "_ _ 4"]
    height: float


def draw_objects(
    canvas: Canvas, scenery: Scenery, day: Day, generator: np.random.Generator
) -> None:
    """Draw all objects, shadows first.

    Args:
        canvas: changed in place.
        scenery: the objects.
        day: sun and season.
        generator: source of randomness, the day's own.
    """
    felled = generator.permutation(len(scenery.trees))[: day.changes] if day.changes else ()
    standing = [tree for k, tree in enumerate(scenery.trees) if k not in felled]
    trees = [_place_tree(canvas, tree, day) for tree in standing]
    cars = _park_cars(canvas, scenery, generator)
    _cast_shadows(canvas, scenery, [*trees, *cars], day)
    for car in cars:
        _paste(canvas, car)
    for building in scenery.buildings:
        _draw_roof(canvas, building)
    for tree in trees:
        _paste(canvas, tree)


def grade_colours(canvas: Canvas, day: Day) -> None:
    """Apply uneven light, the colour of the day's light, haze and a camera's tone curve."""
    contrast = CONTRAST[0] + (CONTRAST[1] - CONTRAST[0]) * canvas.generator.uniform()
    light = np.asarray(PALETTES[day.season].light, np.float32) * np.float32(1 - 0.12 * day.clouds)
    uneven = 1 + np.float32(0.012) * sample_noise(canvas, PATCH)
    image = canvas.image
    image *= uneven[..., None]
    image *= light
    image += np.asarray(HAZE, np.float32)
    levels = np.arange(256 * TONE_STEPS) / (256 * TONE_STEPS)
    steep = contrast * (levels - TONE_MIDDLE)
    # bends softly towards black and white
    curve = 0.5 + 0.5 * steep / np.sqrt(0.25 + steep**2)
    low, high = curve[0], curve[-1]
    tones = np.rint(255 * 16 * (curve - low) / (high - low)).astype(np.float32) / np.float32(16)
    for top in range(0, len(image), ROWS_BLENDED):
        rows = slice(top, top + ROWS_BLENDED)
        place = np.minimum(np.maximum(image[rows] * TONE_STEPS, 0), 256 * TONE_STEPS - 1)
        image[rows] = tones[place.astype(np.int32)]


def _place_tree(canvas: Canvas, tree: Tree, day: Day) -> _Stamp:
    """Draw a tree's crown, which has the same shape on every day of a season."""
    palette, generator = PALETTES[day.season], np.random.default_rng(tree.number)
    colour = palette.leaves[int(generator.integers(len(palette.leaves)))]
    radius = max(round(tree.radius / canvas.resolution), 3)
    light = float(np.cos(day.azimuth)), float(-np.sin(day.azimuth))
    crown = draw_tree(radius, colour, light, canvas.fields[GRAIN], generator)
    return _Stamp(np.array(tree.place), 0.0, crown, TREE_HEIGHT_PER_RADIUS * tree.radius)


def _park_cars(canvas: Canvas, scenery: Scenery, generator: np.random.Generator) -> list[_Stamp]:
    """Park cars in some of the spots."""
    cars = []
    for spot in scenery.spots:
        there, paint = generator.uniform(), generator.integers(len(PAINTS))
        flip, length = generator.integers(2), generator.uniform(3.9, 4.7)
        aside, lean = generator.normal(0, 0.12, 2), generator.normal()
        if there < spot.share:
            sprite = draw_vehicle(length, 1.8, PAINTS[int(paint)], canvas.resolution)
            heading = spot.heading + np.pi * float(flip) + 0.02 * lean
            cars.append(_Stamp(np.array(spot.place) + aside, heading, sprite, CAR_HEIGHT_M))
    return cars


def _cast_shadows(canvas: Canvas, scenery: Scenery, stamps: list[_Stamp], day: Day) -> None:
    """Draw the shadows of all objects; overlapping shadows do not add up."""
    cast = compute_shadow_offset(day)
    solids = [
        _sweep(make_rectangle(np.array(b.centre), b.size, b.angle), b.height * cast)
        for b in scenery.buildings
    ]
    mask = rasterize_shape(canvas, solids, within=canvas.window)[1]
    for stamp in stamps:
        moved = replace(stamp, place=stamp.place + stamp.height * cast)
        placed = _render_stamp(canvas, moved)
        if placed is not None:
            window, sprite = placed
            np.maximum(mask[window], sprite[..., 3], out=mask[window])
    soft = blur(mask, (0.06 + 0.25 * day.clouds) / canvas.resolution)
    darken(canvas.image, to_share(soft), compute_shadow_depth(day))


def _paste(canvas: Canvas, stamp: _Stamp) -> None:
    placed = _render_stamp(canvas, stamp)
    if placed is not None:
        window, sprite = placed
        canvas.image[window] *= 1 - to_share(sprite[..., 3:])
        canvas.image[window] += sprite[..., :3].astype(np.float32)


def _render_stamp(canvas: Canvas, stamp: _Stamp) -> tuple[Window, UInt8[Array, "h w 4"]] | None:
    """Render a stamp: its window and premultiplied sprite; None if it lies outside.

    A stamp that is not rotated is placed at whole pixels.
    """
    sprite = premultiply(stamp.sprite)
    u, v = transform_points(canvas.image_from_plan, stamp.place[None])[0]
    rows, columns = sprite.shape[:2]
    if stamp.heading == 0.0:
        left, top = round(u - columns / 2), round(v - rows / 2)
        size = rows, columns
    else:
        reach = int(np.hypot(rows, columns) / 2) + 2
        left, top, size = int(u) - reach, int(v) - reach, (2 * reach, 2 * reach)
        sprite = _rotate_sprite(sprite, stamp.heading, (u - left, v - top), size)
    u0, v0 = max(left, 0), max(top, 0)
    u1, v1 = min(left + size[1], canvas.shape[1]), min(top + size[0], canvas.shape[0])
    if u1 <= u0 or v1 <= v0:
        return None
    return (slice(v0, v1), slice(u0, u1)), sprite[v0 - top : v1 - top, u0 - left : u1 - left]


def _rotate_sprite(
    sprite: UInt8[Array, "h w 4"],
    heading: float,
    middle: tuple[float, float],
    size: tuple[int, int],
) -> UInt8[Array, "_ _ 4"]:
    """Rotate a sprite about its middle, which is placed at a given pixel."""
    c, s, (u, v) = np.cos(heading), np.sin(heading), middle
    x, y = sprite.shape[1] / 2 - c * u + s * v, sprite.shape[0] / 2 - s * u - c * v
    matrix = np.array([[c, -s, x], [s, c, y], [0, 0, 1.0]])
    colour, alpha = (warp(pack(part), matrix, *size) for part in (sprite[..., :3], sprite[..., 3:]))
    return np.concatenate([colour, alpha[..., :1]], axis=-1)


def _draw_roof(canvas: Canvas, building: Building) -> None:
    outline = make_rectangle(np.array(building.centre), building.size, building.angle)
    colours = FLAT_ROOFS if building.flat else TILES
    fill(canvas, outline, colours[building.colour % len(colours)], grain=[(GRAIN, 6)])


def _sweep(corners: Float[Array, "_ 2"], cast: Float[Array, "2"]) -> Float[Array, "_ 2"]:
    """Compute the shadow of an upright prism: the convex hull of its base and the base shifted."""
    both = np.concatenate([corners, corners + cast]).astype(np.float32)
    return np.asarray(cv2.convexHull(both), np.float64)[:, 0]
