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
from geoaim.mapping.registration.rivals import Overview, find_rivals

MIN_DISTANCE_PX = 1.0  # between the corners of different placements
MIN_PATCHES_OF_PART = 16
MIN_COMMON_SHARE = 0.5  # of the smaller set of inliers, for texture that repeats
CLEAR_MAJORITY = 1.1  # ratio of inliers between placements of repeating texture
CLEAR_SLOWNESS = 0.5  # ratio of the displacements since the reference of ground and traffic
MIN_GROUND_SHARE = 0.25  # inliers of a slower part that is the ground, relative to the other part
MIN_DOUBT_SHARE = 0.08  # with which a slower part makes the placement doubtful
MAX_TRAFFIC_SHARE = 0.35  # with which a part that is not slower does
MAX_STATIC_PX = 0.15  # displacement of an overlay, which is fixed to the frame
NEAR_PX = 0.75  # by which displacements of patches of one part differ


class AmbiguousPlacementError(GeoaimError):
    """Different parts of a frame support different placements, and none is clearly the ground."""


def choose_placement(
    grey: UInt8[Array, "H W"],
    template: PatchTemplate,
    overview: Overview,
    alignment: PatchAlignment,
) -> PatchAlignment:
    """Choose the placement of the ground among those that parts of the image support.

    Args:
        grey: the frame.
        template: patches of the reference at full size.
        overview: small image of the reference.
        alignment: the placement found.

    Returns:
        The placement of the ground, mostly the one found.

    Raises:
        AmbiguousPlacementError: none is clearly the ground.
    """
    small = shrink_image(grey, round(1 / overview.scale))
    rivals = find_rivals(overview, small, alignment.matrix)
    for start in [*_find_near_rivals(alignment), *rivals]:
        rival = align_patches(template, grey, start, alignment.motion.model)
        if rival is None or not rival.converged or rival.inliers.sum() < MIN_PATCHES_OF_PART:
            continue
        if _measure_distance(template, rival.matrix, alignment.matrix) < MIN_DISTANCE_PX:
            continue
        if _share_inliers(alignment, rival):
            alignment = _choose_by_inliers(alignment, rival)
        else:
            alignment = _choose_slower(template, alignment, rival)
    return alignment


def _find_near_rivals(alignment: PatchAlignment) -> Iterator[Float[Array, "3 3"]]:
    """The displacement that most other patches share, within the reach of the patches."""
    candidates = alignment.fitted & (alignment.correlation > MIN_INLIER_CORRELATION)
    residuals = alignment.motion.residuals[(candidates & ~alignment.inliers)[alignment.fitted]]
    if len(residuals) < MIN_PATCHES_OF_PART:
        return
    near = np.hypot(*(residuals[:, None] - residuals).transpose(2, 0, 1)) < NEAR_PX
    members = near[near.sum(0).argmax()]
    if members.sum() >= MIN_PATCHES_OF_PART:
        yield translation(*residuals[members].mean(0)) @ alignment.matrix


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
    template: PatchTemplate, found: PatchAlignment, rival: PatchAlignment
) -> PatchAlignment:
    """The part that moved clearly less since the reference, if it is large enough."""
    moved, its = (_measure_distance(template, part.matrix, np.eye(3)) for part in (found, rival))
    share = int(rival.inliers.sum()) / int(found.inliers.sum())
    rival_is_slower = MAX_STATIC_PX < its < CLEAR_SLOWNESS * moved
    if rival_is_slower and share > MIN_GROUND_SHARE:
        return rival
    found_is_slower = moved < CLEAR_SLOWNESS * its
    if share < (MIN_DOUBT_SHARE if rival_is_slower else MAX_TRAFFIC_SHARE) or found_is_slower:
        return found
    raise AmbiguousPlacementError(
        f"two motions: parts of the image moved by {moved:.1f} and {its:.1f} px since the reference"
    )


def _measure_distance(
    template: PatchTemplate, one: Float[Array, "3 3"], other: Float[Array, "3 3"]
) -> float:
    """Mean distance between the image's corners, px."""
    corners = image_corners(template.height, template.width)
    shift = transform_points(one, corners) - transform_points(other, corners)
    return float(np.hypot(*shift.T).mean())
