"""The stages in order: video -> registration -> background -> georeference -> AIM."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import GeoreferenceError
from geoaim.geometry import transform_points
from geoaim.mapping.approximate import approximate_georeference
from geoaim.mapping.background import Background, average_frames, remove_traffic
from geoaim.mapping.boxes import Boxes, read_boxes
from geoaim.mapping.control_points import ControlPoints, merge_observations, read_control_points
from geoaim.mapping.georeference import Georeference, distort_points, georeference
from geoaim.mapping.keyframes import Placement
from geoaim.mapping.registration import (
    Progress,
    Reference,
    choose_reference,
    collect,
    place_frames,
)
from geoaim.mapping.report import report_background, report_georeference, report_registration
from geoaim.mapping.video import Frame, Video, open_video
from geoaim.world import choose_world, transform_crs

Count = int | Literal["auto", "all"]
FIRST_BATCH = 16  # frames of "auto"; doubled until the background has converged
MOST = 64  # frames of "auto"
ENOUGH = 128  # frames for a pixel of "all", beyond which stripes share the frames: half the time
CONVERGED = 2.0  # grey levels by which the latter half of the frames may still move the ground


def build_aim(
    video: Any,
    gcps: Any = None,
    *,
    boxes: str | Path | Boxes | None = None,
    frames: Count = "auto",
    crs: str | None = None,
    progress: Progress | None = None,
) -> AIM:
    """Build an aerial image-based map from a hovering camera's video and control points.

    Args:
        video: what `open_video` takes: a video file, a folder or glob of images, arrays.
        gcps: what `read_control_points` takes, at least three points, better six or more; picked
            on the first frame unless they say on which. A Georeference of the first frame serves
            too. None takes an approximate place from the telemetry beside the video.
        boxes: vehicles to leave out: a folder of YOLO text files, or a function of a frame.
        frames: how many to use. "auto" samples the video, up to 64 frames, and stops when the
            background has converged; "all" is the mean of every frame, traffic and all where no
            boxes are given (a long video's frames add a stripe each, 128 or more to a pixel).
        crs: of the world, projected and in metres; None keeps the points' own, or their UTM zone.
        progress: called with stage, done and total.

    Raises:
        VideoError: no frame could be read.
        RegistrationError: too few frames agree with the reference.
        BackgroundError: the registered frames do not give a background.
        GeoreferenceError: the control points or the telemetry do not fix a place.
    """
    video = open_video(video)
    vehicles = read_boxes(boxes) if isinstance(boxes, str | Path) else boxes
    points = None if gcps is None or isinstance(gcps, Georeference) else read_control_points(gcps)
    reference = choose_reference(video, boxes=vehicles, time=_reference_time(points, gcps))
    if points is not None:
        points = _points_on_reference(points, video, reference, vehicles)
    place = gcps if isinstance(gcps, Georeference) else _find_place(points, video, reference, crs)
    registered = RegisteredFrames(video, reference, vehicles, frames, progress)
    background = _background(registered, vehicles, frames)
    registration = collect(registered.rows, reference)
    return AIM(
        image=_straighten(background.image, place.radial, cv2.INTER_CUBIC),
        world_from_image=place.world_from_image,
        world=place.world,
        coverage=_straighten(background.coverage, place.radial, cv2.INTER_NEAREST),
        contested=_straighten(background.contested, place.radial, cv2.INTER_NEAREST),
        report={
            "source": video.source,
            "registration": report_registration(registration),
            "background": report_background(background, _method(vehicles, frames)),
            "georeference": report_georeference(place, points),
        },
    )


@dataclass(frozen=True, eq=False)
class RegisteredFrames:
    """Valid frames and their places; re-iterable: each frame is laid on the reference once.

    They come in batches, each spread over the whole video and as large as all before it.
    """

    video: Video
    reference: Reference
    boxes: Boxes | None
    count: Count
    progress: Progress | None
    placed: dict[float, Placement] = field(default_factory=dict)
    rows: list[tuple[int, float, Placement]] = field(default_factory=list)

    def __iter__(self) -> Iterator[tuple[Frame, Float[Array, "3 3"]]]:
        total = self._total()
        stage = "average" if self.rows else "register"
        for read, (frame, placement) in enumerate(self._placements(), 1):
            if self.progress:
                self.progress(stage, read, total)
            if placement.valid:
                yield frame, placement.matrix

    def _placements(self) -> Iterator[tuple[Frame, Placement]]:
        again = bool(self.rows)
        for batch in self._batches():
            if again:
                yield from ((f, self.placed[f.time]) for f in batch if f.time in self.placed)
                continue
            for frame, placement in place_frames(batch, self.reference, boxes=self.boxes):
                self.placed[frame.time] = placement
                self.rows.append((frame.index, frame.time, placement))
                yield frame, placement

    def _batches(self) -> Iterator[Iterator[Frame]]:
        total = self.video.frame_count
        if self.count == "all" or (total is not None and total <= FIRST_BATCH):
            yield iter(self.video)
            return
        if isinstance(self.count, int):
            yield self.video.sampled(self.count)
            return
        read: set[float] = set()
        for times, spacing in _batch_times(self.video.duration):
            yield _unread(self.video.read_at(times, spacing), read)

    def _total(self) -> float | None:
        if self.count == "all" or self.video.frame_count is None:
            return self.video.frame_count
        most = MOST if self.count == "auto" else self.count
        return min(most, self.video.frame_count)


def _batch_times(duration: float) -> Iterator[tuple[Float[Array, " n"], float]]:
    """Times of each batch, seconds, and the spacing between all that were read so far."""
    whole = duration * (1 - 1e-6)
    count = FIRST_BATCH
    yield np.linspace(0, whole, count, endpoint=False), whole / count
    while 2 * count <= MOST:
        yield (np.arange(count) + 0.5) * whole / count, whole / count / 2
        count *= 2


def _unread(frames: Iterator[Frame], read: set[float]) -> Iterator[Frame]:
    for frame in frames:
        if frame.time not in read:
            read.add(frame.time)
            yield frame


def _background(registered: RegisteredFrames, boxes: Boxes | None, frames: Count) -> Background:
    size = registered.reference.height, registered.reference.width
    tolerance = CONVERGED if frames == "auto" else 0.0
    if boxes or frames == "all":
        total = registered.video.frame_count or 0
        bands = min(max(total // ENOUGH, 1), 6) if frames == "all" else 1
        return average_frames(registered, size=size, boxes=boxes, tolerance=tolerance, bands=bands)
    return remove_traffic(registered, size=size, tolerance=tolerance)


def _method(boxes: Boxes | None, frames: Count) -> str:
    if boxes:
        return "mean masked by boxes"
    return "mean" if frames == "all" else "mean of what is not traffic"


def _reference_time(points: ControlPoints | None, gcps: Any) -> float | None:
    """The first frame where something is known of it, so that its pixels are the map's."""
    on_first = points is not None and all(frame in (None, 0) for frame in points.frames)
    return 0.0 if on_first or isinstance(gcps, Georeference) else None


def _points_on_reference(
    points: ControlPoints, video: Video, reference: Reference, boxes: Boxes | None
) -> ControlPoints:
    """Control points moved from the frames that they were picked on to the reference."""
    pixels = points.pixels.copy()
    for picked in dict.fromkeys(points.frames):
        index = _frame_index(picked, video)
        frame = next(iter(video.frames_at([index / video.rate])))
        [(_, placement)] = place_frames([frame], reference, boxes=boxes)
        mine = np.array([other == picked for other in points.frames])
        if not placement.valid:
            names = ", ".join(np.array(points.names)[mine])
            raise GeoreferenceError(
                f"{names}: picked on frame {index}, which cannot be laid on the reference at "
                f"{reference.time:.2f} s ({placement.reason}); pick them on another frame"
            )
        pixels[mine] = transform_points(placement.matrix, points.pixels[mine])
    merged = merge_observations(replace(points, pixels=pixels))
    return replace(merged, frames=(None,) * len(merged.pixels))


def _frame_index(picked: str | int | None, video: Video) -> int:
    if picked is None or isinstance(picked, int):
        return picked or 0
    if video.names is None or picked not in video.names:
        raise GeoreferenceError(
            f"control points name the frame {picked!r}, which is not among those of "
            f"{video.source}; use the file's name, or a frame's number for a video"
        )
    return video.names.index(picked)


def _find_place(
    points: ControlPoints | None, video: Video, reference: Reference, crs: str | None
) -> Georeference:
    size = {"height": reference.height, "width": reference.width}
    if points is None:
        return _place_by_telemetry(video, reference)
    world = None
    if crs is not None and points.crs is not None:
        world = choose_world(transform_crs(points.crs, "EPSG:4326", points.coordinates), crs=crs)
    return georeference(points, world=world, **size)


def _place_by_telemetry(video: Video, reference: Reference) -> Georeference:
    state = video.telemetry
    if state is None:
        raise GeoreferenceError(
            f"{video.source}: no control points were given and no telemetry lies beside it (a DJI "
            ".SRT of the same name, or GPS in the images' EXIF); give four or more control points, "
            "or a pixel size for a map that is only local"
        )
    now = int(np.argmin(np.abs(state.time - reference.time)))
    diagonal = np.hypot(reference.height, reference.width)
    # The 35 mm equivalent refers to the diagonal of that film, 43.27 mm.
    half = 43.27 / 2 * reference.width / diagonal / state.focal_length[now]
    return approximate_georeference(
        latitude=float(state.latitude[now]),
        longitude=float(state.longitude[now]),
        height_above_ground=float(state.height[now]),
        yaw=float(state.yaw[now]),
        field_of_view=float(2 * np.arctan(half)),
        size=(reference.height, reference.width),
    )


def _straighten(image: Array, radial: float, interpolation: int) -> Array:
    """Take the lens out of an image, for a georeference that found its radial term."""
    if radial == 0.0:
        return image
    height, width = image.shape[:2]
    rows, columns = np.mgrid[:height, :width] + 0.5
    source = distort_points(np.stack([columns, rows], -1).reshape(-1, 2), radial, height, width)
    x, y = (source.T.reshape(2, height, width) - 0.5).astype(np.float32)
    pixels = image.astype(np.uint8) if image.dtype.kind == "b" else image
    straight = cv2.remap(pixels, x, y, interpolation, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(straight).astype(image.dtype)
