"""The picture being drawn, and strokes in plan metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from geoaim.geometry import transform_points
from geoaim.synthetic.texture import natural_noise, polygon_mask


@dataclass(frozen=True)
class Page:
    """The picture being drawn (float, changed in place) and what all strokes need."""

    image: Float32[Array, "H W 3"]
    image_from_plan: Float[Array, "3 3"]
    metres_per_pixel: float
    generator: np.random.Generator

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.image.shape[0], self.image.shape[1]

    def noise(self, slope: float) -> Float32[Array, "H W"]:
        """Natural noise over the page."""
        return natural_noise(self.shape, slope, self.generator)

    def mask(self, *polygons: Float[Array, "_ 2"]) -> Float32[Array, "H W"]:
        """Anti-aliased polygons given in plan metres."""
        return polygon_mask(
            self.shape, [transform_points(self.image_from_plan, p) for p in polygons]
        )


def circle(centre: Float[Array, "2"], radius: float) -> Float[Array, "24 2"]:
    """A round polygon."""
    turn = np.linspace(0, 2 * np.pi, 25)[:-1]
    return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1) + centre
