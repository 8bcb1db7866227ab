"""Registration methods to compare: this library, stabilo, features, ECC, KLT and phase correlation.

stabilo is measured where it is installed: `pip install --no-deps stabilo`.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from skimage.registration import phase_cross_correlation

from geoaim.geometry import from_opencv, translation
from geoaim.mapping.registration.keyframes import FrameRegistration
from geoaim.mapping.registration.patches import shrink_image
from geoaim.mapping.registration.register import choose_reference, register_frames
from geoaim.mapping.video.video import open_video

Grey = UInt8[Array, "h w"]
Matrix = Float[Array, "3 3"]
Matrices = Float[Array, "T 3 3"]
# A method takes frames and vehicle boxes, and returns matrices (NaN where it refuses a frame) and
# the seconds that each frame took.
Method = Callable[[Any, list[Array]], tuple[Matrices, list[float]]]


def register_with_geoaim(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
    """Register with this library: no boxes, motion model chosen from the data."""
    reference = choose_reference(open_video(frames), time=0.0)
    placed: Iterator[tuple[Any, FrameRegistration]] = register_frames(open_video(frames), reference)
    matrices: list[Array] = []
    seconds: list[float] = []
    while True:
        start = time.perf_counter()
        step = next(placed, None)
        if step is None:
            return np.array(matrices), seconds
        seconds.append(time.perf_counter() - start)
        matrices.append(step[1].reference_from_frame)


def make_stabilo_method(*, with_boxes: bool) -> Method:
    """Make a method of stabilo: ORB, brute-force matching, MAGSAC++, with or without boxes."""
    from stabilo import Stabilizer  # a peer, not a dependency

    def run(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
        stabilizer = Stabilizer(mask_use=with_boxes)
        matrices: list[Array] = []
        seconds: list[float] = []
        for index, frame in enumerate(frames):
            bgr = np.ascontiguousarray(frame[..., ::-1])
            low, high = boxes[index][:, :2], boxes[index][:, 2:]
            centred = np.hstack([(low + high) / 2, high - low])
            given = centred if with_boxes else None
            start = time.perf_counter()
            if index == 0:
                stabilizer.set_ref_frame(bgr, given)
            stabilizer.stabilize(bgr, given)
            seconds.append(time.perf_counter() - start)
            matrix = stabilizer.get_cur_trans_matrix()
            matrices.append(np.full((3, 3), np.nan) if matrix is None else from_opencv(matrix))
        return np.array(matrices, float), seconds

    return run


def make_feature_method(make_detector: Callable[[], Any], norm: int, shrink: int) -> Method:
    """Make a method of features: detection, brute-force matching, MAGSAC++.

    Args:
        make_detector: returns an OpenCV feature detector.
        norm: OpenCV's norm for matching its descriptors.
        shrink: integer factor by which frames are reduced first.

    Returns:
        The method.
    """

    def run(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
        detector, matcher = make_detector(), cv2.BFMatcher(norm, crossCheck=True)
        reference: list[Any] = []

        def register(grey: Grey) -> Matrix | None:
            points, descriptors = detector.detectAndCompute(grey, None)
            reference[:] = reference or [points, descriptors]
            pairs = matcher.match(descriptors, reference[1])
            source = np.array([points[pair.queryIdx].pt for pair in pairs])
            target = np.array([reference[0][pair.trainIdx].pt for pair in pairs])
            homography, _ = cv2.findHomography(source, target, cv2.USAC_MAGSAC, 2.0)
            return None if homography is None else from_opencv(homography)

        return _register_each(frames, shrink, register)

    return run


def register_with_ecc(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
    """Register by ECC at a quarter of the size, starting each frame at the previous result."""
    reference: list[Grey] = []
    warps: list[Any] = [np.eye(3, dtype=np.float32)]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-5)

    def register(grey: Grey) -> Matrix | None:
        reference[:] = reference or [grey]
        try:
            _, warps[0] = cv2.findTransformECC(
                reference[0], grey, warps[0], cv2.MOTION_HOMOGRAPHY, criteria
            )
        except cv2.error:
            return None
        return np.linalg.inv(from_opencv(warps[0].astype(np.float64)))

    return _register_each(frames, 4, register)


def register_with_phase_correlation(
    frames: Any, boxes: list[Array]
) -> tuple[Matrices, list[float]]:
    """Register by phase correlation at half size, a translation (Guizar-Sicairos et al. 2008)."""
    reference: list[Grey] = []

    def register(grey: Grey) -> Matrix | None:
        reference[:] = reference or [grey]
        shift, _, _ = phase_cross_correlation(  # type: ignore[no-untyped-call]
            reference[0], grey, upsample_factor=20
        )
        return translation(float(shift[1]), float(shift[0]))

    return _register_each(frames, 2, register)


def register_with_klt(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
    """Register by KLT from the reference at half size, checked forward and backward."""
    state: dict[str, Any] = {}

    def register(grey: Grey) -> Matrix | None:
        if not state:
            corners = cv2.goodFeaturesToTrack(grey, 400, 0.005, grey.shape[1] / 32)
            state.update(reference=grey, corners=corners, guess=corners)
        reference, corners = state["reference"], state["corners"]
        flags = cv2.OPTFLOW_USE_INITIAL_FLOW
        forward, is_forward_found, _ = cv2.calcOpticalFlowPyrLK(
            reference, grey, corners, state["guess"].copy(), flags=flags
        )
        backward, is_backward_found, _ = cv2.calcOpticalFlowPyrLK(
            grey, reference, forward, corners.copy(), flags=flags
        )
        state["guess"] = forward
        good = (np.asarray(is_forward_found) & np.asarray(is_backward_found)).ravel().astype(bool)
        good &= np.hypot(*(backward - corners).reshape(-1, 2).T) < 0.5
        homography, _ = cv2.findHomography(forward[good], corners[good], cv2.USAC_MAGSAC, 1.0)
        return None if homography is None else from_opencv(homography)

    return _register_each(frames, 2, register)


def _register_each(
    frames: Any, shrink: int, register: Callable[[Grey], Matrix | None]
) -> tuple[Matrices, list[float]]:
    """Register reduced grey frames one by one: matrices at full size, and seconds each."""
    scale = np.diag([1 / shrink, 1 / shrink, 1.0])
    matrices: list[Matrix] = []
    seconds: list[float] = []
    for frame in frames:
        start = time.perf_counter()
        matrix = register(to_grey(frame, shrink))
        seconds.append(time.perf_counter() - start)
        matrix = np.full((3, 3), np.nan) if matrix is None else matrix
        matrices.append(np.linalg.inv(scale) @ matrix @ scale)
    return np.array(matrices), seconds


def to_grey(frame: UInt8[Array, "H W 3"], shrink: int) -> UInt8[Array, "h w"]:
    """Convert a frame to grey and reduce it by an integer factor."""
    return shrink_image(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), shrink)


def list_methods() -> dict[str, Method]:
    """Return all methods that can run here, by name."""
    methods: dict[str, Method] = {
        "geoaim": register_with_geoaim,
        "ORB 2000 + MAGSAC": make_feature_method(lambda: cv2.ORB.create(2000), cv2.NORM_HAMMING, 1),
        "SIFT 2000 half + MAGSAC": make_feature_method(
            lambda: cv2.SIFT.create(2000), cv2.NORM_L2, 2
        ),
        "KLT half + MAGSAC": register_with_klt,
        "ECC quarter": register_with_ecc,
        "phase correlation half": register_with_phase_correlation,
    }
    try:
        methods["stabilo with boxes"] = make_stabilo_method(with_boxes=True)
        methods["stabilo"] = make_stabilo_method(with_boxes=False)
    except ImportError:
        print("stabilo is not installed: pip install --no-deps stabilo")
    return methods
