"""A session of picking control points: its points, undo and redo, and saving."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import warn
from geoaim.base.files import lock_folder
from geoaim.base.geometry import transform_points
from geoaim.base.world import world_from_crs
from geoaim.mapping.georeference.control_points import ControlPoints, read_control_points
from geoaim.mapping.georeference.point_export import clean_text, write_control_points
from geoaim.mapping.georeference.point_files import read_point_file
from geoaim.mapping.georeference.reference_frame import FrameName
from geoaim.web.picking.candidates import PairCandidate
from geoaim.web.picking.task import PickingTask

Vector = tuple[float, float]


@dataclass(frozen=True)
class PickedPoint:
    """A control point of which the pixel or the place may be missing yet."""

    id: int  # stays the same when the point is moved or renamed
    name: str
    pixel: Vector | None = None  # u, v
    place: Vector | None = None  # x, y (or longitude, latitude) in the task's CRS
    frame: FrameName = None  # the frame that the pixel was picked on


@dataclass(frozen=True, eq=False)
class PickingSession:
    """The points picked so far, and the changes that can be undone and redone."""

    task: PickingTask
    points: tuple[PickedPoint, ...] = ()
    past: tuple[tuple[PickedPoint, ...], ...] = ()  # earlier points, the last ones at the end
    future: tuple[tuple[PickedPoint, ...], ...] = ()  # points that were undone, the next at the end
    candidates: tuple[PairCandidate, ...] = ()  # proposed, and not accepted yet
    saved: tuple[PickedPoint, ...] = ()  # the points in the task's file, as last read or written


def open_session(task: PickingTask) -> PickingSession:
    """Start a session; where the task's file exists, with its points and in its CRS."""
    if task.path is None or not task.path.exists():
        if task.path is not None and task.path.suffix != ".csv":
            raise ValueError(f"{task.path}: points are saved as .csv; other formats are exported")
        return PickingSession(task)
    if task.path.suffix == ".csv" and not read_point_file(task.path):
        return PickingSession(task)
    saved = read_control_points(task.path, keep_incomplete=True)
    points = _list_points(saved)
    session = PickingSession(replace(task, crs=saved.crs), points, saved=points)
    _warn_of_other_place(session)
    return session


def _warn_of_other_place(session: PickingSession) -> None:
    """Warn where the imagery shows none of the places that were saved."""
    places = collect_points(session).coordinates
    places = places[np.isfinite(places).all(axis=1)]
    imagery = session.task.imagery
    if imagery is None or not len(places):
        return
    metres = world_from_crs(imagery.world, places, session.task.crs)
    u, v = transform_points(np.linalg.inv(imagery.world_from_image), metres).T
    height, width = imagery.coverage.shape
    if not ((u >= 0) & (u <= width) & (v >= 0) & (v <= height)).any():
        warn(
            f"the imagery shows none of the {len(places)} points in {session.task.path}. Give"
            " imagery of that place, or another file for new points"
        )


def change_points(session: PickingSession, points: Sequence[PickedPoint]) -> PickingSession:
    """Replace the points, remember the old ones for undo, and save."""
    past = (*session.past, session.points)
    return save_points(replace(session, points=tuple(points), past=past, future=()))


def undo(session: PickingSession) -> PickingSession:
    """Undo the last change, where there is one, and save."""
    if not session.past:
        return session
    *past, points = session.past
    future = (*session.future, session.points)
    return save_points(replace(session, points=points, past=tuple(past), future=future))


def redo(session: PickingSession) -> PickingSession:
    """Redo the change that was undone last, where there is one, and save."""
    if not session.future:
        return session
    *future, points = session.future
    past = (*session.past, session.points)
    return save_points(replace(session, points=points, past=past, future=tuple(future)))


def save_points(session: PickingSession) -> PickingSession:
    """Write all points to the task's file, after what others changed there is merged by name."""
    path = session.task.path
    if path is None:
        return session
    with lock_folder(path.parent, wait=True):
        if path.exists() and (path.suffix != ".csv" or read_point_file(path)):
            other = read_control_points(path, keep_incomplete=True)
            if other.crs != session.task.crs and session.saved:
                raise ValueError(
                    f"{path} was saved in {other.crs} meanwhile, and these points are in "
                    f"{session.task.crs}; start picking again to go on from that file"
                )
            session = _merge(session, _list_points(other))
        write_control_points(collect_points(session), path)
    return replace(session, saved=session.points)


def _merge(session: PickingSession, other: tuple[PickedPoint, ...]) -> PickingSession:
    """Merge what differs in the file from what was saved last, into all states of the session."""
    before, now, here = _index(session.saved), _index(other), _index(session.points)
    if before == now:
        return session
    states = (session.points, *session.past, *session.future)
    number = 1 + max((point.id for points in states for point in points), default=0)
    new = [p for name, p in now.items() if name not in before and p != here.get(name)]
    added = tuple(replace(point, id=number + i) for i, point in enumerate(new))
    names: dict[int, str] = {}  # of points of this session whose names were taken meanwhile
    for point in session.points:
        if point.name in {p.name for p in new}:
            called = (*session.points, *added, *(PickedPoint(0, name) for name in names.values()))
            names[point.id] = choose_name(called)
            warn(f"another {point.name!r} was saved meanwhile; this one is {names[point.id]!r} now")
        elif point.name in before and before[point.name] not in (
            here[point.name],
            now.get(point.name),
        ):
            warn(f"{point.name!r} was changed elsewhere as well; it stays as it is here")

    def merge(points: tuple[PickedPoint, ...]) -> tuple[PickedPoint, ...]:
        renamed = [replace(point, name=names.get(point.id, point.name)) for point in points]
        is_changed = {p.name: before.get(p.name) != replace(p, id=0) for p in renamed}
        kept = [p for p in renamed if is_changed[p.name] or p.name in now]
        merged = [p if is_changed[p.name] else replace(now[p.name], id=p.id) for p in kept]
        return (*merged, *added)

    return replace(
        session,
        points=merge(session.points),
        past=tuple(map(merge, session.past)),
        future=tuple(map(merge, session.future)),
    )


def _index(points: Sequence[PickedPoint]) -> dict[str, PickedPoint]:
    """Map names to points without their numbers, which are of a session."""
    return {point.name: replace(point, id=0) for point in points}


def _list_points(saved: ControlPoints) -> tuple[PickedPoint, ...]:
    rows = zip(saved.names, saved.pixels, saved.coordinates, saved.frames, strict=True)
    return tuple(
        PickedPoint(i, name, _read_pair(pixel), _read_pair(place), frame)
        for i, (name, pixel, place, frame) in enumerate(rows, 1)
    )


def collect_points(session: PickingSession) -> ControlPoints:
    """Collect all points of a session; NaN where a pixel or a place is missing."""
    nothing = (math.nan, math.nan)
    points = session.points
    return ControlPoints(
        pixels=np.array([p.pixel or nothing for p in points]).reshape(-1, 2),
        coordinates=np.array([p.place or nothing for p in points]).reshape(-1, 2),
        crs=session.task.crs,
        names=tuple(point.name for point in points),
        frames=tuple(point.frame for point in points),
        accuracy=session.task.accuracy,
        shared_covariance=session.task.shared_covariance,
    )


def choose_name(points: Sequence[PickedPoint], name: str = "") -> str:
    """Choose a name of one line that no point has: the given one, or "point 1", "point 2", ..."""
    names = {point.name for point in points}
    if (name := clean_text(name)) in names:
        raise ValueError(f"another point is called {name!r}; choose another name")
    free = (f"point {number}" for number in range(1, len(names) + 2))
    return name or next(other for other in free if other not in names)


def _read_pair(values: Float[Array, "2"]) -> Vector | None:
    first, second = values.tolist()
    return None if math.isnan(first) else (first, second)
