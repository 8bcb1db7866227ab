"""A four-way signalised junction, drawn from above: ground, markings, houses, trees."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.geometry import transform_points
from geoaim.synthetic.objects import draw_objects
from geoaim.synthetic.page import Page, circle
from geoaim.synthetic.plan import (
    LANE,
    MAIN_HALF,
    MAIN_STOP,
    MANHOLES,
    PAVEMENT,
    SIDE_HALF,
    SIDE_STOP,
    bend,
    cycle_crossings,
    distance_to_kerb,
    landmarks,
    markings,
    on_main,
    on_side,
    rectangle,
    slant,
    tactile_strips,
)
from geoaim.synthetic.texture import (
    Colour,
    darken,
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
        landmarks: names of points that a surveyor would choose.
        marks: (M, 2) those points in plan metres.
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
    height: float = 67.0,
    width: float = 112.0,
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
    _draw_lawns(page, x, y)
    _draw_yard(page, x, y)
    _draw_park(page, x, y)
    _draw_car_park(page)
    _draw_pavement(page, x, y, to_kerb)
    _draw_asphalt(page, x, y, to_kerb)
    _draw_markings(page, to_kerb)
    draw_objects(page)
    _grade(page)
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


def _draw_lawns(page: Page, x: Array, y: Array) -> None:
    """Grass everywhere, dry in places, mown in stripes in the park."""
    coarse, fine = page.noise(1.3)[..., None], page.noise(0.35)[..., None]
    grass = np.array([104, 118, 70]) + coarse * [9, 10, 6] + fine * [11, 12, 8]
    lay(page.image, np.ones(page.shape, np.float32), grass)
    lay(page.image, (0.45 * (page.noise(1.8) - 0.4)).clip(0, 0.6), (150, 142, 92))
    mown = np.sin((x * 0.9 + y * 0.5) * 2.2)
    darken(page.image, np.sign(mown) * ((x > 0) & (y > 0)), 0.025)


def _draw_yard(page: Page, x: Array, y: Array) -> None:
    """Slabs around the block, and the drives of the houses."""
    coarse, fine = page.noise(1.3)[..., None], page.noise(0.35)[..., None]
    joint = ((np.mod(x, 1.2) < 0.06) | (np.mod(y, 1.2) < 0.06)) * 0.28
    yard = page.mask(rectangle(-60, 11, -10.5, 60))
    lay(page.image, yard, np.array([168, 162, 152]) + 3 * coarse + 4 * fine)
    lay(page.image, yard * joint, (116, 110, 102))
    drives = page.mask(rectangle(-37.0, -25, -33.4, -9), rectangle(-17.2, -24, -13.2, -9))
    lay(page.image, drives, np.array([150, 143, 134]) + 7 * fine)


def _draw_park(page: Page, x: Array, y: Array) -> None:
    """Gravel paths, one of them around a pond."""
    coarse, fine = page.noise(1.3), page.noise(0.35)
    across = np.abs(y - 13 - 0.55 * (x - 9) - 2.2 * np.sin(x / 6))
    path = np.minimum(across, np.abs(np.hypot(x - 34, y - 27) - 7.5))
    park = page.mask(rectangle(9, 11, 80, 60))
    gravel = np.array([196, 182, 150]) + 5 * coarse[..., None] + 9 * fine[..., None]
    lay(page.image, park * soft(path - 1.15, 0.15), (150, 140, 112))
    lay(page.image, park * soft(path - 1.05, 0.15), gravel)
    pond = np.hypot(x - 34, (y - 27) * 1.1) - 3.9 - 0.25 * coarse
    lay(page.image, soft(pond - 0.45, 0.2), (188, 184, 174))
    lay(page.image, soft(pond, 0.15), np.array([58, 84, 88]) + 4 * page.noise(1.8)[..., None])


def _draw_car_park(page: Page) -> None:
    """Tar, bays, and the way in from the main road."""
    tar = 116 + 5 * page.noise(1.3) + 6 * page.noise(0.35) + 5 * page.noise(1.8)
    lot = page.mask(rectangle(14, -60, 62, -13.4), rectangle(36, -15, 42, 0))
    lay(page.image, lot, tar[..., None] * np.array([1.0, 0.99, 0.975]))
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
    far = soft(26 - np.hypot(x - slant(y), y - bend(x)), 0.3)
    verge = soft(np.abs(to_kerb - 1.15) - 0.75, 0.08) * far * ~drive
    green = np.array([88, 108, 56]) + 9 * coarse[..., None] + 11 * fine[..., None]
    lay(page.image, verge, green)
    lay(page.image, band * drive, np.array([112, 111, 110]) + 5 * fine[..., None])


def _draw_asphalt(page: Page, x: Array, y: Array, to_kerb: Array) -> None:
    """Tar of several ages, worn where wheels pass, with oil, patches, cracks and kerbs."""
    fine = page.noise(0.3)
    tar = _wear(page, x, y)[..., None] * np.array([1.0, 0.995, 0.975]) + 5.5 * fine[..., None]
    road = soft(to_kerb, 0.06)
    lay(page.image, road, tar)
    for polygon, change in _patches(page.generator):
        mask = road * page.mask(polygon)
        lay(page.image, mask * 0.85, tar + change)
        edge = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, np.ones((3, 3))))
        lay(page.image, edge * 0.4, (74, 74, 75))
    lay(page.image, road * _cracks(page) * 0.5, (70, 70, 72))
    gutter = np.exp(-(((to_kerb + 0.1) / 0.35) ** 2)) * (to_kerb < 0.05)
    darken(page.image, gutter, 0.16)
    lay(page.image, soft(np.abs(to_kerb - 0.1) - 0.11, 0.06), (196, 193, 186))
    covers = on_main(np.array(MANHOLES))
    lay(page.image, page.mask(*[circle(place, 0.42) for place in covers]), (92, 90, 86))
    lay(page.image, page.mask(*[circle(place, 0.33) for place in covers]), (70, 67, 64))


def _wear(page: Page, x: Array, y: Array) -> Float32[Array, "H W"]:
    """The grey level of the tar."""
    main, side = y - bend(x), x - slant(y)
    is_side = np.abs(main) > MAIN_HALF + 1.0
    from_middle = np.where(is_side, np.abs(main) - MAIN_HALF, np.abs(side) - SIDE_HALF)
    outside = (from_middle / 6.0).clip(0, 1)  # wheels keep to their lanes outside of the middle
    main_lane = np.mod(np.abs(main), LANE) - LANE / 2
    offset = np.where(is_side, np.mod(side + LANE / 2, LANE) - LANE / 2, main_lane)
    wheels = np.exp(-(((np.abs(offset) - 0.8) / 0.3) ** 2)) * outside
    behind = np.where(is_side, np.abs(main) - SIDE_STOP, np.abs(side) - MAIN_STOP)
    oil = np.exp(-((offset / 0.4) ** 2)) * outside * (4 + 9 * np.exp(-((behind / 14).clip(0) ** 2)))
    age = np.where(is_side, 7.0, np.where(main < 0, -9.0, 0.0) * (np.abs(side) > SIDE_HALF + 11.4))
    age = np.where((side > 31) & (main > 0) & ~is_side, -20.0, age)
    streaks = cv2.blur(page.noise(0.8), (121, 3)) * 2.5 * ~is_side
    grey = 122 + age + 4 * page.noise(1.5) + 2.5 * page.noise(0.9) + streaks
    return np.asarray(grey - 6 * wheels - oil, np.float32)


def _patches(generator: np.random.Generator) -> list[tuple[Float[Array, "_ 2"], float]]:
    places = [(-44, 3.0, 7, 2.6), (22, -6.6, 9, 3.1), (-3, -2, 4.5, 3.2), (48, 4.6, 6, 2.0)]
    patches = [
        (on_main(rectangle(s, o, s + long, o + wide)), float(generator.choice([-16, -11, 9])))
        for s, o, long, wide in places
    ]
    trench = on_side(rectangle(-70, -3.6, -9, -2.7))
    return [*patches, (trench, -13.0), (on_side(rectangle(19, 0.2, 25, 3.0)), 8.0)]


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


def _draw_markings(page: Page, to_kerb: Array) -> None:
    """Paint, worn off by chance."""
    wear, spots = page.noise(1.1), page.noise(0.5)
    paint = (0.88 - 0.10 * wear - 0.16 * (spots - 0.9).clip(0)).clip(0.25, 0.95)
    lay(
        page.image,
        page.mask(*cycle_crossings()) * soft(to_kerb, 0.06) * (paint - 0.1),
        (158, 66, 58),
    )
    lay(page.image, page.mask(*tactile_strips()) * soft(0.3 - to_kerb, 0.06) * 0.8, (204, 176, 84))
    lay(page.image, page.mask(*markings()) * paint, WHITE)


def _grade(page: Page) -> None:
    """Uneven light, and the haze that lifts the shadows of a picture from the air."""
    light = 1 + 0.025 * page.noise(2.0)
    page.image[:] = (page.image * light[..., None]) * [1.0, 0.995, 0.98] + [7, 8, 11]
