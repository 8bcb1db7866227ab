"""The ground of a place, drawn: grass, slabs, tar with its wear, paint."""

import cv2
import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString

from geoaim.geometry import transform_points
from geoaim.synthetic.exact import blur
from geoaim.synthetic.roads.arms import Arm, divider, half_width, lane_in, on_arm, strip
from geoaim.synthetic.roads.curves import parallel
from geoaim.synthetic.roads.lanes import FAR
from geoaim.synthetic.roads.markings import cycle_strips, manholes, paint, tactile_strips
from geoaim.synthetic.roads.paving import outer_kerbs
from geoaim.synthetic.roads.plan import Roads
from geoaim.synthetic.scenery.day import PALETTES, Day
from geoaim.synthetic.scenery.page import (
    BLOTCH,
    GRAIN,
    HILL,
    PATCH,
    Page,
    Shape,
    Window,
    circle,
    fill,
    mask_of,
    noise,
    shade,
)
from geoaim.synthetic.scenery.scene import Scenery
from geoaim.synthetic.scenery.texture import Colour, darken, lay

WHITE: Colour = (222, 222, 216)
TAR: Colour = (122, 121, 119)
SLAB: Colour = (152, 149, 144)
KERB: Colour = (196, 193, 186)
WHEELS = 0.8  # m from the middle of a lane to where wheels roll


def draw_ground(
    page: Page, roads: Roads, scenery: Scenery, day: Day, generator: np.random.Generator
) -> None:
    """Everything that is flat, from below to above; `generator` is that of the day."""
    _draw_grass(page, day)
    _draw_plots(page, scenery)
    _draw_pavement(page, roads, scenery, day)
    _draw_tar(page, roads)
    _draw_fresh_tar(page, roads, day, generator)
    _draw_islands(page, roads, day)
    _draw_kerbs(page, roads)
    _draw_paint(page, roads)


def _draw_grass(page: Page, day: Day) -> None:
    """Lawn everywhere, dry in places."""
    palette = PALETTES[day.season]
    image = page.image
    image[:] = palette.grass
    image += (np.float32(9) * noise(page, PATCH) + np.float32(11) * noise(page, GRAIN))[..., None]
    dry = np.minimum(np.maximum(0.45 * (noise(page, HILL) + palette.dryness), 0), 0.6)
    lay(image, dry.astype(np.float32), palette.dry)


def _draw_plots(page: Page, scenery: Scenery) -> None:
    """Mown parks, yards, gravel, ponds, soil."""
    for parcel in scenery.parcels:
        if parcel.use == "park":
            window, mask = mask_of(page, parcel.area)
            x, y = _metres(page, window)
            stripe = np.sign(np.sin((0.9 * x + 0.5 * y) * 2.2)) * 0.025
            darken(page.image[window], mask.astype(np.float32) / np.float32(255), stripe[..., None])
        if parcel.use == "field":
            rough = [(PATCH, 14), (BLOTCH, 12), (GRAIN, 16)]
            fill(page, parcel.area, (112, 116, 72), strength=0.6, grain=rough)
    fill(
        page,
        scenery.soil,
        (136, 118, 92),
        strength=0.7,
        grain=[(PATCH, 9), (BLOTCH, 8), (GRAIN, 7)],
    )
    fill(page, scenery.slabs, (166, 160, 151), grain=[(PATCH, 4), (GRAIN, 4.5)])
    _draw_joints(page, scenery.slabs, 1.2, 0.28)
    fill(page, scenery.gravel, (196, 182, 150), grain=[(PATCH, 5), (GRAIN, 9)])
    fill(page, scenery.ponds.buffer(0.45), (188, 184, 174), grain=[(GRAIN, 6)])
    fill(page, scenery.ponds, (58, 84, 88), grain=[(HILL, 4)])


def _draw_pavement(page: Page, roads: Roads, scenery: Scenery, day: Day) -> None:
    """Slabs between kerb and plots, paths off them, verges of grass."""
    paved = shapely.union_all([roads.paving.pavement, roads.walks.paths])
    fill(page, paved, SLAB, grain=[(PATCH, 4), (GRAIN, 4.5)])
    _draw_joints(page, paved, 0.6, 0.22)
    rim = roads.paving.pavement.boundary.buffer(0.08)
    fill(page, rim, (128, 124, 118), strength=0.8, only=roads.paving.pavement.buffer(0.1))
    palette = PALETTES[day.season]
    green = tuple(0.5 * a + 0.5 * b for a, b in zip((88, 108, 56), palette.grass, strict=True))
    fill(page, scenery.verges, (green[0], green[1], green[2]), grain=[(PATCH, 9), (GRAIN, 11)])
    fill(page, tactile_strips(roads), (204, 176, 84), strength=0.8, only=paved)


def _draw_joints(page: Page, area: Geometry, step: float, share: float) -> None:
    """Dark lines between slabs."""
    window, mask = mask_of(page, area)
    if mask.size:
        x, y = _metres(page, window)
        joint = (np.mod(x, step) < 0.05) | (np.mod(y, step) < 0.05)
        alpha = joint * mask.astype(np.float32) * np.float32(share / 255)
        lay(page.image[window], alpha, (108, 105, 100))


def _draw_tar(page: Page, roads: Roads) -> None:
    """Tar of several ages, worn where wheels pass, with oil, patches, cracks and covers."""
    road = shapely.union_all([roads.paving.carriageway, roads.paving.drive, roads.paving.lot])
    window, mask = mask_of(page, road)
    grey = np.float32(4) * noise(page, PATCH, window) + np.float32(2.5) * noise(
        page, BLOTCH, window
    )
    grey += np.float32(5.5) * noise(page, GRAIN, window) + np.float32(3) * noise(page, HILL, window)
    grey += _ages(page, roads, window)
    grey -= np.float32(6) * _strokes(page, window, _wheel_tracks(roads), 0.28)
    grey -= np.float32(6) * _strokes(page, window, _middles(roads), 0.4)
    grey -= np.float32(9) * _strokes(page, window, _waiting(roads), 0.45)
    tar = np.asarray(TAR, np.float32) + grey[..., None]
    lay(page.image[window], mask.astype(np.float32) / np.float32(255), tar)
    for outline, change in _patches(page, roads):
        shade(page, outline, change / 122, only=road)
        rim = shapely.LinearRing(outline).buffer(0.06)
        fill(page, rim, (74, 74, 75), strength=0.4, only=road)
    _draw_cracks(page, road)
    whole = outer_kerbs(roads.paving)
    gutter = whole.difference(whole.buffer(-0.5))
    shade(page, gutter, 0.13, only=road)
    for place in manholes(roads):
        fill(page, circle(place, 0.42), (92, 90, 86))
        fill(page, circle(place, 0.33), (70, 67, 64))


def _ages(page: Page, roads: Roads, window: Window) -> Float[Array, "h w"]:
    """How much paler or darker each arm, its halves and the car park are, grey levels."""
    rows, columns = window
    change = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.float32)
    shapes: list[Shape] = []
    for arm in roads.layout.arms:
        middle, half = divider(arm), half_width(arm)
        cut = page.generator.uniform(arm.mouth + 4, 60)
        for span in ((middle, half), (-half, middle)):
            shapes += [strip(arm, (arm.mouth, cut), span), strip(arm, (cut, FAR), span)]
    for shape in [*shapes, roads.paving.lot]:
        mask = mask_of(page, shape, within=window)[1]
        change += np.float32(page.generator.uniform(-11, 9) / 255) * mask.astype(np.float32)
    return change


def _strokes(
    page: Page, window: Window, lines: list[Float[Array, "_ 2"]], wide: float
) -> Float[Array, "h w"]:
    """Soft strokes along lines, 0 to 1."""
    rows, columns = window
    mask = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.uint8)
    start = np.array([columns.start, rows.start])
    thick = max(round(wide / page.resolution), 1)
    for line in lines:
        pixels = transform_points(page.image_from_plan, line) - start
        cv2.polylines(
            mask, [np.rint(pixels * 16).astype(np.int32)], False, 255, thick, cv2.LINE_AA, 4
        )
    soft = blur(mask, 0.5 * wide / page.resolution)
    return soft.astype(np.float32) / np.float32(255)


def _wheel_tracks(roads: Roads) -> list[Float[Array, "_ 2"]]:
    return [parallel(lane.centre, side) for lane in roads.lanes for side in (-WHEELS, WHEELS)]


def _middles(roads: Roads) -> list[Float[Array, "_ 2"]]:
    return [lane.centre for lane in roads.lanes]


def _waiting(roads: Roads) -> list[Float[Array, "_ 2"]]:
    """Behind stop lines, where oil drips."""
    lines = []
    for arm in roads.layout.arms:
        if np.isfinite(arm.stop):
            for rank in range(len(arm.turns)):
                spots = [[arm.stop + d, lane_in(arm, rank)] for d in (1.0, 6.0, 12.0)]
                lines.append(on_arm(arm, np.array(spots)))
    return lines


def _patches(page: Page, roads: Roads) -> list[tuple[Float[Array, "_ 2"], float]]:
    """Mended places and a trench: outlines, and grey levels that they are darker by."""
    patches = []
    for arm in roads.layout.arms:
        half = half_width(arm)
        for _ in range(2):
            along = page.generator.uniform(-4, 75)
            across = page.generator.uniform(-half + 0.5, half - 3.0)
            long, wide = page.generator.uniform(3, 10), page.generator.uniform(1.0, 3.2)
            change = float(page.generator.choice([16.0, 11.0, -9.0]))
            patches.append((strip(arm, (along, along + long), (across, across + wide)), change))
    arm = _pick(page, roads.layout.arms)
    across = page.generator.uniform(-0.7, 0.5) * half_width(arm)
    patches.append((strip(arm, (arm.mouth, 80.0), (across, across + 0.9)), 13.0))
    return patches


def _pick(page: Page, arms: tuple[Arm, ...]) -> Arm:
    return arms[int(page.generator.integers(len(arms)))]


def _draw_fresh_tar(page: Page, roads: Roads, day: Day, generator: np.random.Generator) -> None:
    """Places that have been mended since day 0."""
    for _ in range(day.changes // 3):
        arm = roads.layout.arms[int(generator.integers(len(roads.layout.arms)))]
        along, across = (
            generator.uniform(arm.mouth, 60.0),
            generator.uniform(-0.9, 0.1) * half_width(arm),
        )
        shape = strip(arm, (along, along + generator.uniform(5, 14)), (across, across + 3.2))
        fill(page, shape, (92, 92, 93), grain=[(GRAIN, 4)], only=roads.paving.carriageway)


def _draw_cracks(page: Page, road: Geometry) -> None:
    """Thin lines that wander along and across the roads."""
    low_x, low_y, high_x, high_y = road.bounds
    lines = []
    for _ in range(60):
        start = page.generator.uniform([low_x, low_y], [high_x, high_y])
        heading = page.generator.choice([0, np.pi / 2]) + page.generator.normal(0, 0.25)
        turns = np.cumsum(page.generator.normal(0, 0.35, 60)) * 0.35 + heading
        steps = np.stack([np.cos(turns), np.sin(turns)], 1) * 0.16
        lines.append(LineString(start + np.cumsum(steps, axis=0)))
    shapely.prepare(road)
    cracks = [np.array(line.coords) for line in lines if road.intersects(line)]
    window = slice(0, page.shape[0]), slice(0, page.shape[1])
    mask = _strokes(page, window, cracks, page.resolution)
    mask *= mask_of(page, road, within=window)[1].astype(np.float32) * np.float32(0.8 / 255)
    lay(page.image, mask, (70, 70, 72))


def _draw_islands(page: Page, roads: Roads, day: Day) -> None:
    """Raised ground: grass on large islands, stone on small ones."""
    palette = PALETTES[day.season]
    for island in shapely.get_parts(roads.paving.islands):
        if island.area > 60:
            fill(page, island, palette.grass, grain=[(PATCH, 9), (GRAIN, 11)])
            rim = island.difference(island.buffer(-1.6))
            fill(page, rim, (168, 140, 120), grain=[(GRAIN, 7)])
        else:
            fill(page, island, SLAB, grain=[(PATCH, 4), (GRAIN, 6)])


def _draw_kerbs(page: Page, roads: Roads) -> None:
    """Pale stones along every rim of the tar but the drive's."""
    rims = [
        outer_kerbs(roads.paving).exterior,
        *(p.boundary for p in shapely.get_parts(roads.paving.islands)),
    ]
    stones = shapely.union_all([rim.buffer(0.11) for rim in rims])
    stones = stones.difference(roads.paving.drive.buffer(0.3))
    fill(page, stones, KERB, strength=0.9, grain=[(GRAIN, 5)])


def _draw_paint(page: Page, roads: Roads) -> None:
    """Paint, worn off by chance."""
    tar = shapely.union_all([roads.paving.carriageway, roads.paving.lot]).buffer(-0.05)
    _draw_worn(page, cycle_strips(roads), (158, 66, 58), 0.8, tar)
    _draw_worn(page, paint(roads), WHITE, 0.9, tar)


def _draw_worn(
    page: Page, shapes: list[Float[Array, "_ 2"]], colour: Colour, cover: float, only: Geometry
) -> None:
    if not shapes:
        return
    window, mask = mask_of(page, shapes)
    left = np.float32(cover) - np.float32(0.10) * noise(page, PATCH, window)
    left -= np.float32(0.16) * np.maximum(noise(page, BLOTCH, window) - np.float32(0.9), 0)
    left = np.minimum(np.maximum(left, np.float32(0.25)), np.float32(0.95))
    inside = mask_of(page, only, within=window)[1].astype(np.float32) / np.float32(255)
    lay(page.image[window], left * inside * mask.astype(np.float32) / np.float32(255), colour)


def _metres(page: Page, window: Window) -> tuple[Float[Array, "1 w"], Float[Array, "h 1"]]:
    """Plan coordinates of a window's columns and rows."""
    rows, columns = window
    scale = page.resolution
    x = (np.arange(columns.start, columns.stop) + 0.5 - page.shape[1] / 2) * scale
    y = (page.shape[0] / 2 - np.arange(rows.start, rows.stop) - 0.5) * scale
    return x[None, :], y[:, None]
