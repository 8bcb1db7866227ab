"""Decide whether a placement of a frame can be told from others.

It is refused if too large a part of the image fits at another placement instead, whichever of them
the patches follow: coherent traffic, overlays, water, another view on a part of the screen.
"""

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.errors import GeoaimError
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.registration.patches import (
    PatchAlignment,
    PatchTemplate,
    align_patches,
    shrink_image,
)
from geoaim.mapping.registration.rivals import Overview, compare_placements

# chosen on the validation part of `geoaim.bench.stability`
MIN_TEXTURED_SHARE = 0.4  # of the image
MAX_MOVING_SHARE = 0.13  # of the image that may fit at another placement
# more if a camera hovers, so that the rest moves at least twice as far as the placement
MAX_MOVING_SHARE_HOVERING = 0.2
# less if the placement does not move at all, like overlays and frozen images
MAX_MOVING_SHARE_AT_REST = 0.065
REST_PX = 0.05  # mean displacement of the corners
MAX_RIVAL_STRENGTH = 0.4  # of another peak in the phase correlation, relative to the one found


class AmbiguousPlacementError(GeoaimError):
    """The image does not tell which placement of a frame is right."""


def choose_placement(
    grey: UInt8[Array, "H W"],
    template: PatchTemplate,
    overview: Overview,
    alignment: PatchAlignment,
) -> PatchAlignment:
    """Choose the right period of repeating texture, and check that nothing speaks for others.

    Args:
        grey: the frame.
        template: patches of the reference at full size.
        overview: small image of the reference.
        alignment: the placement found.

    Returns:
        The placement, usually the one found.

    Raises:
        AmbiguousPlacementError: another placement is as likely, or there is too little texture.
    """
    small = shrink_image(grey, round(1 / overview.scale))
    compared = compare_placements(overview, small, alignment.matrix)
    if compared.rival_strength > 1:
        other = align_patches(template, grey, compared.rival, alignment.motion.model)
        if other is not None and other.converged:
            alignment, compared = other, compare_placements(overview, small, other.matrix)
    if compared.textured_share < MIN_TEXTURED_SHARE:
        raise AmbiguousPlacementError(
            f"too little texture: on {compared.textured_share:.0%} of the image"
        )
    limit = MAX_MOVING_SHARE
    if is_at_rest(alignment, template):
        limit = MAX_MOVING_SHARE_AT_REST
    elif 2 * _measure_travel(alignment.matrix, template) < _measure_travel(
        compared.moving, template
    ):
        limit = MAX_MOVING_SHARE_HOVERING
    if compared.moving_share > limit:
        share = min(compared.moving_share, 1.0)
        raise AmbiguousPlacementError(
            f"a part moves by itself: another placement fits {share:.0%} as much of the image"
        )
    if compared.rival_strength > MAX_RIVAL_STRENGTH:
        raise AmbiguousPlacementError("texture repeats: another placement fits as well")
    return alignment


def is_at_rest(alignment: PatchAlignment, template: PatchTemplate) -> bool:
    """Whether a placement does not move at all, like overlays and frozen images.

    Behind an overlay the ground may move on, so that such a placement is compared in every frame.
    """
    return _measure_travel(alignment.matrix, template) < REST_PX


def _measure_travel(reference_from_frame: Float[Array, "3 3"], template: PatchTemplate) -> float:
    """Mean displacement of the image's corners, pixels."""
    corners = image_corners(template.height, template.width)
    return float(np.hypot(*(transform_points(reference_from_frame, corners) - corners).T).mean())
