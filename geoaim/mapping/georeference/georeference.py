"""A georeference: the transform from an image to the world, and its uncertainty."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.base.displays import Display
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.world import World, describe_world
from geoaim.mapping.georeference.transform_models import Points, Posterior, undistort_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, repr=False)
class Georeference(Display):
    """Where an image lies in the world."""

    # pixels to world metres; where `radial` is not 0, pixels without lens distortion
    # (`undistort_points`)
    world_from_image: Float[Array, "3 3"]
    world: World  # the plane of those metres
    model: str  # "similarity" or "homography"
    radial: float  # k of p' = p (1 + k |p|^2) in the normalised plane
    height: int  # height of the image, pixels
    width: int  # width of the image, pixels
    pixels: Points  # (M, 2) pixels of all control points, used or not
    residuals: Points  # (M, 2) fitted minus given, metres, of every control point
    leave_one_out: Float[Array, "m"]  # distance of each point from a fit without it, metres
    used: Bool[Array, "m"]  # False for a point that was found to be wrong
    # probability of each model, given the points; empty where the points did not choose the model
    probabilities: Mapping[str, float] = field(repr=False)
    noise: float  # one sigma of one coordinate of a control point, metres
    # the terms of the chosen model (`transform_models`), zero where it has none
    terms: Float[Array, "9"] = field(repr=False)
    posterior: Posterior = field(repr=False)  # posterior of all nine terms, in the normalised plane
    # similarity from the normalised plane to world metres
    world_from_plane: Float[Array, "3 3"] = field(repr=False)
    # True when it comes from telemetry or an assumed resolution, not from points
    approximate: bool = False
    # one sigma of the transformation from the points' CRS to the world's, metres; all of the image
    # is off alike
    datum_accuracy: float = 0.0

    def summarize(self) -> dict[str, str]:
        """Summarize the model, its errors at the control points and the size of the image."""
        errors = self.leave_one_out[self.used]
        lines = {"model": ("approximate, " if self.approximate else "") + self.model}
        if errors.size:
            rms = np.sqrt(np.mean(np.square(errors)))
            lines["leave-one-out error"] = f"{rms:.4f} m (RMS of {errors.size} points)"
        lines["control points"] = f"{self.used.sum()} of {len(self.used)} used"
        lines["image"] = f"{self.width} x {self.height} px"
        if self.datum_accuracy:
            lines["accuracy of the CRS's transformation"] = f"{self.datum_accuracy:g} m"
        return lines | {"world": describe_world(self.world)}

    def _draw(self, axes: "Axes") -> None:
        from geoaim.base.map_axes import (
            UNUSED_COLOUR,
            USED_COLOUR,
            draw_lines,
            label_place,
            move_to_axes,
        )
        from geoaim.mapping.georeference.uncertainty import CORNERS, predict_uncertainty

        corners = image_corners(self.height, self.width)
        pixels = np.vstack([corners, corners.mean(axis=0)])
        places = move_to_axes(axes, world_from_pixels(self, pixels), self.world)
        outline = places[[0, 1, 2, 3, 0]]
        draw_lines(axes, [outline], "#d00000", width=1.5, label="outline of the image")
        _, radii = predict_uncertainty(self, pixels)
        for name, place, radius in zip((*CORNERS, "middle"), places, radii, strict=True):
            label_place(axes, f"{name}\n95 %: {radius:.2g} m", place)
        given = world_from_pixels(self, self.pixels) - self.residuals
        x, y = move_to_axes(axes, given, self.world).T
        for chosen, colour, name in (
            (self.used, USED_COLOUR, "used"),
            (~self.used, UNUSED_COLOUR, "not used"),
        ):
            if chosen.any():
                label = f"control points, {name}"
                axes.scatter(x[chosen], y[chosen], s=60, marker="+", color=colour, label=label)


def world_from_pixels(georeference: Georeference, pixels: Points) -> Points:
    """Transform pixels as they lie in the image to world metres, correcting lens distortion."""
    size = (georeference.height, georeference.width)
    undistorted = undistort_points(pixels, georeference.radial, *size)
    return transform_points(georeference.world_from_image, undistorted)
