"""Register the frames of a camera that is said to stand still, on a mast or a tripod.

No motion is estimated: the transform is the identity. A frame must show that it is at rest, by
patches that have not moved; a moving mass does not count against it, however large.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.mapping.registration.frame_registration import (
    INTERPOLATION_ERROR_PX,
    MIN_INLIERS,
    FrameRegistration,
    Keyframe,
)
from geoaim.mapping.registration.patches import (
    MIN_INLIER_CORRELATION,
    PatchAlignment,
    align_patches,
)
from geoaim.mapping.video.frames import Frame

MAX_SHIFT_PX = 0.3  # of a patch at rest: noise moves patches by some tenths of a pixel


def register_at_rest(
    frames: Iterable[Frame], keyframe: Keyframe
) -> Iterator[tuple[Frame, FrameRegistration]]:
    """Yield each frame with its registration: the identity, or why it is not at rest.

    Args:
        frames: the frames.
        keyframe: the reference.
    """
    for frame in frames:
        yield frame, check_rest(frame.grey, keyframe)


def check_rest(grey: UInt8[Array, "H W"], keyframe: Keyframe) -> FrameRegistration:
    """Check that a frame shows at least 16 patches of the reference at the same pixels.

    Args:
        grey: the frame.
        keyframe: the reference.

    Returns:
        The registration. Its uncertainty is the mean displacement of these patches, and the error
        of linear interpolation.
    """
    alignment = align_patches(keyframe.fine, grey, np.eye(3), "translation", iterations=1)
    if alignment is None:
        return _reject("no patch in view")
    shift = measure_displacements(alignment)
    correlation = alignment.correlation[alignment.fitted]
    still = (np.hypot(*shift.T) < MAX_SHIFT_PX) & (correlation > MIN_INLIER_CORRELATION)
    if still.sum() < MIN_INLIERS:
        return _reject(
            f"not at rest: {still.sum()} of {alignment.in_view.sum()} patches have not moved"
        )
    return FrameRegistration(
        reference_from_frame=np.eye(3),
        reason="",
        quality=float(np.median(correlation[still])),
        inlier_share=float(still.sum() / alignment.in_view.sum()),
        uncertainty=float(np.hypot(*shift[still].mean(axis=0))) + INTERPOLATION_ERROR_PX,
    )


def measure_displacements(alignment: PatchAlignment) -> Float[Array, "N 2"]:
    """Displacements of the fitted patches from where the alignment started, after one iteration."""
    return alignment.motion.residuals + alignment.motion.matrix[:2, 2]


def _reject(reason: str) -> FrameRegistration:
    return FrameRegistration(np.full((3, 3), np.nan), reason, 0.0, 0.0, np.inf)
