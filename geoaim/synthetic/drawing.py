"""A four-way signalised junction, drawn from above: ground, markings, houses, trees."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.geometry import transform_points
from geoaim.synthetic.objects import draw_objects
from geoaim.synthetic.page import Page
from geoaim.synthetic.plan import (
    LANE,
    MAIN_HALF,
    MAIN_STOP,
    MANHOLES,
    PAVEMENT,
    SIDE_HALF,
    SIDE_STOP,
    bend,
    distance_to_kerb,
    landmarks,
    markings,
    on_main,
    on_side,
    rectangle,
    slant,
)
from geoaim.synthetic.texture import (
    Colour,
    lay,
    soft,
)
from geoaim.world import World

WHITE: Colour = (222, 222, 216)


@dataclass(frozen=True)
class Junction:
    """A drawn place.

    Attributes:
        image: (H, W, 3) the ground without moving traffic.
        image_from_plan: (3, 3) plan metres to pixels.
        world_from_image: (3, 3) pixels to world metres.
        world: the plane of those metres.
        landmarks: names and (M, 2) plan coordinates of points that a surveyor would choose.
        marks: (M, 2) those points.
    """

    image: UInt8[Array, "H W 3"]
    image_from_plan: Float[Array, "3 3"]
    world_from_image: Float[Array, "3 3"]
    world: World
    landmarks: tuple[str, ...]
    marks: Float[Array, "M 2"]


def draw_junction(
    generator: np.random.Generator,
    *,
    width: float = 136.0,
    height: float = 84.0,
    metres_per_pixel: float = 0.05,
) -> Junction:
    """Draw a junction of `width` by `height` metres; the same generator state, the same picture."""
    rows, columns = round(height / metres_per_pixel), round(width / metres_per_pixel)
    scale = 1 / metres_per_pixel
    image_from_plan = np.array([[scale, 0, columns / 2], [0, -scale, rows / 2], [0, 0, 1.0]])
    x = ((np.arange(columns, dtype=np.float32) + 0.5) / scale - width / 2)[None, :]
    y = (height / 2 - (np.arange(rows, dtype=np.float32) + 0.5) / scale)[:, None]
    image = np.zeros((rows, columns, 3), np.float32)
    page = Page(image, image_from_plan, metres_per_pixel, generator)
    to_kerb = distance_to_kerb(x, y)
    _draw_plots(page, x, y)
    _draw_pavement(page, x, y, to_kerb)
    _draw_asphalt(page, x, y, to_kerb)
    _draw_markings(page)
    draw_objects(page)
    turn = np.radians(-24.0)  # the drone does not look north
    world_from_plan = np.array(
        [[np.cos(turn), -np.sin(turn), 180.0], [np.sin(turn), np.cos(turn), 240.0], [0, 0, 1]]
    )
    names, marks = landmarks()
    return Junction(
        image=np.rint(image.clip(0, 255)).astype(np.uint8),
        image_from_plan=image_from_plan,
        world_from_image=world_from_plan @ np.linalg.inv(image_from_plan),
        world=World("EPSG:32635", (583000.0, 6062000.0)),
        landmarks=names,
        marks=marks,
    )


def _draw_plots(page: Page, x: Array, y: Array) -> None:
    """Grass everywhere; paved yards, paths and a car park in it."""
    coarse, fine, dry = page.noise(1.3), page.noise(0.35), page.noise(1.8)
    grass = np.array([92, 112, 58]) + coarse[..., None] * [9, 10, 6] + fine[..., None] * [11, 12, 8]
    lay(page.image, np.ones(page.shape, np.float32), grass)
    lay(page.image, (0.45 * (dry - 0.4)).clip(0, 0.6), (150, 142, 92))
    mown = np.sin((x * 0.9 + y * 0.5) * 2.2)
    page.image *= 1 + 0.025 * np.sign(mown)[..., None] * ((x > 0) & (y > 0))[..., None]
    paving = np.array([168, 162, 152]) + 3 * coarse[..., None] + 4 * fine[..., None]
    joint = ((np.mod(x, 1.2) < 0.06) | (np.mod(y, 1.2) < 0.06)) * 0.28
    yard = page.mask(rectangle(-60, 11, -10.5, 60))
    lay(page.image, yard, paving)
    lay(page.image, yard * joint, (116, 110, 102))
    path = np.minimum(
        np.abs(y - 13 - 0.55 * (x - 9) - 2.2 * np.sin(x / 6)),
        np.abs(np.hypot(x - 34, y - 27) - 7.5),
    )
    park = page.mask(rectangle(9, 11, 80, 60))
    gravel = np.array([196, 182, 150]) + 5 * coarse[..., None] + 9 * fine[..., None]
    lay(page.image, park * soft(path - 1.15, 0.15), (150, 140, 112))
    lay(page.image, park * soft(path - 1.05, 0.15), gravel)
    pond = np.hypot(x - 34, (y - 27) * 1.1) - 3.9 - 0.25 * coarse
    lay(page.image, soft(pond - 0.45, 0.2), (188, 184, 174))
    lay(page.image, soft(pond, 0.15), np.array([58, 84, 88]) + 4 * dry[..., None])
    lot = page.mask(rectangle(14, -60, 62, -13.4), rectangle(36, -15, 42, 0))
    tar = np.array([98, 98, 100]) + 3.5 * coarse[..., None] + 5 * fine[..., None]
    lay(page.image, lot, tar)
    bays = [
        rectangle(s, y0, s + 0.12, y0 + 4.9)
        for y0 in (-19.0, -31.5)
        for s in np.arange(15.0, 62, 2.6)
        if not (y0 > -20 and 35 < s < 42.5)
    ]
    lay(page.image, page.mask(*bays) * 0.8, WHITE)


def _draw_pavement(page: Page, x: Array, y: Array, to_kerb: Array) -> None:
    """Slabs between kerb and plots, and a verge of grass away from the crossings."""
    coarse, fine = page.noise(1.2), page.noise(0.3)
    slabs = np.array([152, 149, 144]) + 4 * coarse[..., None] + 4.5 * fine[..., None]
    drive = (np.abs(x - 39) < 3) & (y < 0)
    band = soft(to_kerb - PAVEMENT, 0.06)
    lay(page.image, band, slabs)
    joint = ((np.mod(x, 0.6) < 0.045) | (np.mod(y, 0.6) < 0.045)) * 0.22
    lay(page.image, band * joint, (104, 102, 98))
    lay(page.image, soft(np.abs(to_kerb - PAVEMENT) - 0.08, 0.06), (128, 124, 118))
    far = np.hypot(x - slant(y), y - bend(x)) > 24
    verge = soft(np.abs(to_kerb - 1.15) - 0.75, 0.08) * (far & ~drive)
    green = np.array([88, 108, 56]) + 9 * coarse[..., None] + 11 * fine[..., None]
    lay(page.image, verge, green)
    lay(page.image, band * drive, np.array([112, 111, 110]) + 5 * fine[..., None])


def _draw_asphalt(page: Page, x: Array, y: Array, to_kerb: Array) -> None:
    """Tar with wear along the wheels' ways, oil before the stop lines, patches, cracks, kerbs."""
    coarse, fine, blotch = page.noise(1.4), page.noise(0.25), page.noise(0.9)
    along_main, along_side = np.abs(x - slant(y)), np.abs(y - bend(x))
    lane_main = np.mod(np.abs(y - bend(x)), LANE) - LANE / 2
    lane_side = np.mod(x - slant(y) + LANE / 2, LANE) - LANE / 2
    is_side = (along_side > MAIN_HALF) & (along_main < SIDE_HALF + 3)
    offset = np.where(is_side, lane_side, lane_main)
    middle = (along_main < SIDE_HALF + 2) & (along_side < MAIN_HALF + 2)
    wheels = np.exp(-(((np.abs(offset) - 0.8) / 0.32) ** 2)) * ~middle
    oil = np.exp(-((offset / 0.4) ** 2)) * ~middle
    before = np.where(is_side, along_side - SIDE_STOP, along_main - MAIN_STOP)
    waiting = np.exp(-((before / 16).clip(0) ** 2)) * (before > -1)
    tone = 101 + 3.2 * coarse + 5.5 * fine + 2.5 * blotch - 4 * wheels - oil * (3 + 9 * waiting)
    tone += np.where(is_side, -6, 0) + 4 * middle
    tar = tone[..., None] * np.array([1.0, 1.0, 1.015])
    road = soft(to_kerb, 0.06)
    lay(page.image, road, tar)
    for polygon, change in _patches(page.generator):
        lay(page.image, road * page.mask(polygon) * 0.85, tar + change)
        edge = cv2.morphologyEx(page.mask(polygon), cv2.MORPH_GRADIENT, np.ones((3, 3)))
        lay(page.image, road * edge * 0.5, (58, 58, 60))
    lay(page.image, road * _cracks(page) * 0.55, (54, 54, 56))
    lay(page.image, soft(np.abs(to_kerb + 0.22) - 0.2, 0.06) * 0.5, (84, 82, 78))
    lay(page.image, soft(np.abs(to_kerb - 0.1) - 0.11, 0.06), (184, 181, 174))
    lay(
        page.image,
        page.mask(*[circle(place, 0.36) for place in on_main(np.array(MANHOLES))]),
        (66, 64, 62),
    )


def _patches(generator: np.random.Generator) -> list[tuple[Float[Array, "n 2"], float]]:
    places = [(-44, 3.0, 7, 2.6), (22, -6.6, 9, 3.1), (-3, -2, 4.5, 3.2), (48, 4.6, 6, 2.0)]
    patches = [
        (on_main(rectangle(s, o, s + long, o + wide)), float(generator.choice([-13, -8, 9])))
        for s, o, long, wide in places
    ]
    trench = on_side(rectangle(-70, -3.6, -9, -2.7))
    return [*patches, (trench, -10.0), (on_side(rectangle(19, 0.2, 25, 3.0)), 8.0)]


def _cracks(page: Page) -> Float32[Array, "H W"]:
    """Thin lines that wander along and across the roads."""
    mask = np.zeros(page.shape, np.uint8)
    for _ in range(46):
        start = page.generator.uniform([-66, -40], [66, 40])
        heading = page.generator.choice([0, np.pi / 2]) + page.generator.normal(0, 0.25)
        turns = np.cumsum(page.generator.normal(0, 0.35, 60)) * 0.35 + heading
        steps = np.stack([np.cos(turns), np.sin(turns)], 1) * 0.16
        line = transform_points(page.image_from_plan, start + np.cumsum(steps, axis=0))
        cv2.polylines(mask, [np.rint(line * 16).astype(np.int32)], False, 255, 1, cv2.LINE_AA, 4)
    return np.asarray(mask, np.float32) / 255


def _draw_markings(page: Page) -> None:
    """White paint, worn off where wheels pass and by chance."""
    wear, spots = page.noise(1.1), page.noise(0.5)
    paint = (0.86 - 0.10 * wear - 0.16 * (spots - 0.9).clip(0)).clip(0.25, 0.95)
    lay(page.image, page.mask(*markings()) * paint, WHITE)
