"""Draw the ground of a place: grass, slabs, tar and paint."""

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.synthetic.roads import markings
from benchmarks.synthetic.roads.approaches import Approach, outline_strip
from benchmarks.synthetic.roads.paving import outline_road
from benchmarks.synthetic.roads.plan import Roads
from benchmarks.synthetic.scenery.canvas import (
    BLOTCH,
    GRAIN,
    HILL,
    PATCH,
    Canvas,
    Window,
    fill,
    make_circle,
    rasterize_shape,
    sample_noise,
)
from benchmarks.synthetic.scenery.day import PALETTES, Day
from benchmarks.synthetic.scenery.scenery import Scenery
from benchmarks.synthetic.scenery.texture import Colour, blend, darken, to_share

WHITE: Colour = (222, 222, 216)
TAR: Colour = (122, 121, 119)
SLAB: Colour = (152, 149, 144)
KERB: Colour = (196, 193, 186)


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
    fill(canvas, scenery.gravel, (196, 182, 150), grain=[(PATCH, 5), (GRAIN, 9)])
    fill(canvas, scenery.ponds.buffer(0.45), (188, 184, 174), grain=[(GRAIN, 6)])
    fill(canvas, scenery.ponds, (58, 84, 88), grain=[(HILL, 4)])


def _draw_pavement(canvas: Canvas, roads: Roads, scenery: Scenery, day: Day) -> None:
    """Draw slabs between kerb and plots, paths, and verges of grass."""
    paved = shapely.union_all([roads.paving.pavement, roads.footpaths.surface])
    fill(canvas, paved, SLAB, grain=[(PATCH, 4), (GRAIN, 4.5)])
    rim = roads.paving.pavement.boundary.buffer(0.08)
    fill(canvas, rim, (128, 124, 118), strength=0.8, only=roads.paving.pavement.buffer(0.1))
    palette = PALETTES[day.season]
    green = tuple(0.5 * a + 0.5 * b for a, b in zip((88, 108, 56), palette.grass, strict=True))
    fill(canvas, scenery.verges, (green[0], green[1], green[2]), grain=[(PATCH, 9), (GRAIN, 11)])


def _draw_tar(canvas: Canvas, roads: Roads) -> None:
    """Draw even tar, and manholes, which are control points."""
    for area in (roads.paving.carriageway, roads.paving.driveway, roads.paving.parking_lot):
        fill(canvas, area, TAR, grain=[(GRAIN, 5.5)])
    for place in markings.locate_manholes(roads):
        fill(canvas, make_circle(place, 0.42), (92, 90, 86))
        fill(canvas, make_circle(place, 0.33), (70, 67, 64))


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
    tar = shapely.union_all([roads.paving.carriageway, roads.paving.parking_lot]).buffer(-0.05)
    fill(canvas, markings.make_markings(roads), WHITE, strength=0.9, only=tar)


def _compute_plan_coordinates(
    canvas: Canvas, window: Window
) -> tuple[Float[Array, "1 w"], Float[Array, "h 1"]]:
    """Compute plan coordinates of a window's columns and rows."""
    rows, columns = window
    scale = canvas.resolution
    x = (np.arange(columns.start, columns.stop) + 0.5 - canvas.shape[1] / 2) * scale
    y = (canvas.shape[0] / 2 - np.arange(rows.start, rows.stop) - 0.5) * scale
    return x[None, :], y[:, None]
