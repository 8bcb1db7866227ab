"""A preliminary georeference, a similarity: from two or three points, or from badly spread ones."""

import numpy as np

from geoaim.base.errors import GeoreferenceError
from geoaim.base.geometry import transform_points
from geoaim.base.world import World
from geoaim.mapping.georeference import normalised_plane, point_checks
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import project_points
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.outliers import SIGMA_DOF
from geoaim.mapping.georeference.posterior import fit_posterior
from geoaim.mapping.georeference.transform_models import (
    PointPairs,
    apply_terms,
    compose_world_from_image,
    fit_terms,
)

MIN_PRELIMINARY_POINTS = 2


def estimate_preliminary(
    points: ControlPoints, *, height: int, width: int, world: World | None = None
) -> Georeference:
    """Estimate a similarity from control points that do not suffice for `estimate_georeference`.

    No point is tested for mistakes. Tilt, stretch and lens enter the uncertainty at their expected
    size (`posterior`), and the noise is that of picking points.

    Args:
        points: two points or more on one image.
        height: height of the image, pixels.
        width: width of the image, pixels.
        world: the target plane; None: see `estimate_georeference`.

    Returns:
        The georeference, marked approximate; leave-one-out errors are NaN.

    Raises:
        GeoreferenceError: there are fewer than two points, or two have the same pixel or place.
    """
    if len(points.names) < MIN_PRELIMINARY_POINTS:
        raise GeoreferenceError(
            f"{len(points.names)} control points were given; {MIN_PRELIMINARY_POINTS} are needed"
            " for a first georeference"
        )
    size = (height, width)
    world, targets = project_points(points, world)
    point_checks.check_distinctness(points, targets)
    plane = normalised_plane.normalise_pixels(points.pixels, size)
    world_from_plane = normalised_plane.fit_similarity(plane, targets)[0]
    pairs = PointPairs(plane, transform_points(np.linalg.inv(world_from_plane), targets))
    sigma = point_checks.PICKING_SIGMA_PX / normalised_plane.half_diagonal(*size)
    posterior = fit_posterior(pairs, sigma, SIGMA_DOF)
    terms = fit_terms(pairs, [0, 1, 2, 3], np.zeros(9))
    scale = world_from_plane[:2, :2]
    return Georeference(
        world_from_image=compose_world_from_image(world_from_plane, terms, size),
        world=world,
        model="similarity",
        radial=0.0,
        height=height,
        width=width,
        pixels=points.pixels,
        residuals=(apply_terms(terms, plane) - pairs.ground) @ scale.T,
        leave_one_out=np.full(len(plane), np.nan),
        used=np.ones(len(plane), bool),
        probabilities={},
        noise=posterior.noise * float(np.sqrt(np.linalg.det(scale))),
        terms=terms,
        posterior=posterior,
        world_from_plane=world_from_plane,
        approximate=True,
    )
