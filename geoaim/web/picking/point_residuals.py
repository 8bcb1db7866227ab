"""Residuals of control points and ellipses of uncertainty, in metres and in pixels."""

import math
from dataclasses import dataclass

import numpy as np

from geoaim.base.geometry import image_corners, transform_points
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.georeference import Georeference, world_from_pixels
from geoaim.mapping.georeference.normalised_plane import Points, distort_points
from geoaim.mapping.georeference.uncertainty import CORNERS, predict_ellipses

Vector = tuple[float, float]


@dataclass(frozen=True)
class PointResidual:
    """How far a control point lies from where the fit puts it."""

    name: str
    residual_m: Vector  # east and north, metres: where the fit puts its pixel, minus its place
    distance_m: float  # length of that
    residual_px: Vector  # u and v: its pixel minus where the fit puts its place
    leave_one_out_m: float | None  # distance from a fit without it; None: not known
    used: bool  # False: the point was found to be wrong and is left out of the fit


@dataclass(frozen=True)
class PlaceUncertainty:
    """The ellipse that holds the true place of a pixel in 95 % of cases."""

    place: str  # "top left", ..., "middle"
    u: float  # pixel
    v: float
    radius_m: float  # semi-major axis, metres
    # centre + cos(t) first + sin(t) second are the points of the ellipse
    axes_m: tuple[Vector, Vector]  # metres east and north
    axes_px: tuple[Vector, Vector]  # pixels right and down


def measure_residuals(
    georeference: Georeference, points: ControlPoints
) -> tuple[PointResidual, ...]:
    """Measure the residual of each control point in metres and in pixels."""
    residuals = georeference.residuals
    given = world_from_pixels(georeference, points.pixels) - residuals
    pixels = points.pixels - pixels_from_world(georeference, given)
    rows = zip(
        points.names,
        residuals.tolist(),
        np.linalg.norm(residuals, axis=1).tolist(),
        pixels.tolist(),
        [None if math.isnan(error) else float(error) for error in georeference.leave_one_out],
        georeference.used.tolist(),
        strict=True,
    )
    return tuple(
        PointResidual(name, (x, y), metres, (u, v), left_out, used)
        for name, (x, y), metres, (u, v), left_out, used in rows
    )


def predict_places(georeference: Georeference) -> tuple[PlaceUncertainty, ...]:
    """Predict the uncertainty at the image's corners and in its middle."""
    corners = image_corners(georeference.height, georeference.width)
    pixels = np.vstack([corners, corners.mean(axis=0)])
    metres = predict_ellipses(georeference, pixels)
    centres = world_from_pixels(georeference, pixels)
    step = 1e-6 * np.ptp(centres, axis=0).max()
    moved = [
        pixels_from_world(georeference, centres + offset) - pixels
        for offset in (np.array([step, 0.0]), np.array([0.0, step]))
    ]
    axes_px = metres @ np.stack(moved, axis=1) / step
    radii = np.linalg.norm(metres[:, 0], axis=1)
    return tuple(
        PlaceUncertainty(place, float(u), float(v), float(radius), _pair(rows), _pair(pixel_rows))
        for place, (u, v), radius, rows, pixel_rows in zip(
            (*CORNERS, "middle"), pixels, radii, metres, axes_px, strict=True
        )
    )


def pixels_from_world(georeference: Georeference, places: Points) -> Points:
    """Transform world metres to pixels of the image, with its lens distortion."""
    undistorted = transform_points(np.linalg.inv(georeference.world_from_image), places)
    return distort_points(undistorted, georeference.radial, georeference.height, georeference.width)


def _pair(rows: Points) -> tuple[Vector, Vector]:
    (a, b), (c, d) = rows.tolist()
    return (a, b), (c, d)
