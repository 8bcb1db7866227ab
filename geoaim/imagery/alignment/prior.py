"""How far imagery is expected to be off."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import transform_points

PRIOR_MARGIN = 1.15  # times the prior's range, beyond which an answer is refused


@dataclass(frozen=True)
class Prior:
    """The largest expected error of the imagery's position.

    Raises:
        ValueError: the shift is not positive, the rotation is beyond pi, or the scaling beyond 0.5.
    """

    max_shift: float = 15.0  # metres
    max_rotation: float = float(np.radians(5))  # radians
    max_scaling: float = 0.05  # change of scale as a share: 0.05 is 5 %

    def __post_init__(self) -> None:
        if not (
            0 < self.max_shift < np.inf
            and 0 <= self.max_rotation <= np.pi
            and 0 <= self.max_scaling <= 0.5
        ):
            raise ValueError(
                f"{self}: a shift of some metres, a rotation of 0 to pi radians and a scaling of 0 "
                "to 0.5 are needed"
            )


DEFAULT_PRIOR = Prior()


def compute_log_prior(shifts: Float[Array, "*n 2"], max_shift: float) -> Float[Array, "*n"]:
    """Log density, up to a constant, of shifts whose two standard deviations are `max_shift`."""
    return -(shifts**2).sum(axis=-1) / 2 / (max_shift / 2) ** 2


def refuse_beyond_prior(
    matrix: Float[Array, "3 3"], center: Float[Array, "2"], prior: Prior
) -> None:
    """Refuse an answer that lies beyond the searched range."""
    origin, east = transform_points(matrix, center + np.array([[0.0, 0.0], [1.0, 0.0]]))
    shift = float(np.linalg.norm(origin - center))
    rotation, scale = np.arctan2(*(east - origin)[::-1]), np.linalg.norm(east - origin)
    if (
        shift > PRIOR_MARGIN * np.sqrt(2) * prior.max_shift
        or abs(rotation) > PRIOR_MARGIN * prior.max_rotation + 0.01
        or abs(np.log(scale)) > PRIOR_MARGIN * prior.max_scaling + 0.01
    ):
        raise AlignmentError(
            f"the best fit is {shift:.1f} m, {np.degrees(rotation):.1f} degrees and "
            f"{100 * (scale - 1):.1f} % away, beyond the searched range. Pass a larger prior"
        )
