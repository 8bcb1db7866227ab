"""Decide whether the placement of a frame, its transform to the reference, is unambiguous.

A frame is rejected if too large a part of the image fits at another placement: coherent traffic,
overlays, water, another view on a part of the screen.
"""

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.mapping.registration.patches import (
    PatchAlignment,
    PatchTemplate,
    align_patches,
    shrink_image,
)
from geoaim.mapping.registration.placement_comparison import Overview, compare_placements

# chosen on the validation part of `benchmarks.registration.stability`
MIN_TEXTURED_SHARE = 0.4  # smallest textured share of the image
MAX_COMPETING_FIT_RATIO = 0.13  # share of the image that may fit at another placement
# more if a camera hovers, so that the rest moves at least twice as far as the placement
MAX_COMPETING_FIT_RATIO_HOVERING = 0.2
# less if the placement does not move at all, like overlays and frozen images
MAX_COMPETING_FIT_RATIO_AT_REST = 0.065
MAX_REST_SHIFT_PX = 0.05  # mean displacement of the corners
# a camera that hovers moves more; frozen blocks of H.264 move less
MIN_HOVERING_SHIFT_PX = 1.0
# another placement that is nearer does not count unless it fits nearly as well: roofs and trees
# from an aeroplane, whose distance the stated uncertainty includes
MIN_COMPETING_DISTANCE_PX = 5.0
MAX_NEAR_FIT_RATIO = 0.65
MIN_MOVING_SHARE = 0.025  # that tells another placement from chance
MAX_OTHER_PEAK_STRENGTH = 0.4  # of another peak in the phase correlation, relative to the one found

MOVING_PART = "a part moves by itself"  # begins the reason of a rejection


class AmbiguousPlacementError(GeoaimError):
    """The image does not tell which placement of a frame is right."""


def choose_placement(
    grey: UInt8[Array, "H W"],
    template: PatchTemplate,
    overview: Overview,
    alignment: PatchAlignment,
) -> tuple[PatchAlignment, Float[Array, "3 3"] | None]:
    """Accept a placement unless another fits nearly as well.

    On repeating texture it is first moved to the period that fits best.
    """
    small = shrink_image(grey, round(1 / overview.scale))
    compared = compare_placements(overview, small, alignment.matrix)
    if compared.other_peak_strength > 1:
        other = align_patches(template, grey, compared.other_peak, alignment.motion.model)
        if other is not None and other.converged:
            alignment, compared = other, compare_placements(overview, small, other.matrix)
    if compared.textured_share < MIN_TEXTURED_SHARE:
        raise AmbiguousPlacementError(
            f"too little texture: on {compared.textured_share:.0%} of the image"
        )
    limit, travel = MAX_COMPETING_FIT_RATIO, _measure_travel(alignment.matrix, template)
    if is_at_rest(alignment, template):
        limit = MAX_COMPETING_FIT_RATIO_AT_REST
    elif travel > MIN_HOVERING_SHIFT_PX and _measure_travel(compared.moving, template) > 2 * travel:
        limit = MAX_COMPETING_FIT_RATIO_HOVERING
    if _measure_distance(compared.moving, alignment.matrix, template) < MIN_COMPETING_DISTANCE_PX:
        limit = MAX_NEAR_FIT_RATIO
    if compared.competing_fit_ratio > limit:
        share = min(compared.competing_fit_ratio, 1.0)
        raise AmbiguousPlacementError(
            f"{MOVING_PART}: another placement fits {share:.0%} as much of the image"
        )
    strongest = MAX_OTHER_PEAK_STRENGTH
    if (
        _measure_distance(compared.other_peak, alignment.matrix, template)
        < MIN_COMPETING_DISTANCE_PX
    ):
        strongest = MAX_NEAR_FIT_RATIO
    if compared.other_peak_strength > strongest:
        raise AmbiguousPlacementError("texture repeats: another placement fits as well")
    moves = compared.competing_fit_ratio > MIN_MOVING_SHARE and not overview.repeats
    return alignment, compared.moving if moves else None


def is_at_rest(alignment: PatchAlignment, template: PatchTemplate) -> bool:
    """Whether a placement does not move at all, like overlays and frozen images.

    Behind an overlay the ground may move on, so that such a placement is compared in every frame.
    """
    return _measure_travel(alignment.matrix, template) < MAX_REST_SHIFT_PX


def _measure_travel(reference_from_frame: Float[Array, "3 3"], template: PatchTemplate) -> float:
    """Mean displacement of the image's corners, pixels."""
    return _measure_distance(reference_from_frame, np.eye(3), template)


def _measure_distance(
    one: Float[Array, "3 3"], other: Float[Array, "3 3"], template: PatchTemplate
) -> float:
    """Mean distance of the image's corners at two placements, pixels."""
    corners = image_corners(template.height, template.width)
    return float(
        np.hypot(*(transform_points(one, corners) - transform_points(other, corners)).T).mean()
    )
