"""Objects on the drawn ground, with their shadows: houses, trees, hedges, lamps, parked cars."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.base.geometry import transform_points
from geoaim.synthetic.exact import blur, pack, premultiply, warp
from geoaim.synthetic.scenery.canvas import (
    BLOTCH,
    GRAIN,
    PATCH,
    Canvas,
    Window,
    fill,
    make_bar,
    make_circle,
    make_rectangle,
    rasterize_shape,
    sample_noise,
    shade,
)
from geoaim.synthetic.scenery.day import PALETTES, Day, compute_shadow_depth, compute_shadow_offset
from geoaim.synthetic.scenery.scenery import Building, Scenery, Tree
from geoaim.synthetic.scenery.sprites import draw_bare_tree, draw_tree, draw_vehicle
from geoaim.synthetic.scenery.texture import ROWS_BLENDED, Colour, blend, darken, to_share

PAINTS: tuple[Colour, ...] = (
    (206, 208, 210), (236, 236, 233), (40, 42, 46), (128, 132, 137), (64, 68, 74),
    (118, 24, 26), (38, 66, 112), (168, 152, 118), (222, 222, 220), (52, 78, 66),
)  # fmt: skip
TILES: tuple[Colour, ...] = ((150, 94, 74), (112, 108, 108), (134, 78, 62), (92, 90, 96))
CONTAINERS: tuple[Colour, ...] = ((52, 92, 140), (168, 84, 48), (90, 120, 84), (196, 192, 184))
LAMP_HEIGHT_M = 7.0
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
    boxes = list(scenery.container_areas[: max(day.changes // 2, 0)])
    _cast_shadows(canvas, scenery, [*trees, *cars], boxes, day)
    for car in cars:
        _paste(canvas, car)
    for number, box in enumerate(boxes):
        colour, middle = CONTAINERS[number % len(CONTAINERS)], box.mean(axis=0)
        fill(canvas, box, colour, grain=[(GRAIN, 5)])
        fill(canvas, middle + 0.96 * (box - middle), colour, grain=[(BLOTCH, 6)])
    _draw_hedges(canvas, scenery, day)
    for building in scenery.buildings:
        (_draw_flat_roof if building.flat else _draw_pitched_roof)(canvas, building, day)
    for tree in trees:
        _paste(canvas, tree)
    for foot, tip in scenery.lamps:
        fill(canvas, make_bar(foot, tip, 0.07), (196, 198, 198))
        fill(canvas, make_circle(foot, 0.16), (120, 122, 124))


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
    bare = generator.uniform() < palette.bare
    radius = max(round(tree.radius / canvas.resolution), 3)
    if bare:
        crown = draw_bare_tree(radius, generator)
    else:
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


def _cast_shadows(
    canvas: Canvas,
    scenery: Scenery,
    stamps: list[_Stamp],
    boxes: list[Float[Array, "4 2"]],
    day: Day,
) -> None:
    """Draw the shadows of all objects; overlapping shadows do not add up."""
    cast = compute_shadow_offset(day)
    solids = [
        _sweep(make_rectangle(np.array(b.centre), b.size, b.angle), b.height * cast)
        for b in scenery.buildings
    ]
    solids += [_sweep(hedge, 1.1 * cast) for hedge in scenery.hedges]
    solids += [_sweep(box, 2.6 * cast) for box in boxes]
    for foot, tip in scenery.lamps:
        solids.append(make_bar(foot, foot + LAMP_HEIGHT_M * cast, 0.08))
        solids.append(make_bar(foot + LAMP_HEIGHT_M * cast, tip + LAMP_HEIGHT_M * cast, 0.08))
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


def _draw_hedges(canvas: Canvas, scenery: Scenery, day: Day) -> None:
    if not scenery.hedges:
        return
    window, mask = rasterize_shape(canvas, list(scenery.hedges))
    clumps, leaves = sample_noise(canvas, BLOTCH, window), sample_noise(canvas, GRAIN, window)
    ragged = to_share(blur(mask, 0.18 / canvas.resolution))
    ragged += np.float32(0.10) * clumps + np.float32(0.05) * leaves
    alpha = np.minimum(np.maximum((ragged - np.float32(0.45)) * 6, 0), 1) * (ragged > 0.3)
    green = np.asarray(PALETTES[day.season].leaves[0], np.float32) * np.float32(0.8)
    blend(canvas.image[window], alpha, green + (12 * clumps + 12 * leaves)[..., None])


def _draw_flat_roof(canvas: Canvas, building: Building, day: Day) -> None:
    """Draw a flat roof: gravel or tar, a parapet, and objects with their shadows."""
    centre, (long, wide), angle = np.array(building.centre), building.size, building.angle
    cast, ahead = compute_shadow_offset(day), np.array([np.cos(angle), np.sin(angle)])
    left = np.array([-ahead[1], ahead[0]])
    outline, inside = make_rectangle(centre, building.size, angle), (long - 1, wide - 1)
    inner = make_rectangle(centre, inside, angle)
    base: Colour = (158, 155, 150) if building.colour == 0 else (120, 118, 118)
    fill(canvas, outline, (206, 203, 197), grain=[(GRAIN, 3)])
    fill(canvas, inner, base, grain=[(PATCH, 6), (GRAIN, 7)])
    window, mask = rasterize_shape(canvas, inner)
    lit = make_rectangle(centre + 0.9 * cast, inside, angle)
    rim = to_share(np.minimum(mask, 255 - rasterize_shape(canvas, lit, within=window)[1]))
    darken(canvas.image[window], rim, 0.72 * compute_shadow_depth(day))
    for (along, across), size, height, colour in _list_roof_objects(long, wide):
        body = make_rectangle(centre + along * ahead + across * left, size, angle)
        shade(canvas, _sweep(body, height * cast), tuple(0.85 * compute_shadow_depth(day)))
        fill(canvas, body, colour, grain=[(GRAIN, 4)])


def _list_roof_objects(
    long: float, wide: float
) -> list[tuple[tuple[float, float], tuple[float, float], float, Colour]]:
    """List position, size, height and colour of stairs, machines and skylights."""
    return [
        ((0.28 * long, 0.15 * wide), (0.2 * long, 0.2 * wide), 2.6, (184, 180, 172)),
        ((-0.3 * long, -0.24 * wide), (3.0, 2.2), 1.5, (198, 200, 202)),
        ((-0.15 * long, -0.24 * wide), (3.0, 2.2), 1.5, (190, 192, 194)),
        ((0.07 * long, 0.22 * wide), (2.4, 1.6), 1.0, (205, 206, 206)),
        ((0.22 * long, -0.3 * wide), (1.2, 1.2), 1.2, (150, 152, 154)),
        *[
            (((0.13 * k - 0.36) * long, 0.05 * wide), (0.09 * long, 1.5), 0.5, (108, 134, 152))
            for k in range(4)
        ],
    ]


def _draw_pitched_roof(canvas: Canvas, building: Building, day: Day) -> None:
    """Draw a pitched roof: two slopes of tiles lit differently, a ridge and a chimney."""
    centre, angle = np.array(building.centre), building.angle
    a, b, c, d = make_rectangle(centre, building.size, angle)
    ridge = [(b + c) / 2, (a + d) / 2]
    colour = TILES[building.colour % len(TILES)]
    across = np.array([-np.sin(angle), np.cos(angle)])
    lean = float(across @ [np.cos(day.azimuth), np.sin(day.azimuth)]) * (1 - day.clouds)
    for eaves, light in (([a, b], 0.93 - 0.16 * lean), ([d, c], 0.93 + 0.16 * lean)):
        window, mask = rasterize_shape(canvas, np.array([*eaves, *ridge]))
        if mask.size == 0:
            continue
        rows, columns = (np.arange(side.start, side.stop) for side in window)
        place = (columns * np.sin(angle))[None] + (rows * np.cos(angle))[:, None]
        row = np.round(np.sin(place * canvas.resolution * 2 * np.pi / 0.36), 6)
        blotches, grain = sample_noise(canvas, BLOTCH, window), sample_noise(canvas, GRAIN, window)
        look = 1 + 0.05 * blotches + 0.06 * grain + 0.05 * row
        tiles = np.asarray(colour) * (light * look)[..., None]
        blend(canvas.image[window], to_share(mask), tiles)
    pale = tuple(1.15 * channel + 8 for channel in colour)
    fill(canvas, make_bar((a + d) / 2, (b + c) / 2, 0.14), (pale[0], pale[1], pale[2]))
    foot = 0.7 * (a + d) / 2 + 0.3 * (b + c) / 2 + (d - a) * 0.12
    chimney = make_rectangle(foot, (1.1, 0.8), angle)
    shadow = _sweep(chimney, 1.6 * compute_shadow_offset(day))
    shade(canvas, shadow, tuple(0.8 * compute_shadow_depth(day)))
    fill(canvas, chimney, (140, 84, 70))


def _sweep(corners: Float[Array, "_ 2"], cast: Float[Array, "2"]) -> Float[Array, "_ 2"]:
    """Compute the shadow of an upright prism: the convex hull of its base and the base shifted."""
    both = np.concatenate([corners, corners + cast]).astype(np.float32)
    return np.asarray(cv2.convexHull(both), np.float64)[:, 0]
