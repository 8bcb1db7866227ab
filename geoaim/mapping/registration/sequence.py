"""Check registrations over time: jumps, and whether they follow the ground.

A single frame cannot show which part is the ground where vehicles cover most of it and move as one.
Over the frames, the ground under a hovering camera moves less than the vehicles.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.base.errors import RegistrationError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.mapping.registration.ambiguity import MAX_REST_SHIFT_PX, MOVING_PART
from geoaim.mapping.registration.frame_registration import FrameRegistration

MIN_FRAMES = 5  # of a sequence that is checked
MIN_JUMP_SHARE = 0.01  # of the image's width; a smaller jump is not an error
# chosen on the validation part of `benchmarks.registration.stability`
MAX_AMBIGUOUS_SHARE = 0.5  # of the frames
MAX_STEP_RATIO = 0.7  # a step is the shorter one if it has at most this share of the other's length
MIN_STEP_SHARE = 1 / 320  # of the image's width, by which the steps must differ
MIN_SHORTER_STEPS = 2  # a single one may be chance
MAX_STILL_SHARE = 1 / 240  # of the image's width, within which another placement does not move


def check_ground(frames: Iterable[FrameRegistration], size: tuple[int, int]) -> None:
    """Refuse a sequence of which most frames are ambiguous, or whose placements lie on traffic."""
    frames = list(frames)
    if len(frames) < MIN_FRAMES:
        return
    advice = (
        "traffic, water, rain, a rolling shutter or strong compression may be the cause: film more "
        "ground that stands still, when there is less of these, or at a higher bit rate; if the "
        "camera stands on a mast or a tripod, say so (--fixed-camera)"
    )
    ambiguous = sum(MOVING_PART in frame.reason for frame in frames)
    if ambiguous > MAX_AMBIGUOUS_SHARE * len(frames) and not _is_still(frames, size):
        raise RegistrationError(
            f"{MOVING_PART} in {ambiguous} of {len(frames)} frames, so that the ground is not "
            f"known in the others either; {advice}"
        )
    shorter, longer = _compare_steps(frames, size)
    if shorter > longer and shorter >= MIN_SHORTER_STEPS:
        raise RegistrationError(
            f"another part of the image moves less than the one that was registered, {shorter} "
            f"times of {shorter + longer}: that part may be the ground; {advice}"
        )


def find_jumps(
    reference_from_frame: Float[Array, "T 3 3"], size: tuple[int, int]
) -> Bool[Array, " T"]:
    """Find frames that lie far from both neighbours while these agree."""
    jumped = np.zeros(len(reference_from_frame), bool)
    if len(jumped) < MIN_FRAMES:
        return jumped
    corners = transform_points(reference_from_frame, image_corners(*size))
    distance = np.abs(corners[1:-1] - (corners[:-2] + corners[2:]) / 2).max((1, 2))
    span = np.abs(corners[2:] - corners[:-2]).max((1, 2))
    limit = max(10 * float(np.median(distance)), MIN_JUMP_SHARE * size[1])
    jumped[1:-1] = (distance > limit) & (distance > 3 * span)
    return jumped


def _is_still(frames: list[FrameRegistration], size: tuple[int, int]) -> bool:
    """Whether the camera stands: traffic then passes in most frames, and the placement stays."""
    valid = [frame.reference_from_frame for frame in frames if frame.valid]
    if not valid:
        return False
    corners = image_corners(*size)
    shift = np.abs(transform_points(np.array(valid), corners) - corners).mean((1, 2))
    return bool((shift < MAX_REST_SHIFT_PX).all())


def _compare_steps(frames: list[FrameRegistration], size: tuple[int, int]) -> tuple[int, int]:
    """Count steps in which the other placement moves less than the registered one, and more."""
    middle = np.array([[size[1] / 2, size[0] / 2]])
    pairs = [
        (f.reference_from_frame, f.other_placement)
        for f in frames
        if f.valid and f.other_placement is not None
    ]
    if len(pairs) < 2:
        return 0, 0
    paths = [transform_points(np.array(x), middle)[:, 0] for x in zip(*pairs, strict=True)]
    moves = np.hypot(*(paths[1] - middle).T) > MAX_STILL_SHARE * size[1]
    moves = moves[1:] | moves[:-1]
    step, other = (np.hypot(*np.diff(path, axis=0).T)[moves] for path in paths)
    differs = np.abs(step - other) > MIN_STEP_SHARE * size[1]
    step, other = step[differs], other[differs]
    return int((other < MAX_STEP_RATIO * step).sum()), int((step < MAX_STEP_RATIO * other).sum())
