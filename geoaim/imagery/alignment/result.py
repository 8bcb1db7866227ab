"""How far imagery may be off, and the result of an alignment: how it has to be moved."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.position import CHI2_1D, CHI2_2D
from geoaim.base.defaults import MAX_ROTATION_DEGREES, MAX_SCALING, MAX_SHIFT
from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import transform_points
from geoaim.mapping.registration.motion_models import Model

MAX_SIGMA_M = 1.0  # a direction of greater standard deviation counts as undetermined


@dataclass(frozen=True, eq=False)
class ImageryAlignment:
    """How imagery has to be moved to its true place."""

    true_from_stated: Float[Array, "3 3"]  # metres; stated = by the image's own georeference
    model: Model  # the simplest motion model that the evidence supports
    covariance: Float[Array, "2 2"]  # covariance of a point of the imagery, square metres
    center: Float[Array, "2"]  # centre of the ground that the evidence comes from, metres
    # numbers that the alignment rests on, for the report
    evidence: Mapping[str, Any] = field(default_factory=dict)
    # windows of an AIM that agree: their centres, and how far what the imagery shows there lies
    # from where the alignment moves it, x and y; metres
    windows: Float[Array, "M 4"] | None = None
    window_side: float = 0.0  # metres

    @property
    def uncertainty(self) -> float:
        """Radius in metres that holds a point with about 95 % probability.

        It is exact when both standard deviations are equal, and when one of them is 0.
        """
        least, most = np.linalg.eigvalsh(self.covariance)
        return float(np.sqrt(CHI2_1D * most + (CHI2_2D - CHI2_1D) * least))

    @property
    def undetermined_direction(self) -> float | None:
        """Direction in which the place is unknown, radians from east; None if it is known."""
        variances, directions = np.linalg.eigh(self.covariance)
        if variances[1] < MAX_SIGMA_M**2:
            return None
        return float(np.arctan2(*directions[::-1, 1]))

    @property
    def shift(self) -> Float[Array, "2"]:
        """Metres east and north by which the imagery is moved at the center."""
        return transform_points(self.true_from_stated, self.center[None])[0] - self.center


PRIOR_MARGIN = 1.15  # times the prior's range, beyond which an answer is refused


@dataclass(frozen=True)
class Prior:
    """The largest expected error of the imagery's position.

    Raises:
        ValueError: the shift is not positive, the rotation is beyond pi, or the scaling beyond 0.5.
    """

    max_shift: float = MAX_SHIFT  # metres
    max_rotation: float = float(np.radians(MAX_ROTATION_DEGREES))  # radians
    max_scaling: float = MAX_SCALING  # change of scale as a share

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
