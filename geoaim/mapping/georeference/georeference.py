"""A georeference: the transform from an image to the world, and its uncertainty."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.geometry import transform_points
from geoaim.mapping.georeference.normalised_plane import Points, undistort_points
from geoaim.mapping.georeference.transform_models import Posterior
from geoaim.world import World


@dataclass(frozen=True)
class Georeference:
    """Where an image lies in the world.

    Attributes:
        world_from_image: (3, 3) pixels to world metres; where `radial` is not 0, pixels without
            lens distortion (`undistort_points`).
        world: the plane of those metres.
        model: "similarity", "affine" or "homography".
        radial: k of p' = p (1 + k |p|^2) in the normalised plane.
        height: of the image, pixels.
        width: of the image, pixels.
        residuals: (M, 2) fitted minus given, metres, of every control point, used or not.
        leave_one_out: (M,) distance of each point from a fit without it, metres.
        used: (M,) False for a point that was found to be wrong.
        candidates: root mean square leave-one-out error of each model that was tried, metres.
        noise: one sigma of one coordinate of a control point, metres.
        terms: (9,) the terms of the chosen model (`transform_models`), zero where it has none.
        posterior: of all nine terms, in the normalised plane.
        world_from_plane: (3, 3) similarity from the normalised plane to world metres.
        approximate: True when it comes from telemetry or an assumed resolution, not from points.
    """

    world_from_image: Float[Array, "3 3"]
    world: World
    model: str
    radial: float
    height: int
    width: int
    residuals: Points
    leave_one_out: Float[Array, "m"]
    used: Bool[Array, "m"]
    candidates: Mapping[str, float] = field(repr=False)
    noise: float
    terms: Float[Array, "9"] = field(repr=False)
    posterior: Posterior = field(repr=False)
    world_from_plane: Float[Array, "3 3"] = field(repr=False)
    approximate: bool = False


def world_from_pixels(georeference: Georeference, pixels: Points) -> Points:
    """Transform distorted pixels (m, 2) to world metres (m, 2), correcting the distortion."""
    size = (georeference.height, georeference.width)
    undistorted = undistort_points(pixels, georeference.radial, *size)
    return transform_points(georeference.world_from_image, undistorted)
