"""Feedback on the points picked so far: residuals, uncertainty, and where to pick next."""

import math
import re
import warnings
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.world import World
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import (
    MIN_PRELIMINARY_POINTS,
    estimate_georeference,
    estimate_preliminary,
)
from geoaim.mapping.georeference.georeference import Georeference, world_from_pixels
from geoaim.mapping.georeference.point_checks import MIN_POINTS
from geoaim.mapping.georeference.transform_models import Points, distort_points
from geoaim.mapping.georeference.uncertainty import (
    CORNERS,
    map_uncertainty,
    predict_ellipses,
    suggest_point,
)

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


@dataclass(frozen=True)
class Message:
    """A refusal or a warning, and the control points that it names."""

    text: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class NextPoint:
    """Where one more control point lowers the largest uncertainty in the image most."""

    u: float  # pixel
    v: float
    # at the worst place of the image, radius that holds the true place in 95 % of cases, metres
    largest_m: float
    largest_with_point_m: float  # the same with a control point there


@dataclass(frozen=True)
class PointFeedback:
    """What follows from the control points picked so far."""

    missing: int  # points with pixel and place that a georeference still needs
    problem: Message | None  # why the points give no georeference
    warnings: tuple[Message, ...]
    # fitted to the points; a similarity that is not checked (`approximate`) if they are too few or
    # have a problem; None if even that cannot be fitted
    georeference: Georeference | None
    # residual of each point; empty for fewer than three points
    residuals: tuple[PointResidual, ...]
    places: tuple[PlaceUncertainty, ...]  # the uncertainty at the corners and in the middle
    next_point: NextPoint | None


def assess_points(
    points: ControlPoints, size: tuple[int, int], world: World | None = None
) -> PointFeedback:
    """Assess control points while they are picked; a bad layout gives feedback, not an error."""
    missing = max(MIN_POINTS - len(points.names), 0)
    georeference, problem, caught = _estimate(points, size, world)
    if georeference is None and len(points.names) >= MIN_PRELIMINARY_POINTS:
        try:
            georeference = estimate_preliminary(points, height=size[0], width=size[1], world=world)
        except GeoreferenceError as error:
            problem = problem or str(error)
    feedback = PointFeedback(
        missing=missing,
        problem=None if problem is None else _find_names(problem, points),
        warnings=tuple(_find_names(text, points) for text in caught),
        georeference=georeference,
        residuals=(),
        places=(),
        next_point=None,
    )
    return feedback if georeference is None else _add_accuracy(feedback, georeference, points)


def _estimate(
    points: ControlPoints, size: tuple[int, int], world: World | None
) -> tuple[Georeference | None, str | None, list[str]]:
    """The georeference or the reason why there is none, and the warnings."""
    georeference, problem = None, None
    if len(points.names) < MIN_POINTS:
        return None, None, []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", GeoaimWarning)
        try:
            georeference = estimate_georeference(points, height=size[0], width=size[1], world=world)
        except GeoreferenceError as error:
            problem = str(error)
    return georeference, problem, [str(warning.message) for warning in caught]


def _find_names(text: str, points: ControlPoints) -> Message:
    """A message with the names of the points that stand in its text."""
    found = (re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text) for name in points.names)
    named = tuple(name for name, match in zip(points.names, found, strict=True) if match)
    return Message(text, named)


def _add_accuracy(
    feedback: PointFeedback, georeference: Georeference, points: ControlPoints
) -> PointFeedback:
    (u, v), now, then = suggest_point(georeference)
    return replace(
        feedback,
        residuals=measure_residuals(georeference, points) if len(points.names) > 2 else (),
        places=predict_places(georeference),
        next_point=NextPoint(float(u), float(v), now, then),
    )


def describe_feedback(feedback: PointFeedback) -> dict[str, Any]:
    """Describe the feedback as plain JSON, with the transform and the map of its uncertainty."""
    georeference = feedback.georeference
    plain = asdict(replace(feedback, georeference=None))
    if georeference is None:
        return plain
    uncertainty = map_uncertainty(georeference)
    plain["georeference"] = {
        "model": georeference.model,
        "preliminary": georeference.approximate,
        "world_from_image": georeference.world_from_image.tolist(),
        "radial": georeference.radial,
        "crs": georeference.world.crs,
        "origin": georeference.world.origin,
        "noise_m": georeference.noise,
        "probability_by_model": dict(georeference.probabilities),
        "uncertainty": {**uncertainty, "map_m": uncertainty["map_m"].tolist()},
    }
    return plain
