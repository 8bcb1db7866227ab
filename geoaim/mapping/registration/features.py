"""The global start: ORB features, matched at any rotation, position and moderate scale."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.mapping.registration.motion_models import Model, fit_motion
from geoaim.mapping.registration.patches import reduce

WIDTH = 960  # px: the size at which features are looked for
FEATURES = 2500  # kept, spread over a grid; the library's default of 500 fails in traffic
DETECTED = 10000
TOLERANCE = 500  # of the width: how near a match must come to agree
LEAST = 12  # matches in agreement, below which there is no global start


@dataclass(frozen=True, eq=False)
class Features:
    """Key points in full-image pixels and their binary descriptors."""

    points: Float[Array, "M 2"]
    descriptors: UInt8[Array, "M 32"]


def detect(grey: UInt8[Array, "H W"], *, exclude: Bool[Array, "H W"] | None = None) -> Features:
    """ORB (Rublee 2011) at a reduced size, the strongest of each cell of a grid."""
    factor = max(round(grey.shape[1] / WIDTH), 1)
    small = reduce(grey, factor)
    mask = None
    if exclude is not None:
        mask = cv2.resize((~exclude).view(np.uint8), small.shape[::-1])
    orb = cv2.ORB.create(nfeatures=DETECTED, fastThreshold=5)
    keypoints = orb.detect(small, mask)
    best = [keypoints[i] for i in _strongest_per_cell(keypoints, small.shape)]
    chosen, descriptors = orb.compute(small, best)
    if descriptors is None:
        return Features(np.empty((0, 2)), np.empty((0, 32), np.uint8))
    points = np.array([point.pt for point in chosen])
    # The library places a level's pixel centres on the finer level's: half a pixel each.
    octave = np.array([point.octave for point in chosen])
    points += (1.2 ** octave[:, None] - 1) / 2
    return Features((points + 0.5) * factor, descriptors)


def match(
    reference: Features, frame: Features, model: Model, *, size: tuple[int, int]
) -> Float[Array, "3 3"] | None:
    """The reference_from_frame on which most matches agree, or None when too few do.

    A homography by MAGSAC++ sorts the matches; the model is then fitted to those that agree.
    """
    if min(len(reference.points), len(frame.points)) < LEAST:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(
        frame.descriptors, reference.descriptors
    )
    if len(pairs) < LEAST:
        return None
    source = frame.points[[pair.queryIdx for pair in pairs]]
    target = reference.points[[pair.trainIdx for pair in pairs]]
    tolerance = size[1] / TOLERANCE
    matrix, mask = cv2.findHomography(source, target, cv2.USAC_MAGSAC, tolerance, maxIters=3000)
    if matrix is None or mask.sum() < LEAST or np.linalg.det(matrix[:2, :2]) <= 0:
        return None
    if model == "homography":
        return matrix
    source, target = source[mask.ravel() > 0], target[mask.ravel() > 0]
    equal = np.broadcast_to(np.eye(2), (len(source), 2, 2))
    return fit_motion(source, target - source, equal, model, size=size).matrix


def _strongest_per_cell(keypoints: Sequence[cv2.KeyPoint], shape: tuple[int, int]) -> list[int]:
    """Indices of the FEATURES best, taken in turn from the cells of a grid."""
    if not keypoints:
        return []
    points = np.array([point.pt for point in keypoints])
    response = np.array([point.response for point in keypoints])
    cell = max(np.sqrt(shape[0] * shape[1] / 400), 1)
    index = (points // cell).astype(int)
    cells = index[:, 1] * 10000 + index[:, 0]
    order = np.lexsort((-response, cells))
    ranked = cells[order]
    starts = np.flatnonzero(np.r_[True, ranked[1:] != ranked[:-1]])
    rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.r_[starts, len(order)]))
    return order[np.argsort(rank, kind="stable")[:FEATURES]].tolist()
