"""Decide whether a placement explains a frame, and between the periods of repeating texture.

A placement is accepted only if nearly all texture that is seen fits at it. Coherent traffic, an
overlay, water, a torn frame or ground without texture leave too much unexplained, whichever part
the patches follow. Texture that repeats fits at several placements: the one with most inliers is
right, if it has clearly more.
"""

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.errors import GeoaimError
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.registration.patches import (
    PatchAlignment,
    PatchTemplate,
    align_patches,
    shrink_image,
)
from geoaim.mapping.registration.rivals import Overview, Rival, find_rivals, measure_fit

# chosen on half of the validation part of `geoaim.bench.stability` and checked on the other half;
# there 0.85 of the texture was best, but it refused hover videos with dense traffic
MIN_TEXTURED_SHARE = 0.55  # of the image
MIN_EXPLAINED_SHARE = 0.8  # of what has texture
MIN_DISTANCE_PX = 1.0  # between the corners of different placements
MIN_PATCHES_OF_PART = 16
MIN_COMMON_SHARE = 0.5  # of the smaller set of inliers, for texture that repeats
MIN_REPEAT_STRENGTH = 0.2  # of the peak of repeating texture
EVEN_STRENGTH = 0.5  # of a peak, with which a placement without clearly fewer inliers is as likely
CLEAR_MAJORITY = 1.1  # ratio of inliers between placements of repeating texture


class AmbiguousPlacementError(GeoaimError):
    """The image does not tell which placement of a frame is right."""


def choose_placement(
    grey: UInt8[Array, "H W"],
    template: PatchTemplate,
    overview: Overview,
    alignment: PatchAlignment,
) -> tuple[PatchAlignment, bool]:
    """Choose the placement of repeating texture, and check that it explains the image.

    Args:
        grey: the frame.
        template: patches of the reference at full size.
        overview: small image of the reference.
        alignment: the placement found.

    Returns:
        The placement, usually the one found; and whether texture repeats.

    Raises:
        AmbiguousPlacementError: too little of the image fits, or another placement does as well.
    """
    small, repeats = shrink_image(grey, round(1 / overview.scale)), False
    for rival in find_rivals(overview, small, alignment.matrix):
        if rival.strength > MIN_REPEAT_STRENGTH:
            repeats = True
            alignment = _compare_repeats(grey, template, alignment, rival)
    points = template.points[alignment.inliers]
    textured, explained = measure_fit(overview, small, alignment.matrix, points)
    if textured < MIN_TEXTURED_SHARE:
        raise AmbiguousPlacementError(f"too little texture: on {textured:.0%} of the image")
    if explained < MIN_EXPLAINED_SHARE:
        raise AmbiguousPlacementError(
            f"parts of the image do not fit: {explained:.0%} of its texture is explained"
        )
    return alignment, repeats


def _compare_repeats(
    grey: UInt8[Array, "H W"], template: PatchTemplate, found: PatchAlignment, rival: Rival
) -> PatchAlignment:
    """The placement with clearly more inliers, when the same patches fit at both."""
    other = align_patches(template, grey, rival.reference_from_frame, found.motion.model)
    counts = int(found.inliers.sum()), 0
    if other is not None and other.converged:
        corners = image_corners(template.height, template.width)
        shift = transform_points(other.matrix, corners) - transform_points(found.matrix, corners)
        if np.hypot(*shift.T).mean() < MIN_DISTANCE_PX:
            return found
        counts = counts[0], int(other.inliers.sum())
        common = (found.inliers & other.inliers).sum()
        if counts[1] < MIN_PATCHES_OF_PART or common <= MIN_COMMON_SHARE * min(counts):
            return found
    elif rival.strength < EVEN_STRENGTH:
        return found
    if other is None or max(counts) < CLEAR_MAJORITY * min(counts) or not other.converged:
        raise AmbiguousPlacementError(
            f"texture repeats: {counts[0]} and {counts[1]} patches agree with two placements"
        )
    return found if counts[0] > counts[1] else other
