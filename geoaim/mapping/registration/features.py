"""Match ORB features to find the transform between two images at any rotation and position."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.mapping.registration.motion_models import Model, fit_motion
from geoaim.mapping.registration.patches import shrink_image

DETECTION_WIDTH_PX = 960  # about the width to which images are reduced before detection
MAX_DETECTED = 10_000
MAX_FEATURES = 2500  # kept, spread over a grid; OpenCV's default of 500 fails in dense traffic
GRID_CELLS = 400
INLIER_TOLERANCE_SHARE = 1 / 500  # of the image width, within which a match is an inlier
MIN_INLIER_MATCHES = 12  # inliers without which there is no transform


@dataclass(frozen=True, eq=False)
class Features:
    """Key points of an image, and their binary descriptors."""

    points: Float[Array, "M 2"]  # positions in pixels of the full image
    descriptors: UInt8[Array, "M 32"]  # bytes


def detect_features(
    grey: UInt8[Array, "H W"], *, exclude: Bool[Array, "H W"] | None = None
) -> Features:
    """Detect ORB features (Rublee 2011) in a grey image reduced to about 960 px of width.

    The strongest of each grid cell are kept, none where `exclude` is True.
    """
    factor = max(round(grey.shape[1] / DETECTION_WIDTH_PX), 1)
    small = shrink_image(grey, factor)
    mask = None
    if exclude is not None:
        mask = cv2.resize((~exclude).view(np.uint8), small.shape[::-1])
    orb = cv2.ORB.create(nfeatures=MAX_DETECTED, fastThreshold=5)
    keypoints = orb.detect(small, mask)
    strongest = [keypoints[i] for i in _select_strongest_per_cell(keypoints, small.shape)]
    described, descriptors = orb.compute(small, strongest)
    if descriptors is None:
        return Features(np.empty((0, 2)), np.empty((0, 32), np.uint8))
    points = np.array([point.pt for point in described])
    # ORB takes the pixel centres of a pyramid level for those of the finer one: half a pixel each.
    octave = np.array([point.octave for point in described])
    points += (1.2 ** octave[:, None] - 1) / 2
    return Features((points + 0.5) * factor, descriptors)


def match_features(
    reference: Features, frame: Features, model: Model, *, size: tuple[int, int]
) -> Float[Array, "3 3"] | None:
    """Estimate the transform on which most feature matches agree.

    A homography by MAGSAC++ (Barath 2020) selects the inliers, to which the model is fitted.

    Args:
        reference: features of the reference.
        frame: features of the frame.
        model: motion model of the result.
        size: (height, width) of both images, pixels.

    Returns:
        reference_from_frame in pixels, or None when too few matches agree.
    """
    if min(len(reference.points), len(frame.points)) < MIN_INLIER_MATCHES:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(
        frame.descriptors, reference.descriptors
    )
    if len(pairs) < MIN_INLIER_MATCHES:
        return None
    source = frame.points[[pair.queryIdx for pair in pairs]]
    target = reference.points[[pair.trainIdx for pair in pairs]]
    tolerance = size[1] * INLIER_TOLERANCE_SHARE
    # points on both sides have the corner origin, and so has the transform between them
    matrix, mask = cv2.findHomography(source, target, cv2.USAC_MAGSAC, tolerance, maxIters=3000)
    if matrix is None or mask.sum() < MIN_INLIER_MATCHES or np.linalg.det(matrix[:2, :2]) <= 0:
        return None
    if model == "homography":
        return matrix
    source, target = source[mask.ravel() > 0], target[mask.ravel() > 0]
    equal = np.broadcast_to(np.eye(2), (len(source), 2, 2))
    return fit_motion(source, target - source, equal, model, size=size).matrix


def _select_strongest_per_cell(
    keypoints: Sequence[cv2.KeyPoint], shape: tuple[int, int]
) -> list[int]:
    """Indices of the best key points, taken in turn from the cells of a grid."""
    if not keypoints:
        return []
    points = np.array([point.pt for point in keypoints])
    response = np.array([point.response for point in keypoints])
    cell = max(np.sqrt(shape[0] * shape[1] / GRID_CELLS), 1)
    index = (points // cell).astype(int)
    cells = index[:, 1] * 10000 + index[:, 0]
    order = np.lexsort((-response, cells))
    ranked = cells[order]
    starts = np.flatnonzero(np.r_[True, ranked[1:] != ranked[:-1]])
    rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.r_[starts, len(order)]))
    return order[np.argsort(rank, kind="stable")[:MAX_FEATURES]].tolist()
