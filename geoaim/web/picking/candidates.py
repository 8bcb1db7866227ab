"""Propose pairs of a frame's pixel and its place, by matching the frame to imagery."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.progress import Progress, no_progress
from geoaim.imagery.alignment.by_image import match_image
from geoaim.imagery.alignment.result import Prior
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.uncertainty import predict_uncertainty

MAX_PAIRS = 12
# pixels of the coarser image: search radius around where the rough georeference puts a pixel
MIN_SEARCH_PX = 12.0
MAX_SEARCH_SHARE = 0.25  # search radius as a share of the frame's diagonal on the ground


@dataclass(frozen=True)
class PairCandidate:
    """A pixel and the place that it seems to show."""

    pixel: tuple[float, float]  # u, v of the frame
    place: tuple[float, float]  # metres in the imagery's world
    sigma_m: float  # one standard deviation of a coordinate, by the spread of all pairs


def propose_pairs(
    frame: UInt8[Array, "H W 3"],
    imagery: AIM,
    georeference: Georeference,
    *,
    progress: Progress = no_progress,
) -> tuple[PairCandidate, ...]:
    """Propose pairs that agree with each other and are spread over the frame."""
    rough = AIM.from_image(frame, georeference.world_from_image, georeference.world, "frame")
    prior = _choose_prior(georeference, max(rough.resolution, imagery.resolution))
    matched = match_image(rough, imagery, prior=prior, progress=progress)
    frame_from_world = np.linalg.inv(georeference.world_from_image)
    pixels = transform_points(frame_from_world, matched.in_image)
    height, width = frame.shape[:2]
    inside = ((pixels > 0) & (pixels < (width, height))).all(axis=1)
    sigma = float(np.sqrt(np.mean(matched.residuals[inside] ** 2)))
    better = inside & (np.linalg.norm(matched.residuals, axis=1) < np.sqrt(2.0) * sigma)
    indices = _select_spread(pixels, np.flatnonzero(better))
    return tuple(
        PairCandidate((float(u), float(v)), (float(x), float(y)), sigma)
        for (u, v), (x, y) in zip(pixels[indices], matched.in_reference[indices], strict=True)
    )


def measure_disagreement(
    pairs: Sequence[PairCandidate], pixels: Float[Array, "m 2"], places: Float[Array, "m 2"]
) -> Float[Array, "m"]:
    """Measure how far points lie from where an affine map through proposed pairs puts them."""
    proposed = np.array([(*pair.pixel, 1.0) for pair in pairs])
    affine = np.linalg.lstsq(proposed, np.array([pair.place for pair in pairs]))[0]
    fitted = np.column_stack([pixels, np.ones(len(pixels))]) @ affine
    return np.linalg.norm(fitted - places, axis=1)


def _choose_prior(georeference: Georeference, resolution: float) -> Prior:
    """How far off the frame may be: the uncertainty at its corners, turned and scaled by it too."""
    corners = image_corners(georeference.height, georeference.width)
    places = transform_points(georeference.world_from_image, corners)
    half_diagonal = float(np.linalg.norm(places - places.mean(axis=0), axis=1).mean())
    radius = float(predict_uncertainty(georeference, corners)[1].max())
    radius = min(radius, MAX_SEARCH_SHARE * 2.0 * half_diagonal)
    share = min(radius / half_diagonal, 0.3)
    shift = max(radius, MIN_SEARCH_PX * resolution)
    return Prior(max_shift=shift, max_rotation=share, max_scaling=share)


def _select_spread(pixels: Float[Array, "m 2"], chosen_from: Array) -> list[int]:
    """Indices of at most 12 pixels, each as far as possible from those chosen before it."""
    if not len(chosen_from):
        return []
    points = pixels[chosen_from]
    selected = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.full(len(points), np.inf)
    while len(selected) < min(MAX_PAIRS, len(points)):
        distance = np.minimum(distance, np.linalg.norm(points - points[selected[-1]], axis=1))
        selected.append(int(distance.argmax()))
    return chosen_from[selected].tolist()
