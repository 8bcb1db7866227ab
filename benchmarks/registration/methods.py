"""Registration methods to compare: this library, stabilo, features, ECC, KLT and phase correlation.

stabilo is measured where it is installed: `pip install --no-deps stabilo`.
"""

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from skimage.registration import phase_cross_correlation

from geoaim.base.geometry import from_opencv, translation
from geoaim.mapping.registration.patches import shrink_image
from geoaim.mapping.registration.register import choose_reference, register_frames
from geoaim.mapping.registration.rivals import (
    Grey,
    Matrix,
    RegisterGrey,
    Rival,
    match_features,
    match_orb,
    maximise_ecc,
    track_corners,
)
from geoaim.mapping.video.video import open_video

Matrices = Float[Array, "T 3 3"]
Registered = tuple[Matrices, list[float]]
# A method takes frames and vehicle boxes, and returns matrices (NaN where it rejects a frame) and
# the seconds of processor time that each frame took.
Method = Callable[[Any, list[Array]], Registered]


def _register_with_geoaim(frames: Any, boxes: list[Array]) -> Registered:
    """Register with this library: no boxes, motion model chosen from the data."""
    reference = choose_reference(open_video(frames), time=0.0)
    matrices: list[Array] = []
    seconds: list[float] = []
    start = time.process_time()
    for _, placement in register_frames(open_video(frames), reference):
        seconds.append(time.process_time() - start)
        matrices.append(placement.reference_from_frame)
        start = time.process_time()
    return np.array(matrices), seconds


def _make_stabilo_method(*, with_boxes: bool) -> Method:
    """Make a method of stabilo: ORB, brute-force matching, MAGSAC++, with or without boxes."""
    from stabilo import Stabilizer  # a peer, not a dependency

    def run(frames: Any, boxes: list[Array]) -> Registered:
        stabilizer = Stabilizer(mask_use=with_boxes)
        matrices: list[Array] = []
        seconds: list[float] = []
        for index, frame in enumerate(frames):
            bgr = np.ascontiguousarray(frame[..., ::-1])
            low, high = boxes[index][:, :2], boxes[index][:, 2:]
            centred = np.hstack([(low + high) / 2, high - low])
            given = centred if with_boxes else None
            start = time.process_time()
            if index == 0:
                stabilizer.set_ref_frame(bgr, given)
            stabilizer.stabilize(bgr, given)
            seconds.append(time.process_time() - start)
            matrix = stabilizer.get_cur_trans_matrix()
            matrices.append(np.full((3, 3), np.nan) if matrix is None else from_opencv(matrix))
        return np.array(matrices, float), seconds

    return run


def _make_rival_method(rival: Rival, shrink: int) -> Method:
    """Make a method of a rival, which gets grey frames reduced by an integer factor."""
    scale = np.diag([1 / shrink, 1 / shrink, 1.0])

    def run(frames: Any, boxes: list[Array]) -> Registered:
        register = None
        matrices: list[Matrix] = []
        seconds: list[float] = []
        for frame in frames:
            start = time.process_time()
            grey = to_grey(frame, shrink)
            register = register or rival(grey)
            matrix = register(grey)
            seconds.append(time.process_time() - start)
            matrix = np.full((3, 3), np.nan) if matrix is None else matrix
            matrices.append(np.linalg.inv(scale) @ matrix @ scale)
        return np.array(matrices), seconds

    return run


def to_grey(frame: UInt8[Array, "H W 3"], shrink: int) -> UInt8[Array, "h w"]:
    """Convert an RGB frame to grey and divide its size by an integer; the remainder is cut off."""
    return shrink_image(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), shrink)


def _correlate_phases(reference: Grey) -> RegisterGrey:
    """Register by phase correlation, a translation (Guizar-Sicairos et al. 2008)."""

    def register(grey: Grey) -> Matrix | None:
        shift, _, _ = phase_cross_correlation(  # type: ignore[no-untyped-call]
            reference, grey, upsample_factor=20
        )
        return translation(float(shift[1]), float(shift[0]))

    return register


def list_methods() -> dict[str, Method]:
    """List all methods that can run here by name; each takes RGB frames and their (n, 4) boxes.

    It gives reference_from_frame (T, 3, 3), NaN where rejected, and the seconds of each frame.
    """
    sift = match_features(lambda: cv2.SIFT.create(2000), cv2.NORM_L2)
    methods: dict[str, Method] = {
        "geoaim": _register_with_geoaim,
        "ORB 2000 + MAGSAC": _make_rival_method(match_orb, 1),
        "SIFT 2000 half + MAGSAC": _make_rival_method(sift, 2),
        "KLT half + MAGSAC": _make_rival_method(track_corners, 2),
        "ECC quarter": _make_rival_method(maximise_ecc, 4),
        "phase correlation half": _make_rival_method(_correlate_phases, 2),
    }
    try:
        methods["stabilo with boxes"] = _make_stabilo_method(with_boxes=True)
        methods["stabilo"] = _make_stabilo_method(with_boxes=False)
    except ImportError:
        print("stabilo is not installed: pip install --no-deps stabilo")
    return methods
