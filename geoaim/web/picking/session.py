"""A session of picking control points: its points, undo and redo, and saving."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.position import read_position_covariance
from geoaim.base.errors import warn
from geoaim.base.files import lock_folder
from geoaim.base.geometry import transform_points
from geoaim.base.world import LONLAT, world_from_crs
from geoaim.imagery.mosaic import read_imagery
from geoaim.mapping.georeference.control_points import ControlPoints, read_control_points
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.point_export import clean_text, write_control_points
from geoaim.mapping.georeference.point_files import read_point_file
from geoaim.mapping.georeference.reference_frame import FrameName
from geoaim.mapping.video.video import open_video, read_frame
from geoaim.web.picking.candidates import PairCandidate


@dataclass(frozen=True, eq=False)
class PickingTask:
    """What control points are picked on."""

    frame: UInt8[Array, "H W 3"]
    frame_name: FrameName = None  # the frame of a video; None: its first one, or a single picture
    # imagery on which the same places are picked; None: coordinates are typed
    imagery: AIM | None = None
    crs: str | None = LONLAT  # CRS of the coordinates; None for a local metric plane
    path: Path | None = None  # the .csv that is written after each change
    # rough georeference of the frame, as by telemetry, in the imagery's world
    rough: Georeference | None = None
    stated_accuracy: float = 0.0  # one sigma of the places, metres, as stated

    @property
    def accuracy(self) -> float:
        """One sigma of the places, metres: at least a pixel of imagery they are picked on."""
        pixel = 0.0 if self.imagery is None else self.imagery.resolution
        return max(self.stated_accuracy, pixel)

    @property
    def shared_covariance(self) -> Float[Array, "2 2"] | None:
        """Covariance of the imagery's own place, square metres, which all points share."""
        return None if self.imagery is None else read_position_covariance(self.imagery.report)


def read_task(
    video: str | Path,
    path: str | os.PathLike[str],
    *,
    imagery: AIM | str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None = None,
    time: float = 0.0,
    crs: str | None = LONLAT,
    imagery_crs: str | None = None,
) -> PickingTask:
    """Read the frame and the imagery on which control points are picked.

    Args:
        video: a video, images or one image.
        path: the .csv of the points; if it exists, picking continues with its points.
        imagery: an AIM, or what `read_imagery` reads; None: coordinates are typed.
        time: time of the frame, s.
        crs: CRS of the coordinates; None for a local metric plane.
        imagery_crs: CRS of imagery that states none, such as an image with a world file.

    Returns:
        The task.

    Raises:
        GeoaimError: something cannot be read.
    """
    frame = read_frame(open_video(video), time)
    if imagery is not None and not isinstance(imagery, AIM):
        imagery = read_imagery(imagery, crs=imagery_crs)
    return PickingTask(
        frame=frame.image,
        frame_name=frame.name or frame.index or None,
        imagery=imagery,
        crs=crs,
        path=Path(path),
    )


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
    saved: bytes = b""  # the content of the task's file, as last read or written


def open_session(task: PickingTask) -> PickingSession:
    """Start a session; where the task's file exists, with its points and in its CRS."""
    if task.path is None or not task.path.exists():
        if task.path is not None and task.path.suffix != ".csv":
            raise ValueError(f"{task.path}: points are saved as .csv; other formats are exported")
        return PickingSession(task)
    content = task.path.read_bytes()
    if task.path.suffix == ".csv" and not read_point_file(task.path):
        return PickingSession(task, saved=content)
    saved = read_control_points(task.path, keep_incomplete=True)
    task = replace(task, crs=saved.crs, stated_accuracy=saved.accuracy)
    session = PickingSession(task, _list_points(saved), saved=content)
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


def state_accuracy(session: PickingSession, accuracy: float) -> PickingSession:
    """State one sigma of all places, metres, and save."""
    return save_points(replace(session, task=replace(session.task, stated_accuracy=accuracy)))


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
    """Write all points to the task's file, unless something else has changed it."""
    path = session.task.path
    if path is None:
        return session
    with lock_folder(path.parent, wait=True):
        if _read_bytes(path) != session.saved:
            raise ValueError(
                f"{path} was changed by another page or program meanwhile; start picking again to "
                "go on from that file"
            )
        write_control_points(collect_points(session), path)
        return replace(session, saved=_read_bytes(path))


def _read_bytes(path: Path) -> bytes:
    return path.read_bytes() if path.exists() else b""


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
