"""The result of an alignment: how imagery has to be moved, and how well that is known."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.position import CHI2_1D, CHI2_2D
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
