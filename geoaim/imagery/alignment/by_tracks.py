"""Alignment of imagery to the tracks of vehicles, without any map.

Two cues tell where the tracks lie on the imagery. Lane markings and kerbs run along a path at half
a lane's width, and no edge runs in its middle. And vehicles drive on few classes of surface: a
class counts by how much more often it lies under the tracks than elsewhere. That ratio is learned
from the imagery itself, first over all places within the prior, then over the likely ones.

Both cues are sums along the paths, hence correlations of the imagery with a template drawn from the
tracks, at all shifts at once, for each rotation. The score over a temperature is the logarithm of
the likelihood. Along a straight road it hardly changes, and the covariance shows this.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import make_similarity, to_opencv, transform_points
from geoaim.base.grid import Grid
from geoaim.imagery.alignment import template_matching
from geoaim.imagery.alignment.result import (
    DEFAULT_PRIOR,
    MAX_SIGMA_M,
    ImageryAlignment,
    Prior,
    compute_log_prior,
)
from geoaim.tracks.agent_types import AGENT_GROUPS
from geoaim.tracks.tracks import Tracks

RESOLUTION = 0.4  # m a pixel of the grid
ROTATION_STEP_M = 1.0  # step between rotations, measured at the ends of the tracks
TEMPERATURE = 120.0  # divides the score in the likelihood
MIN_POSES = 100  # number of poses of moving vehicles
# the result is too uncertain beyond this share of the prior's standard deviation
MAX_SIGMA_SHARE = 0.6
MIN_SIGMA_M = 0.2  # vehicles' boxes and paint are no better known
VEHICLE_TYPES = (*AGENT_GROUPS["vehicle"], "motorcycle")
MIN_SPEED_M_S = 1.0  # the heading of a standing vehicle says nothing of the road
CELL_SIZE = (1.0, 1.0, np.pi / 8)  # m, m and rad: poses within one cell count once
HALF_LANE_M = 1.65  # distance from a path to the lane's markings
MARKING_SIGMA_M = 0.45  # standard deviation of that distance
# standard deviation of the strip around a path in which no edges are expected
CENTER_SIGMA_M = 0.55
HALF_BODY_M = 1.0  # half the width of the strip that vehicles drive over
TEMPLATE_REACH_M = 6.0  # half the width of the template along a path
CLASSES = 16  # number of surface classes
# weights of lightness, the two colour components and roughness
FEATURE_WEIGHTS = (0.5, 2.0, 2.0, 12.0)
COLOUR_SIGMA_M = 0.35  # standard deviation of the Gaussian filter before colours are compared
ROUGHNESS_PX = 9  # side of the square whose standard deviation is the roughness
CLASS_PIXELS = 20_000  # pixels from which the classes are learned
MIN_CLASS_SHARE = 0.003  # added to the share of each class, so that none is impossible
MIN_GRID_VALID_SHARE = 0.05  # share of the ground around the tracks that the imagery must show


class _PathTemplate(NamedTuple):
    """What the paths of vehicles expect of imagery, from a row and a column of the grid on."""

    channels: Float32[Array, "h w 4"]  # orientation (2), minus edge strength, times driven over
    top: int
    left: int


def align_tracks(imagery: AIM, tracks: Tracks, *, prior: Prior = DEFAULT_PRIOR) -> ImageryAlignment:
    """Estimate how imagery has to be moved to lie under the tracks of vehicles."""
    if imagery.world != tracks.world:
        raise ValueError(f"the imagery lies in {imagery.world}, the tracks in {tracks.world}")
    poses = sample_poses(tracks)
    if len(poses) < MIN_POSES:
        raise AlignmentError(
            f"tracks of moving vehicles cover {len(poses)} cells of 1 m; {MIN_POSES} are needed to "
            "align imagery to them. Give more tracks, control points, or an AIM"
        )
    search = _make_search(imagery, poses, prior)
    count = int(np.ceil(prior.max_rotation * search.half / ROTATION_STEP_M))
    rotations = np.arange(-count, count + 1) * ROTATION_STEP_M / search.half
    posterior = _estimate_posterior(search, rotations)
    _refuse_weak(posterior.sum(axis=0), len(poses), prior.max_shift)
    return _average_posterior(posterior, rotations, search.center, len(poses))


def sample_poses(tracks: Tracks) -> Float[Array, "M 3"]:
    """Sample poses (x, y, heading) of moving vehicles, one in each cell of 1 m, 1 m and pi / 8."""
    vehicles = np.array([agent_type in VEHICLE_TYPES for agent_type in tracks.types])
    moving = tracks.present & vehicles[:, None]
    moving[moving] = np.abs(tracks.states[moving][:, 3]) > MIN_SPEED_M_S
    poses = tracks.states[moving][:, :3]
    cells = np.floor(poses / CELL_SIZE)
    return poses[np.unique(cells, axis=0, return_index=True)[1]]


class _Search(NamedTuple):
    """Imagery around the tracks on a grid, and the poses that are moved over it."""

    grid: Grid
    edges: Float32[Array, "H W 3"]
    classes: Int[Array, "H W"]
    poses: Float[Array, "M 3"]
    center: Float[Array, "2"]
    half: float  # metres from the center to the farthest pose, along x or y
    max_shift: float  # metres

    @property
    def steps(self) -> int:
        """Pixels of the grid that poses are moved by at most."""
        return round(self.max_shift / RESOLUTION)


def _make_search(imagery: AIM, poses: Float[Array, "M 3"], prior: Prior) -> _Search:
    center = (poses[:, :2].min(axis=0) + poses[:, :2].max(axis=0)) / 2
    half = float(np.abs(poses[:, :2] - center).max())
    reach = half * np.sqrt(2) + 2 * TEMPLATE_REACH_M + prior.max_shift
    left, top = center[0] - reach, center[1] + reach
    matrix = np.array([[RESOLUTION, 0, left], [0, -RESOLUTION, top], [0, 0, 1.0]])
    grid = Grid((int(np.ceil(2 * reach / RESOLUTION)),) * 2, matrix)
    return _Search(grid, *_classify_ground(imagery, grid), poses, center, half, prior.max_shift)


def _estimate_posterior(search: _Search, rotations: Float[Array, "t"]) -> Float[Array, "t n n"]:
    """Probabilities of rotations and shifts, learning surfaces and places in turn."""
    side = 2 * search.steps + 1
    shifts = np.full((side, side), 1 / side**2)
    third = rotations[len(rotations) // 2 % 3 :: 3]  # enough to learn the surfaces
    for angles in (third, rotations):
        channels = _draw_channels(search, shifts)
        scores = np.stack([_score_rotation(search, channels, angle) for angle in angles])
        posterior = _normalise(scores, search.max_shift)
        shifts = posterior.sum(axis=0)
    return posterior


def _draw_channels(search: _Search, shifts: Float[Array, "n n"]) -> Float32[Array, "H W 4"]:
    """Edges, and the scores of surfaces, learned over places of known probabilities."""
    unrotated = _draw_template(search.poses, search.grid)
    return np.dstack([search.edges, _score_classes(search.classes, shifts, unrotated)])


def _score_rotation(
    search: _Search, channels: Float32[Array, "H W 4"], angle: float
) -> Float32[Array, "n n"]:
    """Scores of all shifts of the poses, rotated by an angle."""
    places = transform_points(make_similarity(search.center, angle, 1.0), search.poses[:, :2])
    rotated = np.column_stack([places, search.poses[:, 2] + angle])
    template, steps = _draw_template(rotated, search.grid), search.steps
    (height, width), top, left = template.channels.shape[:2], template.top, template.left
    region = channels[top - steps : top + height + steps, left - steps : left + width + steps]
    return cv2.matchTemplate(region, template.channels, cv2.TM_CCORR)


def _draw_template(poses: Float[Array, "M 3"], grid: Grid) -> _PathTemplate:
    """Draw what paths expect: edges along both sides of a lane, none in its middle."""
    sides = np.arange(-TEMPLATE_REACH_M, TEMPLATE_REACH_M + 0.01, grid.resolution)
    x, y, heading = poses.T[:, :, None]
    places = np.stack([x - sides * np.sin(heading), y + sides * np.cos(heading)], axis=-1)
    pixels = transform_points(grid.grid_from_world, places.reshape(-1, 2))
    left, top = (int(n) - 1 for n in np.floor(pixels.min(axis=0)))
    right, bottom = (int(n) + 1 for n in np.ceil(pixels.max(axis=0)))
    marking = np.exp(-(((np.abs(sides) - HALF_LANE_M) / MARKING_SIGMA_M) ** 2) / 2)
    doubled = -2 * heading - np.pi  # doubled orientation of an edge along the path, v down
    shape = len(poses), len(sides)
    wanted = [
        np.cos(doubled) * marking,
        np.sin(doubled) * marking,
        np.broadcast_to(-np.exp(-((sides / CENTER_SIGMA_M) ** 2) / 2), shape),
        np.broadcast_to(np.abs(sides) <= HALF_BODY_M, shape),
    ]
    values = np.stack(wanted, axis=-1).reshape(-1, 4)
    channels = _splat(pixels - (left, top), values, (bottom - top, right - left))
    return _PathTemplate(channels, top, left)


def _splat(
    pixels: Float[Array, "n 2"], values: Float[Array, "n c"], size: tuple[int, int]
) -> Float32[Array, "h w c"]:
    """Sums of values at points, each shared by the four pixels around it (bilinear splatting)."""
    corner = np.floor(pixels - 0.5).astype(int)
    right, down = (pixels - 0.5 - corner).T
    total = np.zeros((size[0] * size[1], values.shape[1]))
    for row, column, share in (
        (0, 0, (1 - down) * (1 - right)),
        (0, 1, (1 - down) * right),
        (1, 0, down * (1 - right)),
        (1, 1, down * right),
    ):
        flat = (corner[:, 1] + row) * size[1] + corner[:, 0] + column
        for channel, value in enumerate(values.T):
            total[:, channel] += np.bincount(flat, share * value, len(total))
    return total.reshape(*size, -1).astype(np.float32)


def _classify_ground(imagery: AIM, grid: Grid) -> tuple[Float32[Array, "H W 3"], Int[Array, "H W"]]:
    """Edges (orientation and strength), and the class of each pixel, -1 where nothing is shown."""
    coverage = imagery.coverage * ~_find_blank(imagery.image)
    image = template_matching.reduce_to_grey(replace(imagery, coverage=coverage), grid.resolution)
    grey, valid = template_matching.resample_grey(image, np.eye(3), grid)
    if valid.mean() < MIN_GRID_VALID_SHARE:
        raise AlignmentError(
            f"the imagery shows hardly anything where the tracks are: {valid.mean():.1%} of the "
            "ground around them. Is it the same place, and the right CRS?"
        )
    edges = template_matching.compute_orientation(grey, valid, grid.resolution)
    strength = np.hypot(edges[..., 0], edges[..., 1])
    smooth = template_matching.smooth_for_step(imagery.image, grid.resolution / imagery.resolution)
    matrix = to_opencv(imagery.grid.grid_from_world @ grid.world_from_grid)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    colours = cv2.warpPerspective(smooth, matrix, grid.shape[::-1], flags=flags)
    colours = cv2.GaussianBlur(colours, (0, 0), COLOUR_SIGMA_M / grid.resolution)
    return np.dstack([edges, strength]), _classify(colours, grey, valid)


def _find_blank(image: UInt8[Array, "H W 3"]) -> Bool[Array, "H W"]:
    """Patches of pure white or black, where a file has nothing and does not say so."""
    square = np.ones((5, 5), np.uint8)
    blank = np.zeros(image.shape[:2], bool)
    for level in (0, 255):
        flat = (image == level).all(axis=-1).astype(np.uint8)
        blank |= cv2.dilate(cv2.morphologyEx(flat, cv2.MORPH_OPEN, square), square) > 0
    return blank


def _classify(
    colours: UInt8[Array, "H W 3"], grey: Float32[Array, "H W"], valid: Bool[Array, "H W"]
) -> Int[Array, "H W"]:
    """Cluster pixels by lightness, colour and roughness: k-means, without randomness."""
    lab = cv2.cvtColor(colours, cv2.COLOR_RGB2LAB)
    square = (ROUGHNESS_PX, ROUGHNESS_PX)
    variance = cv2.blur(grey * grey, square) - cv2.blur(grey, square) ** 2
    roughness = np.log1p(np.sqrt(np.maximum(variance, 0)))
    features = np.dstack([lab, roughness]).astype(np.float32)
    features *= np.array(FEATURE_WEIGHTS, np.float32)
    samples = features[valid]
    samples = samples[:: max(len(samples) // CLASS_PIXELS, 1)]
    ranks = np.argsort(np.argsort(samples @ np.ones(4, np.float32), kind="stable"), kind="stable")
    labels = (ranks * CLASSES // len(samples)).astype(np.int32)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.1)
    _, _, centers = cv2.kmeans(samples, CLASSES, labels, stop, 1, cv2.KMEANS_USE_INITIAL_LABELS)
    distances = [((features - center) ** 2).sum(axis=-1) for center in centers]
    return np.where(valid, np.argmin(distances, axis=0), -1)


def _score_classes(
    classes: Int[Array, "H W"], posterior: Float[Array, "n n"], template: _PathTemplate
) -> Float32[Array, "H W"]:
    """Log ratio of how often each class is driven over and seen, centered; 0 where unknown."""
    height, width = template.channels.shape[:2]
    driven = template.channels[..., 3]
    near = np.s_[template.top : template.top + height, template.left : template.left + width]
    everywhere, under = np.empty(CLASSES), np.empty(CLASSES)
    for surface in range(CLASSES):
        mask = (classes == surface).astype(np.float32)
        everywhere[surface] = mask.mean()
        under[surface] = (cv2.filter2D(mask, -1, posterior)[near] * driven).sum()
    everywhere, under = everywhere / everywhere.sum(), under / under.sum()
    ratio = np.log((under + MIN_CLASS_SHARE) / (everywhere + MIN_CLASS_SHARE))
    scores = (ratio - (under * ratio).sum())[np.maximum(classes, 0)]
    return np.where(classes >= 0, scores, 0).astype(np.float32)


def _normalise(scores: Float32[Array, "t n n"], max_shift: float) -> Float[Array, "t n n"]:
    """Probabilities from scores and a normal prior of the shift, whose 2 sigma are `max_shift`."""
    log_prior = compute_log_prior(list_shifts(scores.shape[1]), max_shift)
    log_posterior = (scores - scores.max()) / TEMPERATURE + log_prior
    posterior = np.exp(log_posterior - log_posterior.max())
    return posterior / posterior.sum()


def _refuse_weak(weight: Float[Array, "n n"], poses: int, max_shift: float) -> None:
    """Refuse a posterior that is too wide, or that touches the end of the search."""
    shift, covariance = compute_moments(weight)
    variances, axes = np.linalg.eigh(covariance)
    best, worst = np.sqrt(variances)
    if best > min(MAX_SIGMA_M, MAX_SIGMA_SHARE * max_shift / 2):
        raise AlignmentError(
            f"the tracks cover {poses} cells of 1 m, which do not determine the position: it is "
            f"only known to {best:.1f} m (1 sigma, best direction) and {worst:.1f} m (worst). Do "
            "both show the same place? Give more tracks, a smaller prior, control points, or an AIM"
        )
    for sigma, axis in zip((best, worst), axes.T, strict=True):
        if sigma <= MAX_SIGMA_M and abs(shift @ axis) > max_shift - 2 * sigma:
            raise AlignmentError(
                f"the best shift is {np.linalg.norm(shift):.1f} m, at the limit of the search of "
                f"{max_shift:g} m; pass a larger prior.max_shift (--max-shift)"
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
    mean, covariance = compute_moments(posterior.sum(axis=0))
    shift = compute_moments(posterior[len(rotations) // 2])[0] if straight else mean
    shift, covariance = remove_undetermined_shift(shift, covariance)
    stated_from_true = make_similarity(center, 0.0 if straight else rotation, 1.0)
    stated_from_true[:2, 2] += shift
    return ImageryAlignment(
        true_from_stated=np.linalg.inv(stated_from_true),
        model="translation" if straight else "rigid",
        covariance=covariance,
        center=center,
        evidence={"poses": poses, "rotation_sigma_degrees": float(np.degrees(sigma))},
    )


def remove_undetermined_shift(
    shift: Float[Array, "2"], covariance: Float[Array, "2 2"]
) -> tuple[Float[Array, "2"], Float[Array, "2 2"]]:
    """Remove the shift along undetermined directions; the covariance is about what is left."""
    variances, axes = np.linalg.eigh(covariance)
    for axis in axes.T[variances > MAX_SIGMA_M**2]:
        removed = (shift @ axis) * axis
        shift, covariance = shift - removed, covariance + np.outer(removed, removed)
    return shift, covariance


def list_shifts(side: int) -> Float[Array, "n n 2"]:
    """Shifts of tracks against imagery, metres east and north, of a search with so many a side."""
    along = (np.arange(side) - side // 2) * RESOLUTION
    return np.stack(np.meshgrid(along, -along), axis=-1)


def compute_moments(weight: Float[Array, "n n"]) -> tuple[Float[Array, "2"], Float[Array, "2 2"]]:
    """Mean and covariance of the shift, metres east and north."""
    weight = weight / weight.sum()
    shifts = list_shifts(len(weight))
    mean = np.einsum("ij,ijk->k", weight, shifts)
    apart = shifts - mean
    covariance = np.einsum("ij,ijk,ijl->kl", weight, apart, apart)
    return mean, covariance + np.eye(2) * MIN_SIGMA_M**2
