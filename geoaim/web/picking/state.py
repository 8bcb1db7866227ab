"""The state of a picking session as plain JSON, for its page."""

from typing import Any

import numpy as np

from geoaim.base.errors import GeoreferenceError
from geoaim.base.geometry import transform_points
from geoaim.base.world import LONLAT, transform_crs, world_from_crs
from geoaim.mapping.georeference.control_points import ControlPoints, select_points
from geoaim.mapping.georeference.transform_models import Points
from geoaim.web.picking.candidates import measure_disagreement
from geoaim.web.picking.feedback import PointFeedback, assess_points, describe_feedback
from geoaim.web.picking.session import PickingSession, PickingTask, collect_points

MIN_AGREEING_PAIRS = 5  # two more than an affine map through them needs
MAX_DISAGREEMENT = 3.0  # distance of a point from the proposed pairs, in standard deviations


def select_complete(session: PickingSession) -> ControlPoints:
    """Select the points with pixel and place that were picked on the session's frame."""
    task, points = session.task, collect_points(session)
    complete = np.isfinite(np.hstack([points.pixels, points.coordinates])).all(axis=1)
    here = np.array([(frame or 0) == (task.frame_name or 0) for frame in points.frames], bool)
    return select_points(points, np.flatnonzero(complete & here).tolist())


def assess_session(session: PickingSession) -> PointFeedback:
    """Assess the complete points of a session that were picked on its frame."""
    task = session.task
    world = None if task.imagery is None else task.imagery.world
    return assess_points(select_complete(session), task.frame.shape[:2], world)


def describe_session(session: PickingSession) -> dict[str, Any]:
    """Describe a session: its points, what they give, and what can be done."""
    task, feedback = session.task, assess_session(session)
    points = collect_points(session)
    columns = {
        ("u", "v"): points.pixels,
        ("x", "y"): points.coordinates,
        ("lon", "lat"): _convert(task, points.coordinates, "lonlat"),
        ("image_u", "image_v"): _convert(task, points.coordinates, "imagery"),
    }
    rows: list[dict[str, Any]] = [
        {"id": point.id, "name": point.name, "frame": point.frame} for point in session.points
    ]
    for keys, values in columns.items():
        for row, pair in zip(rows, values.tolist(), strict=True):
            row |= {k: v if np.isfinite(v) else None for k, v in zip(keys, pair, strict=True)}
    return {
        "points": rows,
        "feedback": describe_feedback(feedback),
        "imagery_from_frame": _compose_overlay(task, feedback),
        "candidates": _describe_candidates(session),
        "disagreeing": _find_disagreeing(session),
        "crs": task.crs,
        "accuracy": task.accuracy,
        "can_undo": bool(session.past),
        "can_redo": bool(session.future),
        "saved": None if task.path is None else task.path.name,
    }


def _convert(task: PickingTask, places: Points, target: str) -> Points:
    """Places in degrees or in pixels of the imagery; NaN where they cannot be expressed."""
    try:
        if target == "lonlat" and task.crs is not None:
            return transform_crs(task.crs, LONLAT, places)
        if target == "imagery" and task.imagery is not None:
            metres = world_from_crs(task.imagery.world, places, task.crs)
            return transform_points(np.linalg.inv(task.imagery.world_from_image), metres)
    except GeoreferenceError:
        pass  # the feedback says what is wrong with them
    return np.full(places.shape, np.nan)


def _compose_overlay(task: PickingTask, feedback: PointFeedback) -> list[list[float]] | None:
    georeference = feedback.georeference or task.rough
    if task.imagery is None or georeference is None:
        return None
    imagery_from_world = np.linalg.inv(task.imagery.world_from_image)
    return (imagery_from_world @ georeference.world_from_image).tolist()


def _describe_candidates(session: PickingSession) -> list[dict[str, float]]:
    if session.task.imagery is None or not session.candidates:
        return []
    places = np.array([candidate.place for candidate in session.candidates])
    pixels = transform_points(np.linalg.inv(session.task.imagery.world_from_image), places)
    return [
        {"u": c.pixel[0], "v": c.pixel[1], "image_u": u, "image_v": v, "sigma_m": c.sigma_m}
        for c, (u, v) in zip(session.candidates, pixels.tolist(), strict=True)
    ]


def _find_disagreeing(session: PickingSession) -> list[dict[str, Any]]:
    """Name and distance in metres of points that lie elsewhere than the proposed pairs say."""
    task, pairs, points = session.task, session.candidates, select_complete(session)
    if task.imagery is None or len(pairs) < MIN_AGREEING_PAIRS:
        return []
    pixels = _convert(task, points.coordinates, "imagery")
    places = transform_points(task.imagery.world_from_image, pixels)
    distances = measure_disagreement(pairs, points.pixels, places)
    largest = MAX_DISAGREEMENT * float(np.hypot(pairs[0].sigma_m, task.accuracy))
    return [
        {"name": name, "distance_m": distance}
        for name, distance in zip(points.names, distances.tolist(), strict=True)
        if distance > largest
    ]
