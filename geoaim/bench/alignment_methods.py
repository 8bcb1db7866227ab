"""Methods that the alignment benchmark compares: geoaim's, and feature matching with MAGSAC++."""

from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.bench.alignment_pairs import Pair
from geoaim.errors import AlignmentError
from geoaim.geometry import from_opencv
from geoaim.imagery.alignment import template_matching
from geoaim.imagery.alignment.by_image import align_image

MIN_INLIERS = 10  # of feature matches
MAX_REPROJECTION_ERROR_PX = 2.0  # of an inlier
FEATURES = 5000

Method = Callable[[Pair], tuple[Float[Array, "3 3"], float]]


def list_methods() -> dict[str, Method]:
    """List the methods by name: each gives true_from_stated and its 95 % uncertainty in metres."""
    orb = cv2.ORB.create(nfeatures=FEATURES)
    sift = cv2.SIFT.create(nfeatures=FEATURES, enable_precise_upscale=True)
    return {
        "geoaim": _align,
        "geoaim, shadows not flattened": _align_with_shadows,
        "SIFT + MAGSAC++": lambda pair: (align_by_features(pair, sift, cv2.NORM_L2), np.nan),
        "ORB + MAGSAC++": lambda pair: (align_by_features(pair, orb, cv2.NORM_HAMMING), np.nan),
    }


def align_by_features(pair: Pair, detector: Any, norm: int) -> Float[Array, "3 3"]:
    """Align a picture to an AIM by features of both at one resolution, and MAGSAC++.

    Args:
        pair: of the picture and the AIM.
        detector: of OpenCV, for key points and descriptors.
        norm: of OpenCV, between descriptors.

    Returns:
        true_from_stated.

    Raises:
        AlignmentError: fewer than ten matches are inliers.
    """
    step = pair.picture.resolution / pair.aim.resolution
    ground = cv2.resize(
        pair.aim.image, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA
    )
    points, descriptors = [], []
    for image in (pair.picture.image, ground):
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        keys, described = detector.detectAndCompute(grey, None)
        points.append(np.array([key.pt for key in keys]).reshape(-1, 2))
        descriptors.append(described)
    pairs = cv2.BFMatcher(norm, crossCheck=True).match(*descriptors)
    source = points[0][[match.queryIdx for match in pairs]]
    target = points[1][[match.trainIdx for match in pairs]]
    if len(source) < MIN_INLIERS:
        raise AlignmentError(f"{len(source)} matches")
    matrix, inliers = cv2.findHomography(
        source, target, cv2.USAC_MAGSAC, MAX_REPROJECTION_ERROR_PX, maxIters=10_000
    )
    if matrix is None or inliers.sum() < MIN_INLIERS:
        raise AlignmentError(f"{0 if inliers is None else inliers.sum()} matches are inliers")
    aim_from_ground, ground_from_picture = np.diag([step, step, 1.0]), from_opencv(matrix)
    world_from_picture = pair.aim.world_from_image @ aim_from_ground @ ground_from_picture
    return world_from_picture @ pair.picture.grid.grid_from_world


def _align(pair: Pair) -> tuple[Float[Array, "3 3"], float]:
    alignment = align_image(pair.picture, pair.aim)
    return alignment.true_from_stated, alignment.uncertainty


def _align_with_shadows(pair: Pair) -> tuple[Float[Array, "3 3"], float]:
    with patch.object(template_matching, "SHADOW_RADIUS_M", 0.0):
        return _align(pair)
