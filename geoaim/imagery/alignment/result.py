"""How imagery has to be moved to lie where it should, and how well that is known."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.geometry import transform_points
from geoaim.mapping.registration.motion_models import Model

CHI2 = 5.99  # 95 % of the sum of two squared normal variables
ONE = 3.84  # 95 % of one
LOOSE = 1.0  # m of standard deviation at which a direction counts as not determined


@dataclass(frozen=True)
class Prior:
    """How far off imagery may be: metres, radians, and share of its size.

    Raises:
        ValueError: the reach is not positive, the turn is over half a circle, or the zoom over 0.5.
    """

    reach: float = 15.0
    turn: float = float(np.radians(5))
    zoom: float = 0.05

    def __post_init__(self) -> None:
        if not (0 < self.reach < np.inf and 0 <= self.turn <= np.pi and 0 <= self.zoom <= 0.5):
            raise ValueError(
                f"{self}: a reach of some metres, a turn of 0 to pi radians and a zoom of 0 to 0.5 "
                "are needed"
            )


PRIOR = Prior()


@dataclass(frozen=True, eq=False)
class Alignment:
    """How imagery has to be moved.

    Attributes:
        true_from_stated: (3, 3) metres where it says to lie -> where it lies, in one world.
        model: the least motion that the evidence supports.
        covariance: (2, 2) of a place in square metres.
        middle: (2,) of the ground that the evidence comes from, metres.
        evidence: what it rests on, for the report.
    """

    true_from_stated: Float[Array, "3 3"]
    model: Model
    covariance: Float[Array, "2 2"]
    middle: Float[Array, "2"]
    evidence: Mapping[str, Any] = field(default_factory=dict)

    @property
    def uncertainty(self) -> float:
        """Metres within which a place is with about 95 % probability."""
        least, most = np.linalg.eigvalsh(self.covariance)
        return float(np.sqrt(ONE * most + (CHI2 - ONE) * least))  # right when equal, and on a line

    @property
    def undetermined(self) -> float | None:
        """Radians from east of the direction along which the place is not known; None if it is."""
        variances, directions = np.linalg.eigh(self.covariance)
        if variances[1] < LOOSE**2:
            return None
        return float(np.arctan2(*directions[::-1, 1]))

    @property
    def shift(self) -> Float[Array, "2"]:
        """Metres east and north by which the imagery is moved in the middle."""
        return transform_points(self.true_from_stated, self.middle[None])[0] - self.middle


def moved(imagery: AIM, alignment: Alignment) -> AIM:
    """The imagery where it lies."""
    return replace(imagery, world_from_image=alignment.true_from_stated @ imagery.world_from_image)


def report_alignment(alignment: Alignment) -> dict[str, Any]:
    """What was found, in metres and degrees, for an AIM's report."""
    matrix, direction = alignment.true_from_stated, alignment.undetermined
    east = np.array([[0.0, 0.0], [1.0, 0.0]]) + alignment.middle
    start, end = transform_points(matrix, east)
    return {
        "model": alignment.model,
        "shift_m": alignment.shift,
        "turn_degrees": float(np.degrees(np.arctan2(*(end - start)[::-1]))),
        "zoom": float(np.linalg.norm(end - start)),
        "uncertainty_m": alignment.uncertainty,
        "covariance_m2": alignment.covariance,
        "undetermined_degrees": None if direction is None else float(np.degrees(direction)),
        "true_from_stated": matrix,
        **alignment.evidence,
    }
