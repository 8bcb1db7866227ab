"""The result of an alignment: how imagery has to be moved, and how well that is known."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.position import CHI2_1D, CHI2_2D, describe_covariance, measure_azimuth
from geoaim.base.displays import Display
from geoaim.base.geometry import transform_points
from geoaim.mapping.registration.motion_models import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_SIGMA_M = 1.0  # a direction of greater standard deviation counts as undetermined


@dataclass(frozen=True, eq=False, repr=False)
class ImageryAlignment(Display):
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

    def summarize(self) -> dict[str, str]:
        """Summarize the model, the shift, its uncertainty and its undetermined direction."""
        east, north = self.shift
        lines = {
            "model": self.model,
            "shift": f"{east:+.2f} m east, {north:+.2f} m north",
            "uncertainty (95 %)": describe_covariance(self.covariance),
        }
        if (direction := self.undetermined_direction) is not None:
            along = np.array([np.cos(direction), np.sin(direction)])
            lines["undetermined"] = f"along azimuth {measure_azimuth(along):.0f}°"
        return lines

    def _draw(self, axes: "Axes") -> None:
        angles = np.linspace(0, 2 * np.pi, 73)
        circle = np.sqrt(CHI2_2D) * np.column_stack([np.cos(angles), np.sin(angles)])
        variances, directions = np.linalg.eigh(self.covariance)
        end = self.center + self.shift
        ellipse = end + circle * np.sqrt(variances) @ directions.T
        axes.plot(*np.stack([self.center, end]).T, "o-", color="#d00000", label="shift")
        axes.plot(*ellipse.T, color="0.4", label="holds the place in 95 % of cases")
        axes.margins(0.2)
