"""Alignment of imagery to the tracks of vehicles, without any map.

Two cues tell where the tracks lie on the imagery. Lane markings and kerbs run along a path at half
a lane's width, and no edge runs in its middle. And vehicles drive on few classes of surface: a
class counts by how much more often it lies under the tracks than elsewhere. That ratio is learned
from the imagery itself, first over all places within the prior, then over the likely ones.

Both cues are sums along the paths, hence correlations of the imagery with a template drawn from the
tracks, at all shifts at once, for each rotation. The score over a temperature is the logarithm of
the likelihood. Along a straight road it hardly changes, and the covariance shows this.
"""

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import AlignmentError
from geoaim.geometry import make_similarity
from geoaim.grid import Grid
from geoaim.imagery.alignment.path_template import (
    TEMPLATE_REACH_M,
    PathTemplate,
    draw_template,
    rotate_poses,
    sample_poses,
)
from geoaim.imagery.alignment.result import (
    DEFAULT_PRIOR,
    MAX_SIGMA_M,
    ImageryAlignment,
    Prior,
)
from geoaim.imagery.alignment.surfaces import classify_ground, score_classes
from geoaim.tracks import Tracks

RESOLUTION = 0.4  # m a pixel of the grid
ROTATION_STEP_M = 1.0  # between rotations, at the ends of the tracks
TEMPERATURE = 120.0  # of the score, in the likelihood
MIN_POSES = 100  # of moving vehicles
MAX_SIGMA_SHARE = 0.6  # of the prior's standard deviation that may remain
MIN_SIGMA_M = 0.2  # vehicles' boxes and paint are no better known


def align_tracks(imagery: AIM, tracks: Tracks, *, prior: Prior = DEFAULT_PRIOR) -> ImageryAlignment:
    """Estimate how imagery has to be moved to lie under the tracks of vehicles.

    Args:
        imagery: georeferenced roughly.
        tracks: in the same world; only moving vehicles are used.
        prior: how far off the imagery may be; its scale is taken as right.

    Returns:
        The mean of the posterior, with its covariance; evidence has the number of poses and the
        standard deviation of the rotation.

    Raises:
        AlignmentError: vehicles move at too few places, or the imagery does not fix the place.
        ValueError: they lie in different worlds.
    """
    if imagery.world != tracks.world:
        raise ValueError(f"the imagery lies in {imagery.world}, the tracks in {tracks.world}")
    poses = sample_poses(tracks)
    if len(poses) < MIN_POSES:
        raise AlignmentError(
            f"moving vehicles pass {len(poses)} places of a metre; {MIN_POSES} or more are needed "
            "to align imagery with tracks. Give more tracks, control points, or an AIM"
        )
    center = (poses[:, :2].min(axis=0) + poses[:, :2].max(axis=0)) / 2
    half = float(np.abs(poses[:, :2] - center).max())
    count = int(np.ceil(prior.max_rotation * half / ROTATION_STEP_M))
    rotations = np.arange(-count, count + 1) * ROTATION_STEP_M / half
    posterior = _estimate_posterior(imagery, poses, center, rotations, prior)
    _refuse_weak(posterior.sum(axis=0), len(poses), prior.max_shift)
    return _average_posterior(posterior, rotations, center, len(poses))


def _estimate_posterior(
    imagery: AIM,
    poses: Float[Array, "M 3"],
    center: Float[Array, "2"],
    rotations: Float[Array, "t"],
    prior: Prior,
) -> Float[Array, "t n n"]:
    """Probabilities of rotations and shifts, learning surfaces and places in turn."""
    half = float(np.abs(poses[:, :2] - center).max())
    grid = _make_square_grid(center, half * np.sqrt(2) + 2 * TEMPLATE_REACH_M + prior.max_shift)
    edges, classes = classify_ground(imagery, grid)
    steps = round(prior.max_shift / RESOLUTION)
    shifts = np.full((2 * steps + 1,) * 2, (2 * steps + 1.0) ** -2)
    unrotated = draw_template(poses, grid)
    third = rotations[len(rotations) // 2 % 3 :: 3]  # enough to learn the surfaces
    for angles in (third, rotations):
        channels = np.dstack([edges, score_classes(classes, shifts, unrotated)])
        templates = (draw_template(rotate_poses(poses, center, angle), grid) for angle in angles)
        scores = np.stack([_correlate(channels, template, steps) for template in templates])
        posterior = _normalise(scores, prior.max_shift)
        shifts = posterior.sum(axis=0)
    return posterior


def _make_square_grid(center: Float[Array, "2"], reach: float) -> Grid:
    side = int(np.ceil(2 * reach / RESOLUTION))
    left, top = center[0] - reach, center[1] + reach
    matrix = np.array([[RESOLUTION, 0, left], [0, -RESOLUTION, top], [0, 0, 1.0]])
    return Grid((side, side), matrix)


def _correlate(
    channels: Float32[Array, "H W 4"], template: PathTemplate, steps: int
) -> Float32[Array, "n n"]:
    """Sums of the template times the image, at all shifts."""
    (height, width), top, left = template.channels.shape[:2], template.top, template.left
    region = channels[top - steps : top + height + steps, left - steps : left + width + steps]
    return cv2.matchTemplate(region, template.channels, cv2.TM_CCORR)


def _normalise(scores: Float32[Array, "t n n"], max_shift: float) -> Float[Array, "t n n"]:
    """Probabilities from scores and a normal prior of the shift, whose 2 sigma are `max_shift`."""
    steps = scores.shape[1] // 2
    shift = np.arange(-steps, steps + 1) * RESOLUTION
    log_prior = -((shift**2)[:, None] + shift**2) / 2 / (max_shift / 2) ** 2
    log_posterior = (scores - scores.max()) / TEMPERATURE + log_prior
    posterior = np.exp(log_posterior - log_posterior.max())
    return posterior / posterior.sum()


def _refuse_weak(weight: Float[Array, "n n"], poses: int, max_shift: float) -> None:
    """Refuse a posterior that is too wide, or that touches the end of the search."""
    shift, covariance = _compute_moments(weight)
    variances, axes = np.linalg.eigh(covariance)
    best, worst = np.sqrt(variances)
    if best > min(MAX_SIGMA_M, MAX_SIGMA_SHARE * max_shift / 2):
        raise AlignmentError(
            f"the tracks pass {poses} places, and do not tell where the imagery lies: to "
            f"{best:.1f} m at best, {worst:.1f} m at worst (one sigma). Is it the same place? Give "
            "more tracks, a smaller range, control points, or an AIM"
        )
    for sigma, axis in zip((best, worst), axes.T, strict=True):
        if sigma <= MAX_SIGMA_M and abs(shift @ axis) > max_shift - 2 * sigma:
            raise AlignmentError(
                f"the best place is {np.linalg.norm(shift):.1f} m off, at the end of the "
                f"{max_shift:g} m that were searched. Name a wider range"
            )


def _average_posterior(
    posterior: Float[Array, "t n n"],
    rotations: Float[Array, "t"],
    center: Float[Array, "2"],
    poses: int,
) -> ImageryAlignment:
    """Mean and covariance of the posterior, without a rotation that is within its error."""
    share = posterior.sum(axis=(1, 2))
    rotation = float((share * rotations).sum())
    sigma = float(np.sqrt((share * (rotations - rotation) ** 2).sum()))
    straight = abs(rotation) <= 2 * sigma
    mean, covariance = _compute_moments(posterior.sum(axis=0))
    shift = _compute_moments(posterior[len(rotations) // 2])[0] if straight else mean
    stated_from_true = make_similarity(center, 0.0 if straight else rotation, 1.0)
    stated_from_true[:2, 2] += shift
    return ImageryAlignment(
        true_from_stated=np.linalg.inv(stated_from_true),
        model="translation" if straight else "rigid",
        covariance=covariance,
        center=center,
        evidence={"poses": poses, "rotation_sigma_degrees": float(np.degrees(sigma))},
    )


def _compute_moments(weight: Float[Array, "n n"]) -> tuple[Float[Array, "2"], Float[Array, "2 2"]]:
    """Mean and covariance of the shift, metres east and north."""
    steps = len(weight) // 2
    weight = weight / weight.sum()
    along = np.arange(-steps, steps + 1) * RESOLUTION
    shifts = np.stack(np.meshgrid(along, -along), axis=-1)
    mean = np.einsum("ij,ijk->k", weight, shifts)
    apart = shifts - mean
    covariance = np.einsum("ij,ijk,ijl->kl", weight, apart, apart)
    return mean, covariance + np.eye(2) * MIN_SIGMA_M**2
