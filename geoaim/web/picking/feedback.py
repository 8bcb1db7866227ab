"""Feedback on the points picked so far: residuals, uncertainty, and where to pick next."""

import re
import warnings
from dataclasses import asdict, dataclass, replace
from typing import Any

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.base.world import World
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.point_checks import MIN_POINTS
from geoaim.mapping.georeference.preliminary import MIN_PRELIMINARY_POINTS, estimate_preliminary
from geoaim.mapping.georeference.uncertainty import map_uncertainty, suggest_point
from geoaim.web.picking.point_residuals import (
    PlaceUncertainty,
    PointResidual,
    measure_residuals,
    predict_places,
)


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
    """Assess control points while they are picked; a bad layout gives feedback, not an error.

    Warnings are caught (`warnings.catch_warnings`): call it from one thread at a time.

    Args:
        points: control points picked on one image, each with pixel and place.
        size: (height, width) of that image, pixels.
        world: the plane of the georeference; None: see `estimate_georeference`.

    Returns:
        The feedback.
    """
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
