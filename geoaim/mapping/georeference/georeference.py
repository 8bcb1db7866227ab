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
    """Where an image lies in the world."""

    # pixels to world metres; where `radial` is not 0, pixels without lens distortion
    # (`undistort_points`)
    world_from_image: Float[Array, "3 3"]
    world: World  # the plane of those metres
    model: str  # "similarity", "affine" or "homography"
    radial: float  # k of p' = p (1 + k |p|^2) in the normalised plane
    height: int  # of the image, pixels
    width: int  # of the image, pixels
    residuals: Points  # (M, 2) fitted minus given, metres, of every control point, used or not
    leave_one_out: Float[Array, "m"]  # distance of each point from a fit without it, metres
    used: Bool[Array, "m"]  # False for a point that was found to be wrong
    # root mean square leave-one-out error of each model that was tried, metres
    candidates: Mapping[str, float] = field(repr=False)
    noise: float  # one sigma of one coordinate of a control point, metres
    # the terms of the chosen model (`transform_models`), zero where it has none
    terms: Float[Array, "9"] = field(repr=False)
    posterior: Posterior = field(repr=False)  # of all nine terms, in the normalised plane
    # similarity from the normalised plane to world metres
    world_from_plane: Float[Array, "3 3"] = field(repr=False)
    # True when it comes from telemetry or an assumed resolution, not from points
    approximate: bool = False


def world_from_pixels(georeference: Georeference, pixels: Points) -> Points:
    """Transform pixels as they lie in the image to world metres, correcting lens distortion."""
    size = (georeference.height, georeference.width)
    undistorted = undistort_points(pixels, georeference.radial, *size)
    return transform_points(georeference.world_from_image, undistorted)
