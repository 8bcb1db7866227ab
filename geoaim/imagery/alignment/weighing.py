"""Weigh an alignment of imagery against what was known of its place before."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.geometry import translation
from geoaim.imagery.alignment.result import ImageryAlignment

UNKNOWN_M2 = 1e8  # variance of what is not known, square metres


def weigh_alignment(
    alignment: ImageryAlignment, own: Float[Array, "2 2"], reference: Float[Array, "2 2"]
) -> tuple[ImageryAlignment, Float[Array, "2 2"]]:
    """Combine an alignment with what was known of the imagery's place before.

    The alignment says where the imagery lies relative to its reference, which may itself be off.
    In a direction in which the imagery's own place is better known it stays.

    >>> off = ImageryAlignment(translation(5.0, 5.0), "translation", np.eye(2) * 0.01, np.zeros(2))
    >>> moved, _ = weigh_alignment(off, np.eye(2) * 100, np.diag([0.0, 1e6]))
    >>> moved.shift.round(1).tolist()  # of north the reference says nothing
    [5.0, 0.0]
    """
    gain = own @ np.linalg.inv(own + reference + alignment.covariance)
    remaining = np.eye(2) - gain
    back = -remaining @ alignment.shift
    covariance = remaining @ own
    moved = replace(alignment, true_from_stated=translation(*back) @ alignment.true_from_stated)
    return moved, (covariance + covariance.T) / 2


def forget_undetermined_direction(alignment: ImageryAlignment) -> ImageryAlignment:
    """State that nothing is known along the undetermined direction of an alignment."""
    direction = alignment.undetermined_direction
    if direction is None:
        return alignment
    along = np.array([np.cos(direction), np.sin(direction)])
    return replace(alignment, covariance=alignment.covariance + np.outer(along, along) * UNKNOWN_M2)
