"""Register one frame to keyframes (the reference, or registered frames), or say why it is rejected.

The search starts from the previous frame's transform, with the patches of one keyframe at full
size. Only when that fails do coarse patches widen the search, and only when these fail are ORB
features matched.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.base.geometry import transform_points
from geoaim.mapping.registration.ambiguity import (
    AmbiguousPlacementError,
    Overview,
    choose_placement,
    is_at_rest,
    make_overview,
)
from geoaim.mapping.registration.features import Features, detect_features, match_features
from geoaim.mapping.registration.motion_models import Model
from geoaim.mapping.registration.patches import (
    MIN_INLIER_CORRELATION,
    PATCH_SIDE_PX,
    PatchAlignment,
    PatchTemplate,
    align_patches,
    make_template,
    predict_uncertainty,
    shrink_image,
)
from geoaim.mapping.video.detections import Detections, convert_boxes, mask_boxes
from geoaim.mapping.video.frames import Frame

COARSE_WIDTH_PX = 480  # width of the pyramid level that widens the search
COARSE_ITERATIONS = 10
MIN_INLIERS = 16  # inliers without which a frame is rejected, of about 300 patches
MIN_INLIER_SHARE = 0.2  # share of the patches in view that must be inliers
SUFFICIENT_INLIER_SHARE = 0.5  # the search is not widened at this share or more
UNDOUBTED_INLIER_SHARE = 0.7  # a placement with a smaller share is always compared with others
MAX_UNCERTAINTY_PX = 10.0  # over the image, beyond which a frame is rejected
# chosen on the validation part of `benchmarks.registration.stability`
UNCERTAINTY_INFLATION_PX = 0.06  # spread of the fit that is widened twofold
MAX_INFLATION = 10.0  # factor by which the spread is widened at most
INTERPOLATION_ERROR_PX = 0.012  # lower bound of the uncertainty
BASE_RESIDUAL_PX = 0.08  # residual of plain video, which widens nothing
RESIDUAL_INFLATION_PX = 0.13  # residual that widens by as much, if all neighbours share it
MAX_MISLED_RATIO = 2.5  # largest widening by residuals, over the residual
FROZEN_RATIO = 3.0  # the same where compression has frozen a part of the image
MISFIT_QUANTILE = 0.8  # of the residuals, so that a fifth of the patches may lie on vehicles
MISFIT_QUANTILE_AT_REST = 0.95  # where most of the image may be frozen
FROZEN_QUANTILE = 0.25  # of the residuals, which a real image does not make smaller than 0.012 px
MAX_MISFIT_PX = 4.0  # a larger residual is another motion
GRID = np.stack(np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)), -1).reshape(-1, 2)
MIN_OVERLAP = 0.55  # share of a keyframe's patches in view, below which another keyframe is made


@dataclass(frozen=True, eq=False)
class FrameRegistration:
    """The registration of one frame to the reference."""

    reference_from_frame: Float[Array, "3 3"]  # transform in pixels; NaN if rejected
    reason: str  # why it is rejected; empty if it is not
    quality: float  # median correlation of the patches with the frame, 0 to 1
    inlier_share: float  # share of inliers among the patches in view
    uncertainty: float  # standard deviation over the image, root mean square, pixels
    # placement that fits what moves by itself; None if nothing does, or if it was not looked for
    other_placement: Float[Array, "3 3"] | None = None

    @property
    def valid(self) -> bool:
        """Whether the registration can be trusted."""
        return not self.reason


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A frame to which others are registered."""

    grey: UInt8[Array, "H W"]  # its image
    coarse: PatchTemplate  # its patches on a coarse pyramid level
    fine: PatchTemplate  # its patches at full size
    exclude: Bool[Array, "H W"] | None  # where vehicles hide the ground; None if not known
    overview: Overview  # its small image, in which other placements of a frame are found
    # transform in pixels; the identity for the reference itself
    reference_from_keyframe: Float[Array, "3 3"]
    uncertainty: float  # standard deviation over the image, root mean square, pixels

    @cached_property
    def features(self) -> Features:
        """Its ORB features, which are needed only where a frame lies far from the one before."""
        return detect_features(self.grey, exclude=self.exclude)


def register_frame(
    grey: UInt8[Array, "H W"],
    keyframes: list[Keyframe],
    keyframe: Keyframe,
    prior: Float[Array, "3 3"],
    model: Model,
    *,
    compare: bool = True,
) -> tuple[FrameRegistration, PatchAlignment | None]:
    """Register a frame by searches near the prior, then more widely, then over the whole image.

    Args:
        grey: the frame.
        keyframes: all keyframes.
        keyframe: the one to search first.
        prior: reference_from_frame to start from, pixels.
        model: motion model to fit.
        compare: whether to compare the placement with others, even if most patches agree with it.

    Returns:
        The first registration with enough inliers, or else the best, and the alignment behind it.
    """
    best: tuple[FrameRegistration, PatchAlignment | None] = (reject("no patch in view"), None)
    chosen = keyframe
    for target, start, coarse in _propose_starts(grey, keyframes, keyframe, prior, model):
        if coarse:
            small = shrink_image(grey, round(1 / target.coarse.scale))
            rough = align_patches(target.coarse, small, start, model, iterations=COARSE_ITERATIONS)
            if rough is None:
                continue
            start = rough.matrix
        alignment = align_patches(target.fine, grey, start, model)
        result = _check_alignment(target, alignment)
        if (result.valid, result.inlier_share) >= (best[0].valid, best[0].inlier_share):
            best, chosen = (result, alignment), target
        if result.valid and result.inlier_share > SUFFICIENT_INLIER_SHARE:
            break
    registration, alignment = best
    if alignment is None or not registration.valid:
        return best
    repeats = chosen.overview.period is not None
    is_doubtful = registration.inlier_share < UNDOUBTED_INLIER_SHARE or repeats
    before = np.linalg.inv(chosen.reference_from_keyframe) @ prior
    rests = is_at_rest(alignment, chosen.fine, before)
    if not (compare or is_doubtful or rests):
        return best
    try:
        alignment, other = choose_placement(
            chosen.grey, grey, chosen.fine, chosen.overview, alignment, rests=rests
        )
    except AmbiguousPlacementError as error:
        return reject(str(error)), alignment
    registration = _check_alignment(chosen, alignment, rests=rests)
    if other is not None:
        registration = replace(registration, other_placement=chosen.reference_from_keyframe @ other)
    return registration, alignment


def make_keyframe(
    grey: UInt8[Array, "H W"],
    exclude: Bool[Array, "H W"] | None,
    reference_from_keyframe: Float[Array, "3 3"],
    uncertainty: float,
) -> Keyframe:
    """Prepare a frame as a keyframe.

    Args:
        grey: the frame.
        exclude: where vehicles hide the ground.
        reference_from_keyframe: its transform to the reference, pixels.
        uncertainty: uncertainty of that transform over the image, pixels.

    Returns:
        The keyframe.
    """
    height, width = grey.shape
    factor = max(min(round(width / COARSE_WIDTH_PX), height // (4 * PATCH_SIDE_PX)), 1)
    return Keyframe(
        grey,
        make_template(grey, factor=factor, exclude=exclude),
        make_template(grey, exclude=exclude),
        exclude,
        make_overview(shrink_image(grey, factor), scale=1 / factor, exclude=exclude),
        reference_from_keyframe,
        uncertainty,
    )


def select_keyframe(
    keyframes: list[Keyframe], prior: Float[Array, "3 3"], size: tuple[int, int]
) -> Keyframe:
    """Select the earliest keyframe that overlaps enough, or else the one most in view."""
    shares = [compute_overlap(keyframe, prior, size) for keyframe in keyframes]
    first = next((number for number, share in enumerate(shares) if share > MIN_OVERLAP), None)
    return keyframes[int(np.argmax(shares)) if first is None else first]


def compute_overlap(
    keyframe: Keyframe, reference_from_frame: Float[Array, "3 3"], size: tuple[int, int]
) -> float:
    """Compute the share of a keyframe's patches that lie inside a frame."""
    frame_from_keyframe = np.linalg.inv(reference_from_frame) @ keyframe.reference_from_keyframe
    points = transform_points(frame_from_keyframe, keyframe.fine.points)
    return float(((points > 0) & (points < np.array(size[::-1]))).all(1).mean())


def mask_detections(frame: Frame, detections: Detections | None) -> Bool[Array, "H W"] | None:
    """Mark the pixels of detected vehicles in a frame; None if no detections are known for it."""
    boxes = convert_boxes(detections(frame)) if detections else None
    return None if boxes is None else mask_boxes(boxes.boxes, frame.grey.shape)


def _propose_starts(
    grey: UInt8[Array, "H W"],
    keyframes: list[Keyframe],
    keyframe: Keyframe,
    prior: Float[Array, "3 3"],
    model: Model,
) -> Iterator[tuple[Keyframe, Float[Array, "3 3"], bool]]:
    """Keyframes, transforms to start from, and whether to align coarse patches first."""
    near = np.linalg.inv(keyframe.reference_from_keyframe) @ prior
    yield keyframe, near, False
    yield keyframe, near, True
    features = detect_features(grey)
    for target in dict.fromkeys([keyframe, *keyframes]):
        start = match_features(target.features, features, model, size=grey.shape)
        if start is not None:
            yield target, start, True


def _check_alignment(
    keyframe: Keyframe, alignment: PatchAlignment | None, *, rests: bool = False
) -> FrameRegistration:
    """Reject an alignment that cannot be trusted; chain a good one to the reference."""
    if alignment is None:
        return reject("too few patches match the reference")
    in_view, inliers = int(alignment.in_view.sum()), int(alignment.inliers.sum())
    share = inliers / max(in_view, 1)
    quality = float(np.median(alignment.correlation[alignment.in_view]))
    size = keyframe.fine.width, keyframe.fine.height
    spread = predict_uncertainty(keyframe.fine, alignment.motion, GRID * size)
    stated = _widen_uncertainty(spread, *_measure_misfit(alignment, rests=rests))
    total = float(np.hypot(stated, keyframe.uncertainty))
    reason = ""
    if in_view < MIN_INLIERS:
        reason = f"too little overlap: {in_view} patches in view, {MIN_INLIERS} needed"
    elif inliers < MIN_INLIERS or share < MIN_INLIER_SHARE:
        reason = f"too few inliers: {inliers} of {in_view} patches agree"
    elif not alignment.converged:
        reason = "the alignment did not converge"
    elif not stated <= MAX_UNCERTAINTY_PX:
        reason = f"badly spread inliers: uncertain by {stated:.1f} px"
    matrix = keyframe.reference_from_keyframe @ alignment.matrix
    matrix = np.full((3, 3), np.nan) if reason else matrix / matrix[2, 2]
    return FrameRegistration(matrix, reason, quality, share, total)


def _measure_misfit(alignment: PatchAlignment, *, rests: bool) -> tuple[float, float, bool]:
    """Residual of the patches that match, px, NaN without any; and whether a part is frozen.

    Between them is the share of the residuals that neighbours in a row of the grid have in common:
    much where a part of the image moves, little where noise displaces each patch by itself. Strong
    compression repeats blocks of an earlier frame: they fit better than an image can. Where the
    placement `rests`, the small part that moves may be the ground.
    """
    vectors = alignment.motion.residuals
    matches = alignment.correlation[alignment.fitted] > MIN_INLIER_CORRELATION
    vectors = vectors[matches & (np.hypot(*vectors.T) < MAX_MISFIT_PX)]
    if not vectors.size:
        return np.nan, 1.0, False
    residuals = np.hypot(*vectors.T)
    share = MISFIT_QUANTILE_AT_REST if rests else MISFIT_QUANTILE
    frozen, common, misfit = np.quantile(residuals, [FROZEN_QUANTILE, MISFIT_QUANTILE, share])
    cut = vectors * np.minimum(common / np.maximum(residuals, 1e-9), 1)[:, None]
    shared = float((cut[1:] * cut[:-1]).sum() / max((cut**2).sum(), 1e-9))
    return float(misfit), max(shared, 0.0), bool(frozen < INTERPOLATION_ERROR_PX)


def _widen_uncertainty(spread: float, misfit: float, shared: float, is_frozen: bool) -> float:
    """Widen the spread of the fit where the parts of the image disagree, all in px.

    What displaces some parts (compression, waves, a rolling shutter) also misleads the others.
    """
    inflation = min(1 + (spread / UNCERTAINTY_INFLATION_PX) ** 2, MAX_INFLATION)
    excess = np.maximum(misfit**2 - BASE_RESIDUAL_PX**2, 0.0)
    misled = np.minimum(shared * excess / RESIDUAL_INFLATION_PX, MAX_MISLED_RATIO * misfit)
    if is_frozen:
        misled = FROZEN_RATIO * np.sqrt(excess)
    return float(np.linalg.norm([spread * inflation, misled, INTERPOLATION_ERROR_PX]))


def reject(reason: str) -> FrameRegistration:
    """Make the registration of a frame that is rejected."""
    return FrameRegistration(np.full((3, 3), np.nan), reason, 0.0, 0.0, np.inf)
