"""Find that a camera stands still, on a mast or a tripod, and register its frames.

No motion is estimated: the transform is the identity. A frame must show that it is at rest, by
patches that have not moved; a moving mass does not count against it, however large.

An overlay over a moving scene is at rest, too. But what passes covers the ground of a camera that
stands, which is seen again, and an overlay it never does. Blocks that compression has frozen are
not seen again either, once they were renewed.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.mapping.registration.frame_registration import (
    INTERPOLATION_ERROR_PX,
    MIN_INLIERS,
    FrameRegistration,
    Keyframe,
    reject,
)
from geoaim.mapping.registration.patches import (
    MIN_INLIER_CORRELATION,
    PATCH_COUNT,
    PatchAlignment,
    PatchTemplate,
    align_patches,
    make_template,
)
from geoaim.mapping.video.frames import Frame

MAX_SHIFT_PX = 0.3  # of a patch at rest: noise moves patches by some tenths of a pixel
EVIDENCE_FRAMES = 16  # by which it is decided whether a camera stands
MIN_EVIDENCE_FRAMES = 8
# chosen on the validation part of `benchmarks.registration.stability`
MIN_STEADY_RATIO = 0.25  # fewest patches at rest in a frame over the most: frozen blocks move on
MIN_REST_SHARE = 0.4  # of a full grid of patches that rest in half of the frames
MAX_COVERED_CORRELATION = 0.4  # of a patch over which something else lies
MIN_COVERED_SHARE = 0.1  # of the resting patches, covered in two frames or more between rests


def may_stand(frames: Sequence[Frame], keyframe: Keyframe) -> bool:
    """Whether about as many patches of the reference are at rest in each frame."""
    counts = [int(_classify_patches(keyframe.fine, f.grey)[0].sum()) for f in frames]
    return len(counts) > 1 and min(counts) >= max(MIN_INLIERS, MIN_STEADY_RATIO * max(counts))


def stands_still(frames: Sequence[Frame]) -> bool:
    """Whether what is at rest in the frames is the ground: over the image, and covered at times."""
    if len(frames) < MIN_EVIDENCE_FRAMES:
        return False
    median = np.median(np.stack([frame.grey for frame in frames]), axis=0).astype(np.uint8)
    template = make_template(median)
    states = [_classify_patches(template, frame.grey) for frame in frames]
    at_rest, covered = (np.stack(part) for part in zip(*states, strict=True))
    rests = at_rest.mean(axis=0) >= 0.5
    if rests.sum() < MIN_REST_SHARE * PATCH_COUNT:
        return False
    before = np.maximum.accumulate(at_rest)
    after = np.maximum.accumulate(at_rest[::-1])[::-1]
    passed = (covered & before & after)[:, rests].sum(axis=0)
    return bool((passed >= 2).mean() >= MIN_COVERED_SHARE)


def _classify_patches(
    template: PatchTemplate, grey: UInt8[Array, "H W"]
) -> tuple[Bool[Array, " M"], Bool[Array, " M"]]:
    """Which patches a frame shows at the same pixels, and over which something else lies."""
    count = len(template.points)
    at_rest, covered = np.zeros(count, bool), np.ones(count, bool)
    alignment = align_patches(template, grey, np.eye(3), "translation", iterations=1)
    if alignment is not None:
        at_rest[alignment.fitted] = _find_still(alignment)
        covered = alignment.correlation < MAX_COVERED_CORRELATION
    return at_rest, covered


def register_at_rest(
    frames: Iterable[Frame], keyframe: Keyframe
) -> Iterator[tuple[Frame, FrameRegistration]]:
    """Yield each frame with its registration: the identity, or why it is not at rest."""
    for frame in frames:
        yield frame, check_rest(frame.grey, keyframe.fine)


def check_rest(grey: UInt8[Array, "H W"], template: PatchTemplate) -> FrameRegistration:
    """Check that a frame shows at least 16 patches of the reference at the same pixels."""
    alignment = align_patches(template, grey, np.eye(3), "translation", iterations=1)
    if alignment is None:
        return reject("no patch in view")
    still, shift = _find_still(alignment), measure_displacements(alignment)
    if still.sum() < MIN_INLIERS:
        return reject(
            f"not at rest: {still.sum()} of {alignment.in_view.sum()} patches have not moved"
        )
    return FrameRegistration(
        reference_from_frame=np.eye(3),
        reason="",
        quality=float(np.median(alignment.correlation[alignment.fitted][still])),
        inlier_share=float(still.sum() / alignment.in_view.sum()),
        uncertainty=float(np.hypot(*shift[still].mean(axis=0))) + INTERPOLATION_ERROR_PX,
    )


def measure_displacements(alignment: PatchAlignment) -> Float[Array, "N 2"]:
    """Displacements of the fitted patches from where the alignment started, after one iteration."""
    return alignment.motion.residuals + alignment.motion.matrix[:2, 2]


def _find_still(alignment: PatchAlignment) -> Bool[Array, "N"]:
    """Which of the fitted patches have not moved."""
    shift = np.hypot(*measure_displacements(alignment).T)
    correlation = alignment.correlation[alignment.fitted]
    return np.asarray((shift < MAX_SHIFT_PX) & (correlation > MIN_INLIER_CORRELATION))
