"""Plain ways to register a frame, with which `geoaim bench` compares: ORB, KLT and ECC."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.base.geometry import from_opencv

Grey = UInt8[Array, "h w"]
Matrix = Float[Array, "3 3"]
MIN_PAIRS = 4  # a homography needs no fewer
# A rival takes the reference, grey, and returns what registers grey frames to it: a function that
# returns reference_from_frame, or None where it rejects a frame.
RegisterGrey = Callable[[Grey], Matrix | None]
Rival = Callable[[Grey], RegisterGrey]


def match_features(make_detector: Callable[[], Any], norm: int) -> Rival:
    """Make a rival that registers by features: brute-force matching, MAGSAC++.

    `make_detector` makes one of OpenCV's detectors, whose descriptors have the cv2 norm `norm`.
    """

    def rival(reference: Grey) -> RegisterGrey:
        detector, matcher = make_detector(), cv2.BFMatcher(norm, crossCheck=True)
        reference_points, reference_descriptors = detector.detectAndCompute(reference, None)

        def register(grey: Grey) -> Matrix | None:
            points, descriptors = detector.detectAndCompute(grey, None)
            if descriptors is None or reference_descriptors is None:
                return None
            pairs = matcher.match(descriptors, reference_descriptors)
            if len(pairs) < MIN_PAIRS:
                return None
            source = np.array([points[pair.queryIdx].pt for pair in pairs])
            target = np.array([reference_points[pair.trainIdx].pt for pair in pairs])
            homography, _ = cv2.findHomography(source, target, cv2.USAC_MAGSAC, 2.0)
            return None if homography is None else from_opencv(homography)

        return register

    return rival


def match_orb(reference: Grey) -> RegisterGrey:
    """Register by 2000 features of ORB."""
    return match_features(lambda: cv2.ORB.create(2000), cv2.NORM_HAMMING)(reference)


def maximise_ecc(reference: Grey) -> RegisterGrey:
    """Register by ECC (Evangelidis and Psarakis 2008), from the result of the frame before."""
    warp: Any = np.eye(3, dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-5)

    def register(grey: Grey) -> Matrix | None:
        nonlocal warp
        try:
            _, warp = cv2.findTransformECC(reference, grey, warp, cv2.MOTION_HOMOGRAPHY, criteria)
        except cv2.error:
            return None
        return np.linalg.inv(from_opencv(warp.astype(np.float64)))

    return register


def track_corners(reference: Grey) -> RegisterGrey:
    """Register by KLT from the reference's corners, checked forward and backward."""
    corners = cv2.goodFeaturesToTrack(reference, 400, 0.005, reference.shape[1] / 32)
    guess = corners
    flags = cv2.OPTFLOW_USE_INITIAL_FLOW

    def register(grey: Grey) -> Matrix | None:
        nonlocal guess
        forward, is_forward_found, _ = cv2.calcOpticalFlowPyrLK(
            reference, grey, corners, guess.copy(), flags=flags
        )
        backward, is_backward_found, _ = cv2.calcOpticalFlowPyrLK(
            grey, reference, forward, corners.copy(), flags=flags
        )
        guess = forward
        good = (np.asarray(is_forward_found) & np.asarray(is_backward_found)).ravel().astype(bool)
        good &= np.hypot(*(backward - corners).reshape(-1, 2).T) < 0.5
        if good.sum() < MIN_PAIRS:
            return None
        homography, _ = cv2.findHomography(forward[good], corners[good], cv2.USAC_MAGSAC, 1.0)
        return None if homography is None else from_opencv(homography)

    return register
