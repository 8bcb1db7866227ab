"""Actions of the picking page, as plain JSON: `handle` changes a session and replies.

An action is {"action": NAME, ...}:

- "state" changes nothing;
- "add" with what is known: u and v (pixel), x and y or lon and lat (place; with "side": "imagery" u
  and v are a pixel of the imagery), and a name; "move" is the same with the id of a point;
- "rename" (id, name), "delete" (id), "undo", "redo";
- "accuracy" (m) states how far off the places may be, one sigma;
- "snap" (u, v, side "frame" or "imagery", radius) tells the corner beside a click in "snapped";
- "accept" (candidate: its index) makes a proposed pair a point; `PairSearch` proposes them;
- "export" (format "csv", "txt" or "points") gives the "text" of a file to save.

Every reply has the whole state (`describe_session`) and "notes", warnings of the action; one to a
bad action has only "error", in one line. Warnings are caught: handle one action at a time.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypedDict

import numpy as np

from geoaim.aim.aim import AIM
from geoaim.base.errors import GeoaimError, GeoaimWarning
from geoaim.base.geometry import transform_points
from geoaim.base.world import LONLAT, crs_from_world, transform_crs
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.point_checks import check_coordinates
from geoaim.mapping.georeference.point_export import format_points
from geoaim.mapping.georeference.point_files import MAX_NUMBER
from geoaim.web.picking.session import (
    PickedPoint,
    PickingSession,
    PickingTask,
    Vector,
    change_points,
    choose_name,
    collect_points,
    redo,
    state_accuracy,
    undo,
)
from geoaim.web.picking.snap import SNAP_RADIUS_PX, snap_to_corner
from geoaim.web.picking.state import describe_session

Action = Mapping[str, Any]
Outcome = tuple[PickingSession, dict[str, Any]]


class Position(TypedDict, total=False):
    """A pixel of the frame, a place in the task's CRS, or both."""

    pixel: Vector
    place: Vector


def read_position(task: PickingTask, action: Mapping[str, Any]) -> Position:
    """Read the pixel and the place that an action states; either may be missing."""
    position: Position = {}
    if "u" in action and action.get("side") == "imagery":
        imagery = require_imagery(task)
        pixel = _check_inside(read_pair(action, "u", "v"), imagery.image.shape[:2])
        metres = transform_points(imagery.world_from_image, np.array([pixel]))
        position["place"] = _first(crs_from_world(imagery.world, metres, task.crs))
    elif "u" in action:
        position["pixel"] = _check_inside(read_pair(action, "u", "v"), task.frame.shape[:2])
    if "x" in action:
        position["place"] = read_pair(action, "x", "y")
    elif "lon" in action:
        if task.crs is None:
            raise ValueError("these control points lie in a local plane: give x and y, in metres")
        lonlat = np.array([read_pair(action, "lon", "lat")])
        position["place"] = _first(transform_crs(LONLAT, task.crs, lonlat))
    if not position:
        raise ValueError("no position: u and v, x and y, or lon and lat are needed")
    if "place" in position:
        place = np.array([position["place"]])
        check_coordinates(ControlPoints(np.zeros((1, 2)), place, task.crs, ("not saved",), (None,)))
    return position


def read_pair(action: Mapping[str, Any], first: str, second: str) -> Vector:
    """Read two finite numbers of an action."""
    for key in (first, second):
        number: Any = action.get(key)
        if type(number) not in (int, float) or not abs(number) < MAX_NUMBER:
            raise ValueError(f"{key} is {str(number)[:40]!r}; a finite number is needed")
    return float(action[first]), float(action[second])


def require_imagery(task: PickingTask) -> AIM:
    """Return the imagery of a task."""
    if task.imagery is None:
        raise ValueError("no imagery was given: type coordinates, or name imagery at the start")
    return task.imagery


def _check_inside(pixel: Vector, size: tuple[int, ...]) -> Vector:
    height, width = size
    if not (0 <= pixel[0] <= width and 0 <= pixel[1] <= height):
        raise ValueError(f"({pixel[0]:g}, {pixel[1]:g}) lies outside {width} x {height} pixels")
    return pixel


def _first(points: np.ndarray) -> Vector:
    x, y = points[0].tolist()
    return x, y


def handle(session: PickingSession, action: Any) -> Outcome:
    """Carry out an action of a page; returns the session after it and the reply."""
    try:
        if not isinstance(action, Mapping) or str(action.get("action")) not in ACTIONS:
            raise ValueError(
                f"{str(action)[:80]!r}: one of the actions {', '.join(ACTIONS)} is needed"
            )
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", GeoaimWarning)
            session, extra = ACTIONS[str(action["action"])](session, action)
    except (GeoaimError, ValueError, OSError) as error:
        return session, {"error": " ".join(str(error).split())}
    notes = [str(warning.message) for warning in caught]
    return session, {**describe_session(session), "notes": notes, **extra}


def _add(session: PickingSession, action: Action) -> Outcome:
    values = read_position(session.task, action)
    states = (session.points, *session.past, *session.future)
    number = 1 + max((point.id for points in states for point in points), default=0)
    name = choose_name(session.points, str(action.get("name", "")))
    point = PickedPoint(number, name, frame=session.task.frame_name)
    return change_points(session, [*session.points, replace(point, **values)]), {"added": number}


def _move(session: PickingSession, action: Action) -> Outcome:
    values = read_position(session.task, action)
    moved = _find_point(session, action)
    frame = session.task.frame_name if "pixel" in values else moved.frame
    return _replace_point(session, moved, replace(moved, frame=frame, **values)), {}


def _rename(session: PickingSession, action: Action) -> Outcome:
    point = _find_point(session, action)
    others = [other for other in session.points if other is not point]
    name = choose_name(others, str(action.get("name", "")))
    return _replace_point(session, point, replace(point, name=name)), {}


def _delete(session: PickingSession, action: Action) -> Outcome:
    point = _find_point(session, action)
    return change_points(session, [other for other in session.points if other is not point]), {}


def _state_accuracy(session: PickingSession, action: Action) -> Outcome:
    metres: Any = action.get("m")
    if type(metres) not in (int, float) or not 0 <= metres < MAX_NUMBER:
        raise ValueError(f"accuracy {str(metres)[:40]!r}: metres, 0 or more, are needed")
    return state_accuracy(session, float(metres)), {}


def _snap(session: PickingSession, action: Action) -> Outcome:
    image = session.task.frame
    if action.get("side") == "imagery":
        image = require_imagery(session.task).image
    radius = action.get("radius", SNAP_RADIUS_PX)
    if type(radius) not in (int, float) or not radius > 0:
        raise ValueError(f"the radius of a snap is a number of pixels above 0, found {radius!r}")
    corner = snap_to_corner(image, read_pair(action, "u", "v"), min(radius, SNAP_RADIUS_PX))
    return session, {"snapped": None if corner is None else dict(zip("uv", corner, strict=True))}


def _accept(session: PickingSession, action: Action) -> Outcome:
    index, candidates = action.get("candidate"), session.candidates
    if type(index) is not int or not 0 <= index < len(candidates):
        raise ValueError(f"there is no candidate {index!r}; {len(candidates)} are left")
    world = require_imagery(session.task).world
    x, y = crs_from_world(world, np.array([candidates[index].place]), session.task.crs)[0].tolist()
    left = candidates[:index] + candidates[index + 1 :]
    u, v = candidates[index].pixel
    pair = {"u": u, "v": v, "x": x, "y": y}
    session, extra = _add(session, {**action, **pair})
    return replace(session, candidates=left), extra


def _export(session: PickingSession, action: Action) -> Outcome:
    if action.get("format") not in ("csv", "txt", "points"):
        raise ValueError(f"format {action.get('format')!r}: csv, txt or points is needed")
    return session, {"text": format_points(collect_points(session), f".{action['format']}")}


def _find_point(session: PickingSession, action: Action) -> PickedPoint:
    for point in session.points:
        if point.id == action.get("id"):
            return point
    raise ValueError(f"there is no point with id {str(action.get('id'))[:40]!r}")


def _replace_point(session: PickingSession, old: PickedPoint, new: PickedPoint) -> PickingSession:
    return change_points(session, [new if point is old else point for point in session.points])


ACTIONS: Mapping[str, Callable[[PickingSession, Action], Outcome]] = {
    "state": lambda session, action: (session, {}),
    "add": _add,
    "move": _move,
    "rename": _rename,
    "delete": _delete,
    "undo": lambda session, action: (undo(session), {}),
    "redo": lambda session, action: (redo(session), {}),
    "accuracy": _state_accuracy,
    "snap": _snap,
    "accept": _accept,
    "export": _export,
}
