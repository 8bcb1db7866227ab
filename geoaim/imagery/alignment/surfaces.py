"""Surfaces in imagery: its edges, and classes of pixels by colour and roughness."""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import AlignmentError
from geoaim.geometry import to_opencv
from geoaim.grid import Grid
from geoaim.imagery.alignment.path_template import PathTemplate
from geoaim.imagery.alignment.template_matching import (
    compute_orientation,
    reduce_to_grey,
    resample_grey,
    smooth_for_step,
)

CLASSES = 16  # of surfaces
FEATURE_WEIGHTS = (0.5, 2.0, 2.0, 12.0)  # of lightness, both of colour, and roughness
COLOUR_SIGMA_M = 0.35  # of the Gaussian before colours are compared
ROUGHNESS_PX = 9  # side of the square whose standard deviation is the roughness
SAMPLES = 20_000  # pixels from which the classes are learned
MIN_CLASS_SHARE = 0.003  # added to the share of each class, so that none is impossible
MIN_GRID_VALID_SHARE = 0.05  # of the ground around the tracks


def classify_ground(imagery: AIM, grid: Grid) -> tuple[Float32[Array, "H W 3"], Int[Array, "H W"]]:
    """Measure edges and surface classes of imagery on a grid.

    Args:
        imagery: to be resampled.
        grid: in its world.

    Returns:
        (H, W, 3) orientation channels and edge strength, and (H, W) class of the surface, -1 where
        the imagery shows nothing.

    Raises:
        AlignmentError: it shows hardly any of the grid.
    """
    coverage = imagery.coverage * ~_find_blank(imagery.image)
    image = reduce_to_grey(replace(imagery, coverage=coverage), grid.resolution)
    grey, valid = resample_grey(image, np.eye(3), grid)
    if valid.mean() < MIN_GRID_VALID_SHARE:
        raise AlignmentError(
            f"the imagery shows hardly anything where the tracks are: {valid.mean():.1%} of the "
            "ground around them. Is it the same place, and the right CRS?"
        )
    edges = compute_orientation(grey, valid, grid.resolution)
    strength = np.hypot(edges[..., 0], edges[..., 1])
    smooth = smooth_for_step(imagery.image, grid.resolution / imagery.resolution)
    matrix = to_opencv(imagery.grid.grid_from_world @ grid.world_from_grid)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    colours = cv2.warpPerspective(smooth, matrix, grid.shape[::-1], flags=flags)
    colours = cv2.GaussianBlur(colours, (0, 0), COLOUR_SIGMA_M / grid.resolution)
    return np.dstack([edges, strength]), _classify(colours, grey, valid)


def score_classes(
    classes: Int[Array, "H W"], posterior: Float[Array, "n n"], template: PathTemplate
) -> Float32[Array, "H W"]:
    """Score pixels by how much more often their class is driven over than seen, as a logarithm.

    Args:
        classes: (H, W) of the surface; -1 where unknown.
        posterior: (N, N) probability of each shift of the paths, pixels.
        template: of the paths.

    Returns:
        (H, W) log ratio; 0 for what is driven over on average, and where unknown.
    """
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
    samples = samples[:: max(len(samples) // SAMPLES, 1)]
    ranks = np.argsort(np.argsort(samples @ np.ones(4, np.float32), kind="stable"), kind="stable")
    labels = (ranks * CLASSES // len(samples)).astype(np.int32)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.1)
    _, _, centers = cv2.kmeans(samples, CLASSES, labels, stop, 1, cv2.KMEANS_USE_INITIAL_LABELS)
    distances = [((features - center) ** 2).sum(axis=-1) for center in centers]
    return np.where(valid, np.argmin(distances, axis=0), -1)
