"""An approximate place for an image without control points: from telemetry, or none at all."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoreferenceError
from geoaim.mapping.georeference.estimate import Georeference, compose
from geoaim.mapping.georeference.point_checks import half_diagonal
from geoaim.mapping.georeference.transform_models import PRIOR
from geoaim.world import World, choose_world, world_from_lonlat

GPS = 3.0  # m, one sigma, per axis
COMPASS = np.radians(5.0)
TILT = np.radians(3.0)  # of a camera said to look straight down
SCALE = 0.05  # share: height above the ground, field of view


def approximate_georeference(
    *,
    latitude: float,
    longitude: float,
    height_above_ground: float,
    yaw: float,
    field_of_view: float,
    size: tuple[int, int],
) -> Georeference:
    """Where an image lies by telemetry alone: a camera that looks straight down.

    One sigma of what telemetry leaves open: position 3 m, compass 5 degrees, scale 5 %, tilt 3
    degrees (which moves the image's centre by a twentieth of the height).

    Args:
        latitude: degrees.
        longitude: degrees.
        height_above_ground: metres.
        yaw: where the image's top points, radians counter-clockwise from east; for a compass
            heading h in degrees, pi / 2 - radians(h).
        field_of_view: across the image's width, radians.
        size: height and width of the image.

    Raises:
        GeoreferenceError: a value is missing (NaN) or impossible.
    """
    values = (latitude, longitude, height_above_ground, yaw, field_of_view)
    possible = height_above_ground > 0.0 and 0.0 < field_of_view < np.pi
    if not (np.isfinite(values).all() and possible):
        raise GeoreferenceError(
            f"Telemetry latitude {latitude}, longitude {longitude}, height {height_above_ground},"
            f" yaw {yaw}, field of view {field_of_view} does not fix a place: all must be numbers,"
            " height and field of view positive. Give control points instead."
        )
    here = np.array([[longitude, latitude], [longitude, latitude + 1e-3]])
    world = choose_world(here[:1])
    middle, above = world_from_lonlat(world, here)
    turn = yaw + np.arctan2(*(above - middle)[::-1]) - np.pi / 2.0  # true north to the grid's
    pixel = 2.0 * height_above_ground * np.tan(field_of_view / 2.0) / size[1]
    shift = float(np.hypot(GPS, height_above_ground * np.tan(TILT)))
    return _assumed(world, size, middle, (pixel, turn - np.pi / 2.0), (shift, COMPASS))


def local_georeference(*, resolution: float, size: tuple[int, int]) -> Georeference:
    """A plane of its own: origin at the image's centre, x right, y up.

    Args:
        resolution: metres per pixel.
        size: height and width of the image.
    """
    if not (np.isfinite(resolution) and resolution > 0.0):
        raise ValueError(f"resolution is {resolution}; it is a positive number of metres.")
    return _assumed(World(None), size, np.zeros(2), (resolution, 0.0), (0.0, 0.0))


def _assumed(
    world: World,
    size: tuple[int, int],
    middle: Float[Array, "2"],
    scale_and_turn: tuple[float, float],
    sigmas: tuple[float, float],
) -> Georeference:
    pixel, turn = scale_and_turn
    unit = pixel * half_diagonal(*size)
    cosine, sine = unit * np.cos(turn), unit * np.sin(turn)
    world_from_plane = np.array(
        [[cosine, -sine, middle[0]], [sine, cosine, middle[1]], [0.0, 0.0, 1.0]]
    )
    shift = sigmas[0] / unit
    spread = np.concatenate([[shift, shift, SCALE, sigmas[1]], PRIOR])
    return Georeference(
        world_from_image=compose(world_from_plane, np.zeros(9), size),
        world=world,
        model="similarity",
        radial=0.0,
        height=size[0],
        width=size[1],
        residuals=np.empty((0, 2)),
        leave_one_out=np.empty(0),
        used=np.empty(0, bool),
        names=(),
        candidates={},
        noise=float("nan"),
        dof=float("inf"),
        parameters=np.zeros(9),
        covariance=np.diag(spread**2),
        chosen=np.zeros(9),
        world_from_plane=world_from_plane,
        approximate=True,
    )
