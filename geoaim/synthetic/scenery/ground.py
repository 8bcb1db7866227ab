"""Draw the ground of a place: grass, slabs, worn tar and paint."""

import cv2
import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString

from geoaim.base.geometry import transform_points
from geoaim.synthetic.exact import blur
from geoaim.synthetic.roads import markings
from geoaim.synthetic.roads.approaches import (
    Approach,
    locate_inbound_lane,
    outline_strip,
    plan_from_road,
)
from geoaim.synthetic.roads.curves import offset_polyline
from geoaim.synthetic.roads.lanes import LANE_END_M
from geoaim.synthetic.roads.paving import outline_road
from geoaim.synthetic.roads.plan import Roads
from geoaim.synthetic.scenery.canvas import (
    BLOTCH,
    GRAIN,
    HILL,
    PATCH,
    Canvas,
    Shape,
    Window,
    fill,
    make_circle,
    rasterize_shape,
    sample_noise,
    shade,
)
from geoaim.synthetic.scenery.day import PALETTES, Day
from geoaim.synthetic.scenery.scenery import Scenery
from geoaim.synthetic.scenery.texture import Colour, blend, darken, to_share

WHITE: Colour = (222, 222, 216)
TAR: Colour = (122, 121, 119)
SLAB: Colour = (152, 149, 144)
KERB: Colour = (196, 193, 186)
TAR_NOISE = PATCH, BLOTCH, GRAIN, HILL
WHEEL_OFFSET_M = 0.8  # distance of the wheels from the middle of a lane


def draw_ground_layers(
    canvas: Canvas, roads: Roads, scenery: Scenery, day: Day, generator: np.random.Generator
) -> None:
    """Draw the ground in painting order: grass, plots, pavement, tar, islands, kerbs, markings.

    Args:
        canvas: changed in place.
        roads: the roads.
        scenery: the plots: parks, fields, soil, gravel, ponds, verges.
        day: the season, and the number of changes since day 0.
        generator: draws the repairs of that day; all else is drawn by `canvas.generator`.
    """
    _draw_grass(canvas, day)
    _draw_plots(canvas, scenery)
    _draw_pavement(canvas, roads, scenery, day)
    _draw_tar(canvas, roads)
    _draw_fresh_tar(canvas, roads, day, generator)
    _draw_islands(canvas, roads, day)
    _draw_kerbs(canvas, roads)
    _draw_paint(canvas, roads)


def _draw_grass(canvas: Canvas, day: Day) -> None:
    """Draw lawn everywhere, dry in places."""
    palette = PALETTES[day.season]
    image = canvas.image
    image[:] = palette.grass
    patches, grain = sample_noise(canvas, PATCH), sample_noise(canvas, GRAIN)
    image += (np.float32(9) * patches + np.float32(11) * grain)[..., None]
    dry = np.minimum(np.maximum(0.45 * (sample_noise(canvas, HILL) + palette.dryness), 0), 0.6)
    blend(image, dry.astype(np.float32), palette.dry)


def _draw_plots(canvas: Canvas, scenery: Scenery) -> None:
    """Draw mown parks, yards, gravel, ponds and soil."""
    for parcel in scenery.parcels:
        if parcel.use == "park":
            window, mask = rasterize_shape(canvas, parcel.area)
            x, y = _compute_plan_coordinates(canvas, window)
            stripe = np.sign(np.sin((0.9 * x + 0.5 * y) * 2.2)) * 0.025
            darken(canvas.image[window], to_share(mask), stripe[..., None])
        if parcel.use == "field":
            rough = [(PATCH, 14), (BLOTCH, 12), (GRAIN, 16)]
            fill(canvas, parcel.area, (112, 116, 72), strength=0.6, grain=rough)
    rough = [(PATCH, 9), (BLOTCH, 8), (GRAIN, 7)]
    fill(canvas, scenery.soil, (136, 118, 92), strength=0.7, grain=rough)
    fill(canvas, scenery.slabs, (166, 160, 151), grain=[(PATCH, 4), (GRAIN, 4.5)])
    _draw_joints(canvas, scenery.slabs, 1.2, 0.28)
    fill(canvas, scenery.gravel, (196, 182, 150), grain=[(PATCH, 5), (GRAIN, 9)])
    fill(canvas, scenery.ponds.buffer(0.45), (188, 184, 174), grain=[(GRAIN, 6)])
    fill(canvas, scenery.ponds, (58, 84, 88), grain=[(HILL, 4)])


def _draw_pavement(canvas: Canvas, roads: Roads, scenery: Scenery, day: Day) -> None:
    """Draw slabs between kerb and plots, paths, and verges of grass."""
    paved = shapely.union_all([roads.paving.pavement, roads.footpaths.surface])
    fill(canvas, paved, SLAB, grain=[(PATCH, 4), (GRAIN, 4.5)])
    _draw_joints(canvas, paved, 0.6, 0.22)
    rim = roads.paving.pavement.boundary.buffer(0.08)
    fill(canvas, rim, (128, 124, 118), strength=0.8, only=roads.paving.pavement.buffer(0.1))
    palette = PALETTES[day.season]
    green = tuple(0.5 * a + 0.5 * b for a, b in zip((88, 108, 56), palette.grass, strict=True))
    fill(canvas, scenery.verges, (green[0], green[1], green[2]), grain=[(PATCH, 9), (GRAIN, 11)])
    fill(canvas, markings.make_tactile_strips(roads), (204, 176, 84), strength=0.8, only=paved)


def _draw_joints(canvas: Canvas, area: Geometry, step: float, share: float) -> None:
    """Draw the dark joints between slabs."""
    window, mask = rasterize_shape(canvas, area)
    if mask.size:
        x, y = _compute_plan_coordinates(canvas, window)
        joint = (np.mod(x, step) < 0.05) | (np.mod(y, step) < 0.05)
        alpha = joint * mask.astype(np.float32) * np.float32(share / 255)
        blend(canvas.image[window], alpha, (108, 105, 100))


def _draw_tar(canvas: Canvas, roads: Roads) -> None:
    """Draw tar of several ages with wheel tracks, oil, patches, cracks and manholes."""
    road = shapely.union_all(
        [roads.paving.carriageway, roads.paving.driveway, roads.paving.parking_lot]
    )
    window, mask = rasterize_shape(canvas, road)
    patch, blotch, grain, hill = (sample_noise(canvas, k, window) for k in TAR_NOISE)
    grey = np.float32(4) * patch + np.float32(2.5) * blotch
    grey += np.float32(5.5) * grain + np.float32(3) * hill
    grey += _vary_age(canvas, roads, window)
    middles = [lane.centreline for lane in roads.lanes]
    wheels = [offset_polyline(m, d) for m in middles for d in (-WHEEL_OFFSET_M, WHEEL_OFFSET_M)]
    grey -= np.float32(6) * _draw_strokes(canvas, window, wheels, 0.28)
    grey -= np.float32(6) * _draw_strokes(canvas, window, middles, 0.4)
    grey -= np.float32(9) * _draw_strokes(canvas, window, _list_waiting_lines(roads), 0.45)
    tar = np.asarray(TAR, np.float32) + grey[..., None]
    blend(canvas.image[window], to_share(mask), tar)
    for outline, change in _make_patches(canvas, roads):
        shade(canvas, outline, change / 122, only=road)
        rim = shapely.LinearRing(outline).buffer(0.06)
        fill(canvas, rim, (74, 74, 75), strength=0.4, only=road)
    _draw_cracks(canvas, road)
    whole = outline_road(roads.paving)
    gutter = whole.difference(whole.buffer(-0.5))
    shade(canvas, gutter, 0.13, only=road)
    for place in markings.locate_manholes(roads):
        fill(canvas, make_circle(place, 0.42), (92, 90, 86))
        fill(canvas, make_circle(place, 0.33), (70, 67, 64))


def _vary_age(canvas: Canvas, roads: Roads, window: Window) -> Float[Array, "h w"]:
    """Vary the grey level of each approach, its halves and the car park by its age."""
    rows, columns = window
    change = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.float32)
    shapes: list[Shape] = []
    for approach in roads.layout.approaches:
        middle, half = approach.divider, approach.half_width
        cut = canvas.generator.uniform(approach.mouth + 4, 60)
        for span in ((middle, half), (-half, middle)):
            ends = (approach.mouth, cut), (cut, LANE_END_M)
            shapes += [outline_strip(approach, s, span) for s in ends]
    for shape in [*shapes, roads.paving.parking_lot]:
        mask = rasterize_shape(canvas, shape, within=window)[1]
        change += np.float32(canvas.generator.uniform(-11, 9) / 255) * mask.astype(np.float32)
    return change


def _draw_strokes(
    canvas: Canvas, window: Window, lines: list[Float[Array, "_ 2"]], wide: float
) -> Float[Array, "h w"]:
    """Draw soft strokes along lines, 0 to 1."""
    rows, columns = window
    mask = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.uint8)
    start = np.array([columns.start, rows.start])
    thick = max(round(wide / canvas.resolution), 1)
    for line in lines:
        pixels = transform_points(canvas.image_from_plan, line) - start
        fixed = np.rint(pixels * 16).astype(np.int32)
        cv2.polylines(mask, [fixed], False, 255, thick, cv2.LINE_AA, 4)
    return to_share(blur(mask, 0.5 * wide / canvas.resolution))


def _list_waiting_lines(roads: Roads) -> list[Float[Array, "_ 2"]]:
    """List the places behind stop lines, where oil drips."""
    lines = []
    for approach in roads.layout.approaches:
        if np.isfinite(approach.stop):
            for rank in range(len(approach.turns)):
                t = locate_inbound_lane(approach, rank)
                spots = [[approach.stop + d, t] for d in (1.0, 6.0, 12.0)]
                lines.append(plan_from_road(approach, np.array(spots)))
    return lines


def _make_patches(canvas: Canvas, roads: Roads) -> list[tuple[Float[Array, "_ 2"], float]]:
    """Make repaired patches and a trench: outlines, and by how many grey levels they are darker."""
    patches = []
    for approach in roads.layout.approaches:
        half = approach.half_width
        for _ in range(2):
            along = canvas.generator.uniform(-4, 75)
            across = canvas.generator.uniform(-half + 0.5, half - 3.0)
            long, wide = canvas.generator.uniform(3, 10), canvas.generator.uniform(1.0, 3.2)
            change = float(canvas.generator.choice([16.0, 11.0, -9.0]))
            patch = outline_strip(approach, (along, along + long), (across, across + wide))
            patches.append((patch, change))
    approach = _pick_approach(roads, canvas.generator)
    across = canvas.generator.uniform(-0.7, 0.5) * approach.half_width
    patches.append((outline_strip(approach, (approach.mouth, 80.0), (across, across + 0.9)), 13.0))
    return patches


def _pick_approach(roads: Roads, generator: np.random.Generator) -> Approach:
    return roads.layout.approaches[int(generator.integers(len(roads.layout.approaches)))]


def _draw_fresh_tar(canvas: Canvas, roads: Roads, day: Day, generator: np.random.Generator) -> None:
    """Draw patches that were repaired since day 0."""
    for _ in range(day.changes // 3):
        approach = _pick_approach(roads, generator)
        start = generator.uniform(approach.mouth, 60.0)
        across = generator.uniform(-0.9, 0.1) * approach.half_width
        end = start + generator.uniform(5, 14)
        shape = outline_strip(approach, (start, end), (across, across + 3.2))
        fill(canvas, shape, (92, 92, 93), grain=[(GRAIN, 4)], only=roads.paving.carriageway)


def _draw_cracks(canvas: Canvas, road: Geometry) -> None:
    """Draw thin cracks along and across the roads."""
    low_x, low_y, high_x, high_y = road.bounds
    lines = []
    for _ in range(60):
        start = canvas.generator.uniform([low_x, low_y], [high_x, high_y])
        heading = canvas.generator.choice([0, np.pi / 2]) + canvas.generator.normal(0, 0.25)
        turns = np.cumsum(canvas.generator.normal(0, 0.35, 60)) * 0.35 + heading
        steps = np.stack([np.cos(turns), np.sin(turns)], 1) * 0.16
        lines.append(LineString(start + np.cumsum(steps, axis=0)))
    shapely.prepare(road)
    cracks = [np.array(line.coords) for line in lines if road.intersects(line)]
    mask = _draw_strokes(canvas, canvas.window, cracks, canvas.resolution)
    inside = rasterize_shape(canvas, road, within=canvas.window)[1]
    mask *= inside.astype(np.float32) * np.float32(0.8 / 255)
    blend(canvas.image, mask, (70, 70, 72))


def _draw_islands(canvas: Canvas, roads: Roads, day: Day) -> None:
    """Draw traffic islands: grass on large ones, stone on small ones."""
    palette = PALETTES[day.season]
    for island in shapely.get_parts(roads.paving.islands):
        if island.area > 60:
            fill(canvas, island, palette.grass, grain=[(PATCH, 9), (GRAIN, 11)])
            rim = island.difference(island.buffer(-1.6))
            fill(canvas, rim, (168, 140, 120), grain=[(GRAIN, 7)])
        else:
            fill(canvas, island, SLAB, grain=[(PATCH, 4), (GRAIN, 6)])


def _draw_kerbs(canvas: Canvas, roads: Roads) -> None:
    """Draw kerbstones along the road, except at the driveway."""
    islands = shapely.get_parts(roads.paving.islands)
    rims = [outline_road(roads.paving).exterior, *(island.boundary for island in islands)]
    stones = shapely.union_all([rim.buffer(0.11) for rim in rims])
    stones = stones.difference(roads.paving.driveway.buffer(0.3))
    fill(canvas, stones, KERB, strength=0.9, grain=[(GRAIN, 5)])


def _draw_paint(canvas: Canvas, roads: Roads) -> None:
    """Draw markings and cycle lanes, with worn paint."""
    tar = shapely.union_all([roads.paving.carriageway, roads.paving.parking_lot]).buffer(-0.05)
    _draw_paint_with_wear(canvas, markings.make_cycle_strips(roads), (158, 66, 58), 0.8, tar)
    _draw_paint_with_wear(canvas, markings.make_markings(roads), WHITE, 0.9, tar)


def _draw_paint_with_wear(
    canvas: Canvas, shapes: list[Float[Array, "_ 2"]], colour: Colour, cover: float, only: Geometry
) -> None:
    if not shapes:
        return
    window, mask = rasterize_shape(canvas, shapes)
    left = np.float32(cover) - np.float32(0.10) * sample_noise(canvas, PATCH, window)
    left -= np.float32(0.16) * np.maximum(sample_noise(canvas, BLOTCH, window) - np.float32(0.9), 0)
    left = np.minimum(np.maximum(left, np.float32(0.25)), np.float32(0.95))
    inside = to_share(rasterize_shape(canvas, only, within=window)[1])
    blend(canvas.image[window], left * inside * mask.astype(np.float32) / np.float32(255), colour)


def _compute_plan_coordinates(
    canvas: Canvas, window: Window
) -> tuple[Float[Array, "1 w"], Float[Array, "h 1"]]:
    """Compute plan coordinates of a window's columns and rows."""
    rows, columns = window
    scale = canvas.resolution
    x = (np.arange(columns.start, columns.stop) + 0.5 - canvas.shape[1] / 2) * scale
    y = (canvas.shape[0] / 2 - np.arange(rows.start, rows.stop) - 0.5) * scale
    return x[None, :], y[:, None]
