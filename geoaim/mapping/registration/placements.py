"""Choose between the placements of a frame that different parts of the image support.

Texture that repeats fits at several placements: the one with most inliers is right, if it has
clearly more. Parts that move apart (traffic, an overlay, a torn frame) are different patches: the
ground is what moves less since the reference, if it moves clearly less, for the camera hovers.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.errors import GeoaimError
from geoaim.geometry import image_corners, transform_points, translation
from geoaim.mapping.registration.patches import (
    MIN_INLIER_CORRELATION,
    PatchAlignment,
    PatchTemplate,
    align_patches,
    shrink_image,
)
from geoaim.mapping.registration.rivals import Overview, Rival, compare_areas, find_rivals

MIN_DISTANCE_PX = 1.0  # between the corners of different placements
MIN_PATCHES_OF_PART = 16
MIN_COMMON_SHARE = 0.5  # of the smaller set of inliers, for texture that repeats
MIN_REPEAT_STRENGTH = 0.2  # of the peak of repeating texture
CLEAR_MAJORITY = 1.1  # ratio of inliers between placements of repeating texture
MIN_DISTINCT_AREA = 0.3  # of the image that fits one placement only; less if texture repeats
CLEAR_SLOWNESS = 0.6  # ratio of the displacements since the reference of ground and traffic
MIN_RIVAL_SHARE = 0.025  # area that fits only a rival, relative to what fits one of the two
MIN_UNALIGNED_SHARE = 0.035  # of a part on which no patches lie
CONTESTED_SHARE = 0.08  # of a rival, above which the next frame is compared as well
MIN_GROUND_SHARE = 0.2  # of a slower part that can be the ground
MAX_TRAFFIC_SHARE = 0.3  # of a part that is not slower; a larger one makes a frame ambiguous
EVEN_SHARE = 0.08  # from one half, within which neither part is taken for the ground
MAX_OVERLAID_SHARE = 0.1  # of a moving part, if the other is static; more is ambiguous
MAX_STATIC_PX = 0.15  # displacement of an overlay, which is fixed to the frame
NEAR_PX = 0.75  # by which displacements of patches of one part differ


class AmbiguousPlacementError(GeoaimError):
    """Different parts of a frame support different placements, and none is clearly the ground."""


def choose_placement(
    grey: UInt8[Array, "H W"],
    template: PatchTemplate,
    overview: Overview,
    alignment: PatchAlignment,
) -> tuple[PatchAlignment, bool]:
    """Choose the placement of the ground among those that parts of the image support.

    Args:
        grey: the frame.
        template: patches of the reference at full size.
        overview: small image of the reference.
        alignment: the placement found.

    Returns:
        The placement of the ground, usually the one found; and whether a large part of the image
        supports another one.

    Raises:
        AmbiguousPlacementError: none is clearly the ground.
    """
    contested = False
    small = shrink_image(grey, round(1 / overview.scale))
    rivals = find_rivals(overview, small, alignment.matrix)
    for start, strength in [*_find_near_rivals(alignment), *rivals]:
        areas = compare_areas(overview, small, alignment.matrix, start)
        share = areas[1] / max(sum(areas), 1e-9)
        if share < MIN_RIVAL_SHARE and sum(areas) > MIN_DISTINCT_AREA:
            continue
        contested |= share > CONTESTED_SHARE
        rival = _align_rival(grey, template, start, alignment)
        if rival is not None and _share_inliers(alignment, rival):
            if strength > MIN_REPEAT_STRENGTH:
                contested = True
                alignment = _choose_by_inliers(alignment, rival)
        elif rival is not None:
            alignment = _choose_slower(template, alignment, rival, share)
        elif share > MIN_UNALIGNED_SHARE:
            _check_speed(template, alignment, start)
    return alignment, contested


def _find_near_rivals(alignment: PatchAlignment) -> Iterator[Rival]:
    """The displacement that most outlying patches share, if there are enough of them."""
    candidates = alignment.fitted & (alignment.correlation > MIN_INLIER_CORRELATION)
    residuals = alignment.motion.residuals[(candidates & ~alignment.inliers)[alignment.fitted]]
    if len(residuals) < MIN_PATCHES_OF_PART:
        return
    near = np.hypot(*(residuals[:, None] - residuals).transpose(2, 0, 1)) < NEAR_PX
    members = near[near.sum(0).argmax()]
    if members.sum() >= MIN_PATCHES_OF_PART:
        yield Rival(translation(*residuals[members].mean(0)) @ alignment.matrix, 1.0)


def _align_rival(
    grey: UInt8[Array, "H W"],
    template: PatchTemplate,
    start: Float[Array, "3 3"],
    found: PatchAlignment,
) -> PatchAlignment | None:
    """Align the patches near another placement; None when they do not stay there."""
    rival = align_patches(template, grey, start, found.motion.model)
    if rival is None or not rival.converged or rival.inliers.sum() < MIN_PATCHES_OF_PART:
        return None
    is_distinct = _measure_distance(template, rival.matrix, found.matrix) > MIN_DISTANCE_PX
    return rival if is_distinct else None


def _share_inliers(one: PatchAlignment, other: PatchAlignment) -> bool:
    common = (one.inliers & other.inliers).sum()
    return bool(common > MIN_COMMON_SHARE * min(one.inliers.sum(), other.inliers.sum()))


def _choose_by_inliers(one: PatchAlignment, other: PatchAlignment) -> PatchAlignment:
    counts = int(one.inliers.sum()), int(other.inliers.sum())
    if max(counts) < CLEAR_MAJORITY * min(counts):
        raise AmbiguousPlacementError(
            f"texture repeats: {counts[0]} and {counts[1]} patches agree with two placements"
        )
    return one if counts[0] > counts[1] else other


def _choose_slower(
    template: PatchTemplate, found: PatchAlignment, rival: PatchAlignment, share: float
) -> PatchAlignment:
    """The part that moved clearly less since the reference, if it is large enough."""
    found_shift, rival_shift = (
        _measure_distance(template, part.matrix, np.eye(3)) for part in (found, rival)
    )
    is_even = abs(share - 0.5) < EVEN_SHARE
    if MAX_STATIC_PX < rival_shift < CLEAR_SLOWNESS * found_shift:
        if share > MIN_GROUND_SHARE and not is_even:
            return rival
    elif found_shift < MAX_STATIC_PX:
        if share < MAX_OVERLAID_SHARE:
            return found
    elif share < MAX_TRAFFIC_SHARE or (found_shift < CLEAR_SLOWNESS * rival_shift and not is_even):
        return found
    raise _report_motions(found_shift, rival_shift)


def _check_speed(
    template: PatchTemplate, found: PatchAlignment, start: Float[Array, "3 3"]
) -> None:
    """Refuse a placement when a part that no patches lie on moved clearly less."""
    found_shift, rival_shift = (
        _measure_distance(template, one, np.eye(3)) for one in (found.matrix, start)
    )
    if rival_shift < CLEAR_SLOWNESS * found_shift:
        raise _report_motions(found_shift, rival_shift)


def _report_motions(found_shift: float, rival_shift: float) -> AmbiguousPlacementError:
    return AmbiguousPlacementError(
        f"two motions: parts of the image moved by {found_shift:.1f} and {rival_shift:.1f} px"
        " since the reference"
    )


def _measure_distance(
    template: PatchTemplate, one: Float[Array, "3 3"], other: Float[Array, "3 3"]
) -> float:
    """Mean distance between the image's corners, px."""
    corners = image_corners(template.height, template.width)
    shift = transform_points(one, corners) - transform_points(other, corners)
    return float(np.hypot(*shift.T).mean())
