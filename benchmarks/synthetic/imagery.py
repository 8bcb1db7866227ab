"""Third-party imagery of a synthetic place: another day, another sensor, misplaced."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from benchmarks.synthetic.compositing import compute_image_poses, draw_agents, paste
from benchmarks.synthetic.exact import blur, pack, resize, warp
from benchmarks.synthetic.place import RESOLUTION, Place, draw_place, world_from_image
from benchmarks.synthetic.roads.layouts import PLACE_KINDS
from benchmarks.synthetic.roads.plan import HEIGHT_M, WIDTH_M
from benchmarks.synthetic.scenery.day import SEASONS, Day
from geoaim.base.geometry import image_corners, transform_points, translation
from geoaim.base.grid import Grid, fit_affine
from geoaim.base.world import crs_from_world
from geoaim.imagery.tiles import HALF_WORLD_M
from geoaim.tracks.tracks import Tracks

TILE = 256  # px
IMAGERY = 30  # stream of random numbers
# a satellite's or an aeroplane's sensor
SENSOR_RESOLUTION = 0.2  # metres per pixel on the ground, unless another is asked for
BLUR, NOISE = 0.6, 2.5  # standard deviations in pixels and in grey levels
GAMMA = 0.9  # exponent of its grey levels
BALANCE = (1.04, 1.0, 0.93)  # gain of red, green and blue
MIX = 0.15  # how far its channels are mixed with grey, 0 to 1


@dataclass(frozen=True, eq=False)
class Imagery:
    """A georeferenced image."""

    image: UInt8[Array, "H W 3"]  # RGB, north up
    covered: Bool[Array, "H W"]  # pixels that show the place
    crs: str  # a projected CRS
    crs_from_image: Float[Array, "3 3"]  # pixels (corner origin) to stated coordinates


def make_other_day(place: Place) -> Day:
    """Make a day of another season and sun than day 0, with changes on the ground."""
    generator = _make_generator(place)
    return Day(
        season=SEASONS[int(generator.choice([0, 2, 3]))],
        azimuth=float(generator.uniform(0, 2 * np.pi)),
        elevation=float(generator.uniform(0.5, 0.95)),
        clouds=float(generator.choice([0.0, 0.0, 0.5])),
        number=1 + int(generator.integers(1000)),
        changes=6,
    )


def photograph(
    place: Place,
    day: Day,
    tracks: Tracks,
    *,
    sensor_resolution: float = SENSOR_RESOLUTION,
    resolution: float = RESOLUTION,
) -> UInt8[Array, "_ _ 3"]:
    """Photograph a place, with the agents where they are at the first time of the tracks.

    Args:
        place: the place.
        day: the day.
        tracks: the traffic, in the place's world.
        sensor_resolution: metres per pixel of the photo.
        resolution: metres per pixel at which the place is drawn before the sensor reduces it.

    Returns:
        RGB image of the whole drawn place, at `sensor_resolution`.
    """
    generator = _make_generator(place, day.number)
    still = draw_place(place, day, resolution=resolution)
    agents = draw_agents(tracks, resolution, generator)
    paste(still, agents, compute_image_poses(place, tracks, resolution)[0])
    return _apply_sensor(still, sensor_resolution, generator)


def georeference_photo(
    place: Place, photo: UInt8[Array, "_ _ 3"], crs: str, *, offset: tuple[float, float]
) -> Imagery:
    """Resample a photo onto a north-up grid of a CRS, and misplace it.

    Args:
        place: the place.
        photo: the result of `photograph`: a photo of the whole drawn place.
        crs: a projected CRS in metres.
        offset: metres east and north by which the stated position is off the true one.

    Returns:
        The north-up imagery, with the wrong position in its transform.
    """
    rows, columns = photo.shape[:2]
    grid = Grid((rows, columns), world_from_image(place, WIDTH_M / columns))
    crs_from_photo, _ = fit_affine(grid, place.world, crs)
    unit = np.sqrt(abs(np.linalg.det(crs_from_photo)))  # units of the CRS per pixel of the photo
    pixel = float(np.float32(unit))  # the same number on every machine
    # north up, with its corner on whole units of the CRS
    corners = transform_points(crs_from_photo, image_corners(rows, columns))
    left, low = np.floor(corners.min(axis=0))
    right, top = np.ceil(corners.max(axis=0))
    height, width = round((top - low) / pixel), round((right - left) / pixel)
    crs_from_image = np.array([[pixel, 0, left], [0, -pixel, top], [0, 0, 1.0]])
    photo_from_image = np.linalg.inv(crs_from_photo) @ crs_from_image
    image, covered = _resample(photo, photo_from_image, height, width)
    middle = place.world_from_plan[None, :2, 2]
    here, there = (crs_from_world(place.world, spot, crs)[0] for spot in (middle, middle + offset))
    return Imagery(image, covered, crs, translation(*(there - here)) @ crs_from_image)


def draw_offset(place: Place) -> tuple[float, float]:
    """Draw at random how many metres east and north imagery of a place is misplaced."""
    generator = _make_generator(place, 0)
    reach, turn = generator.uniform(2.0, 6.0), generator.uniform(0, 2 * np.pi)
    return round(float(reach * np.cos(turn)), 2), round(float(reach * np.sin(turn)), 2)


def cut_tiles(imagery: Imagery, zoom: int) -> Iterator[tuple[int, int, UInt8[Array, "T T 3"]]]:
    """Cut imagery in EPSG:3857 into XYZ tiles of 256 px at a zoom level.

    Yields:
        Column, row (from the north) and RGB picture, white where there is no imagery.
    """
    side = 2 * HALF_WORLD_M / 2**zoom
    corners = transform_points(imagery.crs_from_image, image_corners(*imagery.image.shape[:2]))
    spans = np.floor((corners * [1, -1] + HALF_WORLD_M) / side).astype(int)
    (left, top), (right, low) = spans.min(axis=0), spans.max(axis=0)
    for column in range(left, right + 1):
        for row in range(top, low + 1):
            west, north, pixel = (
                column * side - HALF_WORLD_M,
                HALF_WORLD_M - row * side,
                side / TILE,
            )
            crs_from_tile = np.array([[pixel, 0, west], [0, -pixel, north], [0, 0, 1.0]])
            image_from_tile = np.linalg.inv(imagery.crs_from_image) @ crs_from_tile
            tile, inside = _resample(imagery.image, image_from_tile, TILE, TILE)
            covered = np.repeat(imagery.covered[..., None] * np.uint8(255), 3, axis=-1)
            inside &= _resample(covered, image_from_tile, TILE, TILE)[0][..., 0] == 255
            tile[~inside] = 255
            if inside.any():
                yield column, row, tile


def _make_generator(place: Place, *number: int) -> np.random.Generator:
    """Places of one seed and of different kinds are seen on different days."""
    kind = PLACE_KINDS.index(place.roads.layout.kind)
    return np.random.default_rng([place.seed, IMAGERY, kind, *number])


def _apply_sensor(
    still: UInt8[Array, "H W 3"], resolution: float, generator: np.random.Generator
) -> UInt8[Array, "_ _ 3"]:
    """Reduce an image from `draw_place` to what a sensor records: resolution, tone, noise."""
    height, width = (round(side / resolution) for side in (HEIGHT_M, WIDTH_M))
    small = blur(resize(still, (height, width)), BLUR)
    levels = np.rint(255 * (np.arange(256) / 255) ** GAMMA).astype(np.float32)
    light = levels[small] * np.asarray(BALANCE, np.float32)
    grey = (light[..., 0] + light[..., 1] + light[..., 2]) / np.float32(3)
    light += np.float32(MIX) * (grey[..., None] - light)
    light += np.rint(NOISE * generator.standard_normal(light.shape)).astype(np.float32)
    return np.rint(np.minimum(np.maximum(light, 0), 255)).astype(np.uint8)


def _resample(
    image: UInt8[Array, "h w 3"], image_from_grid: Float[Array, "3 3"], height: int, width: int
) -> tuple[UInt8[Array, "H W 3"], Bool[Array, "H W"]]:
    """Resample an image onto another grid; also return where it is covered."""
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    spots = transform_points(image_from_grid, np.stack([u.ravel(), v.ravel()], axis=1))
    rows, columns = image.shape[:2]
    inside = ((spots >= 0) & (spots < [columns, rows])).all(axis=1).reshape(height, width)
    grid = warp(pack(image), image_from_grid, height, width)
    grid[~inside] = 0
    return grid, inside
