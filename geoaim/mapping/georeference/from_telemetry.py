"""Approximate georeferences of an image without control points: by telemetry or by resolution."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import GeoreferenceError
from geoaim.base.geometry import make_similarity
from geoaim.base.world import World, choose_world, world_from_lonlat
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.transform_models import (
    Posterior,
    compose_world_from_image,
    half_diagonal,
)

GPS_SIGMA_M = 3.0  # standard deviation of a GPS position in each axis
COMPASS_SIGMA = np.radians(5.0)
TILT_SIGMA = np.radians(3.0)  # tilt of a camera that telemetry says looks straight down
# stretch and shear, perspective (by that tilt, over half the diagonal) and lens of such a camera
TERM_SIGMA = np.array([0.01, 0.01, 0.05, 0.05, 0.005])
SCALE_SIGMA = 0.05  # share: height above the ground, field of view


def approximate_georeference(
    *,
    latitude: float,
    longitude: float,
    height_above_ground: float,
    yaw: float,
    field_of_view: float,
    size: tuple[int, int],
) -> Georeference:
    """Approximate the georeference of a camera that looks straight down, by telemetry alone."""
    values = (latitude, longitude, height_above_ground, yaw, field_of_view)
    possible = height_above_ground > 0.0 and 0.0 < field_of_view < np.pi
    if not (np.isfinite(values).all() and possible):
        raise GeoreferenceError(
            f"Telemetry latitude {latitude}, longitude {longitude}, height {height_above_ground},"
            f" yaw {yaw}, field of view {field_of_view} does not fix a place: all must be numbers,"
            " height and field of view positive. Give control points instead."
        )
    lonlat = np.array([[longitude, latitude], [longitude, latitude + 1e-3]])
    world = choose_world(lonlat[:1])
    centre, north = world_from_lonlat(world, lonlat)
    turn = yaw + np.arctan2(*(north - centre)[::-1]) - np.pi / 2.0  # true north to grid north
    resolution = 2.0 * height_above_ground * np.tan(field_of_view / 2.0) / size[1]
    unit = resolution * half_diagonal(*size)
    world_from_plane = make_similarity(np.zeros(2), turn - np.pi / 2.0, unit)
    world_from_plane[:2, 2] = centre
    shift = float(np.hypot(GPS_SIGMA_M, height_above_ground * np.tan(TILT_SIGMA))) / unit
    sigmas = np.array([shift, shift, SCALE_SIGMA, COMPASS_SIGMA])
    return _assume_georeference(world, size, world_from_plane, sigmas)


def make_local_georeference(
    *, resolution: float, size: tuple[int, int], origin: tuple[float, float] = (0.0, 0.0)
) -> Georeference:
    """Make a georeference in a local plane, x right and y up."""
    if not (np.isfinite(resolution) and resolution > 0.0):
        raise ValueError(f"resolution is {resolution}; it is a positive number of metres.")
    unit = resolution * half_diagonal(*size)
    sigmas = np.array([0.0, 0.0, SCALE_SIGMA, 0.0])
    height, width = size
    east, north = (width / 2 - origin[0]) * resolution, (origin[1] - height / 2) * resolution
    world_from_plane = np.array([[unit, 0.0, east], [0.0, unit, north], [0.0, 0.0, 1.0]])
    return _assume_georeference(World(None), size, world_from_plane, sigmas)


def _assume_georeference(
    world: World,
    size: tuple[int, int],
    world_from_plane: Float[Array, "3 3"],
    similarity_sigmas: Float[Array, "4"],
) -> Georeference:
    """A similarity without control points, with the stated sigmas of its four terms."""
    covariance = np.diag(np.concatenate([similarity_sigmas, TERM_SIGMA]) ** 2)
    posterior = Posterior(np.zeros(9), covariance, np.zeros(9), np.nan, np.inf, np.nan)
    return Georeference(
        world_from_image=compose_world_from_image(world_from_plane, np.zeros(9), size),
        world=world,
        model="similarity",
        radial=0.0,
        height=size[0],
        width=size[1],
        pixels=np.empty((0, 2)),
        residuals=np.empty((0, 2)),
        leave_one_out=np.empty(0),
        used=np.empty(0, bool),
        probabilities={},
        noise=np.nan,
        terms=np.zeros(9),
        posterior=posterior,
        world_from_plane=world_from_plane,
        approximate=True,
    )
