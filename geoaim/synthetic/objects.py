"""What stands on the drawn ground: houses, trees, hedges, lamps, parked cars, and shadows."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.geometry import to_opencv, transform_points
from geoaim.synthetic.cutouts import draw_tree, draw_vehicle
from geoaim.synthetic.page import Page, circle
from geoaim.synthetic.plan import (
    LANE,
    MAIN_HALF,
    MAIN_STOP,
    SIDE_HALF,
    SIDE_STOP,
    on_main,
    on_side,
)
from geoaim.synthetic.texture import Colour, darken, lay

SUN = np.array([-0.62, -0.785])  # towards the sun in the image: right, down
SHADOW = -0.62 * SUN  # m of shadow for each metre of height, right and down
PAINTS: tuple[Colour, ...] = (
    (206, 208, 210), (236, 236, 233), (40, 42, 46), (128, 132, 137), (64, 68, 74),
    (118, 24, 26), (38, 66, 112), (168, 152, 118), (222, 222, 220), (52, 78, 66),
)  # fmt: skip


LEAVES: tuple[Colour, ...] = ((104, 132, 66), (86, 118, 58), (122, 136, 64), (96, 112, 60))
# Rectangles: centre and size in metres, angle in radians.
Block = tuple[tuple[float, float], tuple[float, float], float]
BLOCK: Block = ((-31.5, 29.0), (29.0, 22.0), 0.0)
HOUSES: tuple[tuple[Block, Colour], ...] = (
    (((-25.0, -22.5), (12.5, 9.5), 0.06), (150, 94, 74)),
    (((-45.5, -21.5), (13.5, 9.0), -0.04), (112, 108, 108)),
)
GARDEN_TREES = (
    (13, 19), (16, 31), (22, 17), (25.5, 36), (45, 16.5), (47, 24), (44, 34), (54, 19), (56, 30),
    (20, 25), (49, 40), (-34.5, -31), (-33.8, -14.8), (-14, -28), (-55, -31), (-56, -15),
    (-13.2, 14.5), (-13.2, 21.5), (-13, 28.5), (12.6, -24), (60, -23), (65, -18), (-51, 14.6),
)  # fmt: skip
SHRUBS = (
    (10.5, 13.5), (12, 14.6), (15, 13.2), (28, 13.8), (29.2, 15), (30.3, 13.6), (40.5, 33),
    (38.9, 34.2), (27.6, 31.5), (26.2, 22.4), (42, 21.4), (50.5, 20), (51.8, 28.6), (19, 29.4),
    (10.6, 24), (11.4, 33), (-30.5, -16.4), (-28.4, -16), (-20.2, -16.6), (-29, -28.6),
    (-26.4, -29), (-20, -28.4), (-52.8, -17), (-41, -27.4), (-47, -28), (-50, -26.8),
    (-39.6, -15.8), (-43, -15.6), (14.2, -21), (12.4, -28.4),
)  # fmt: skip
HEDGES = (
    ((-60.0, -12.2), (-37.6, -12.2)), ((-33.0, -12.2), (-17.4, -12.2)),
    ((-11.6, -16.0), (-12.4, -42.0)), ((-36.5, -22.0), (-36.5, -42.0)),
    ((13.0, -13.0), (35.0, -13.0)), ((43.0, -13.0), (62.0, -13.0)),
    ((-47.0, 13.4), (-39.0, 13.4)), ((-33.0, 13.2), (-24.0, 12.9)),
)  # fmt: skip


@dataclass(frozen=True)
class _Stamp:
    """A picture that stands on the plan: its middle (metres), heading, and height (metres)."""

    place: Float[Array, "2"]
    heading: float
    sprite: UInt8[Array, "_ _ 4"]
    height: float


def draw_objects(page: Page) -> None:
    """Shadows first, then what casts them."""
    trees, cars = _plant_trees(page), _park_cars(page)
    _cast_shadows(page, [*trees, *cars])
    for car in cars:
        _press(page.image, page, car)
    _draw_hedges(page)
    _draw_flat_roof(page)
    for house, colour in HOUSES:
        _draw_pitched_roof(page, house, colour)
    for tree in trees:
        _press(page.image, page, tree)
    for foot, tip in _lamps():
        lay(page.image, page.mask(_bar(foot, tip, 0.07)), (196, 198, 198))
        lay(page.image, page.mask(circle(foot, 0.16)), (120, 122, 124))


def _plant_trees(page: Page) -> list[_Stamp]:
    """Rows along the roads and groups in the plots."""
    along = np.array([26.5, 34.0, 43.5, 51.5, 60.0])
    rows = []
    for sign in (-1, 1):
        for side in (-1, 1):
            offset = np.full(5, side * (MAIN_HALF + 1.2))
            rows.append(on_main(np.stack([sign * along, offset], axis=1)))
            offset = np.full(5, side * (SIDE_HALF + 1.2))
            rows.append(on_side(np.stack([sign * along, offset], axis=1)))
    street = np.concatenate(rows)
    street = street[~((np.abs(street[:, 0] - 39) < 5.5) & (street[:, 1] < 0))]
    groups = ((street, 1.3, 1.9), (np.array(GARDEN_TREES), 2.2, 3.6), (np.array(SHRUBS), 0.5, 1.1))
    places = np.concatenate([group for group, _, _ in groups])
    places[len(street) :] += page.generator.normal(0, 0.4, (len(places) - len(street), 2))
    radii = np.concatenate([page.generator.uniform(a, b, len(group)) for group, a, b in groups])
    trees = []
    for place, radius in zip(places, radii.tolist(), strict=True):
        colour = LEAVES[page.generator.integers(len(LEAVES))]
        pixels = round(radius / page.metres_per_pixel)
        crown = draw_tree(pixels, colour, (SUN[0], SUN[1]), page.generator)
        trees.append(_Stamp(place, 0.0, crown, 1.6 * radius))
    return trees


def _park_cars(page: Page) -> list[_Stamp]:
    """Cars in some bays of the car park, and on the drives of the houses."""
    generator = page.generator
    places = [(-35.2, -20.0, np.pi / 2), (-15.2, -19.0, np.pi / 2)]
    for y, taken in ((-16.6, 0.75), (-29.0, 0.6)):
        bays = np.arange(16.36, 61, 2.6)
        bays = bays[(generator.uniform(size=len(bays)) < taken)]
        bays = bays[(bays < 34) | (bays > 43)] if y > -20 else bays
        places += [(x, y, float(generator.choice([-1, 1])) * np.pi / 2) for x in bays.tolist()]
    cars = []
    for x, y, heading in places:
        paint = PAINTS[generator.integers(len(PAINTS))]
        sprite = draw_vehicle(generator.uniform(3.9, 4.7), 1.8, paint, page.metres_per_pixel)
        place = np.array([x, y]) + generator.normal(0, 0.12, 2)
        cars.append(_Stamp(place, heading + generator.normal(0, 0.02), sprite, 1.3))
    return cars


def _lamps() -> list[tuple[Float[Array, "2"], Float[Array, "2"]]]:
    """Foot and tip of the lamps along the roads and of the masts of the signals."""
    rows = []
    for s in (-47.5, -30.0, 30.0, 47.5):
        for o in (-1, 1):
            foot_and_tip = [[s, o * (MAIN_HALF + 0.6)], [s, o * (MAIN_HALF - 1.6)]]
            rows.append(on_main(np.array(foot_and_tip)))
    for sign in (-1, 1):
        mast = sign * np.array([[MAIN_STOP - 0.6, MAIN_HALF + 0.7], [MAIN_STOP - 0.6, LANE]])
        rows.append(on_main(mast))
        mast = sign * np.array([[SIDE_STOP - 0.6, -SIDE_HALF - 0.7], [SIDE_STOP - 0.6, -LANE / 2]])
        rows.append(on_side(mast))
    return [(row[0], row[1]) for row in rows]


def _cast_shadows(page: Page, stamps: list[_Stamp]) -> None:
    """Darken the ground away from the sun; where shadows meet, it is not darker."""
    throw = SHADOW * [1, -1]
    solids = [_swept(_turned(*house), 5.0 * throw) for house, _ in HOUSES]
    solids.append(_swept(_turned(*BLOCK), 9.0 * throw))
    for foot, tip in _lamps():
        solids.append(_bar(foot, foot + 7.0 * throw, 0.08))
        solids.append(_bar(foot + 7.0 * throw, tip + 7.0 * throw, 0.08))
    shade = page.mask(*solids)
    for stamp in stamps:
        cast = replace(stamp, place=stamp.place + stamp.height * throw)
        _press(shade, page, cast)
    shade = np.asarray(cv2.GaussianBlur(shade, (0, 0), 0.07 / page.metres_per_pixel))
    darken(page.image, shade, np.array([0.58, 0.55, 0.47]))


def _press(canvas: Float32[Array, "H W *c"], page: Page, stamp: _Stamp) -> None:
    """Lay a stamp on a picture, or its outline on a mask."""
    rows, columns = stamp.sprite.shape[:2]
    u, v = transform_points(page.image_from_plan, stamp.place[None])[0]
    c, s = np.cos(stamp.heading), np.sin(stamp.heading)
    radius = int(np.hypot(rows, columns) / 2) + 2
    left, top = int(u) - radius, int(v) - radius
    matrix = np.array([[c, s, u - left], [-s, c, v - top], [0, 0, 1]])
    matrix = matrix @ np.array([[1, 0, -columns / 2], [0, 1, -rows / 2], [0, 0, 1]])
    side = 2 * radius
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + side, canvas.shape[1]), min(top + side, canvas.shape[0])
    if x1 <= x0 or y1 <= y0:
        return
    patch = cv2.warpAffine(stamp.sprite.astype(np.float32), to_opencv(matrix)[:2], (side, side))
    patch = patch[y0 - top : y1 - top, x0 - left : x1 - left]
    window = canvas[y0:y1, x0:x1]
    if canvas.ndim == 2:
        np.maximum(window, patch[..., 3] / 255, out=window)
    else:
        lay(window, patch[..., 3] / 255, patch[..., :3])


def _draw_hedges(page: Page) -> None:
    leaves, clumps = page.noise(0.6), page.noise(1.0)
    green = np.array([74, 98, 50]) + 12 * clumps[..., None] + 12 * leaves[..., None]
    ragged = page.mask(*[_bar(np.array(a), np.array(b), 0.55) for a, b in HEDGES])
    throw = SHADOW * [1, -1] * 1.1
    shade = page.mask(*[_swept(_bar(np.array(a), np.array(b), 0.5), throw) for a, b in HEDGES])
    darken(page.image, shade, 0.5)
    blurred = cv2.GaussianBlur(ragged, (0, 0), 4) + 0.10 * clumps + 0.05 * leaves
    lay(page.image, ((np.asarray(blurred) - 0.45) * 6).clip(0, 1) * (blurred > 0.3), green)


def _draw_flat_roof(page: Page) -> None:
    """Gravel, a parapet, a stair house, skylights and machines, with their shadows."""
    (x, y), (wide, high), angle = BLOCK
    throw = SHADOW * [1, -1]
    coarse, fine = page.noise(1.3), page.noise(0.2)
    gravel = np.array([158, 155, 150]) + 5 * coarse[..., None] + 7 * fine[..., None]
    lay(page.image, page.mask(_turned(*BLOCK)), (206, 203, 197))
    inner = page.mask(_turned((x, y), (wide - 1.0, high - 1.0), angle))
    lay(page.image, inner, gravel)
    rim = page.mask(_turned((x + 0.45, y - 0.55), (wide - 1.0, high - 1.0), angle))
    darken(page.image, inner * (1 - rim), 0.4)
    things: list[tuple[tuple[float, float], tuple[float, float], float, Colour]] = [
        ((8.5, 3.0), (6.0, 4.2), 2.6, (184, 180, 172)),  # the stairs
        ((-9.0, -5.0), (3.0, 2.2), 1.5, (198, 200, 202)),
        ((-4.5, -5.0), (3.0, 2.2), 1.5, (190, 192, 194)),
        ((2.0, 5.0), (2.4, 1.6), 1.0, (205, 206, 206)),
        ((6.5, -6.5), (1.2, 1.2), 1.2, (150, 152, 154)),
        ((9.5, -6.5), (1.2, 1.2), 1.2, (150, 152, 154)),
        *[((4.2 * k - 10.0, 0.8), (2.8, 1.5), 0.5, (108, 134, 152)) for k in range(4)],  # skylights
    ]
    for (right, up), size, height, colour in things:
        body = _turned((x + right, y + up), size, angle)
        darken(page.image, inner * page.mask(_swept(body, height * throw)), 0.5)
        lay(page.image, page.mask(body), colour)


def _draw_pitched_roof(page: Page, house: Block, colour: Colour) -> None:
    """Two slopes of tiles, one in the sun, with a ridge and a chimney."""
    a, b, c, d = _turned(*house)
    angle = house[2]
    ridge = [(b + c) / 2, (a + d) / 2]
    slopes = ((np.array([a, b, *ridge]), 0.78), (np.array([d, c, *ridge]), 1.08))
    coarse, fine = page.noise(1.0), page.noise(0.3)
    v, u = np.indices(page.shape, np.float32) * page.metres_per_pixel
    rows = np.sin((v * np.cos(angle) + u * np.sin(angle)) * 2 * np.pi / 0.36)
    tiles = np.array(colour) * (1 + 0.05 * coarse + 0.06 * fine + 0.05 * rows)[..., None]
    for slope, light in slopes:
        lay(page.image, page.mask(slope), tiles * light)
    lay(page.image, page.mask(_bar((a + d) / 2, (b + c) / 2, 0.14)), np.array(colour) * 1.15 + 8)
    foot = 0.7 * (a + d) / 2 + 0.3 * (b + c) / 2 + (d - a) * 0.12
    chimney = _turned((foot[0], foot[1]), (1.1, 0.8), angle)
    darken(page.image, page.mask(_swept(chimney, SHADOW * [1, -1] * 1.6)), 0.45)
    lay(page.image, page.mask(chimney), (140, 84, 70))


def _turned(
    centre: tuple[float, float], size: tuple[float, float], angle: float
) -> Float[Array, "4 2"]:
    """Corners of a rectangle of some width and height, turned about its middle."""
    half = np.array(size) / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return half @ turn + np.array(centre)


def _bar(start: Array, end: Array, half: float) -> Float[Array, "4 2"]:
    """A thin rectangle from one point to another."""
    along = (end - start) / np.hypot(*(end - start))
    side = half * np.array([-along[1], along[0]])
    return np.array([start + side, end + side, end - side, start - side])


def _swept(corners: Float[Array, "_ 2"], throw: Float[Array, "2"]) -> Float[Array, "_ 2"]:
    """The convex hull of a polygon and of itself moved: the shadow of an upright prism."""
    both = np.concatenate([corners, corners + throw]).astype(np.float32)
    return np.asarray(cv2.convexHull(both), np.float64)[:, 0]
