"""The stages in order: video -> registration -> background -> georeference -> AIM."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import BackgroundError, GeoaimWarning, GeoreferenceError, RegistrationError
from geoaim.geometry import transform_points
from geoaim.mapping.approximate import approximate_georeference
from geoaim.mapping.background import Background, average_frames, remove_traffic
from geoaim.mapping.boxes import Boxes, read_boxes
from geoaim.mapping.control_points import ControlPoints, merge_observations, read_control_points
from geoaim.mapping.georeference import Georeference, distort_points, georeference
from geoaim.mapping.ghosts import FEWEST
from geoaim.mapping.keyframes import Placement
from geoaim.mapping.registration import (
    Progress,
    Reference,
    Registration,
    choose_reference,
    collect,
    place_frames,
    tally,
)
from geoaim.mapping.report import report_background, report_georeference, report_registration
from geoaim.mapping.video import Frame, Video, open_video
from geoaim.world import choose_world, transform_crs

Count = int | Literal["auto", "all"]
FIRST_BATCH = 16  # frames of "auto"; doubled until the background has converged
MOST = 64  # frames of "auto"
STEEP = np.radians(10.0)  # of a camera's axis from straight down, placed by telemetry
ENOUGH = 128  # frames for a pixel of "all", beyond which stripes share the frames: half the time
CONVERGED = 3.0  # grey levels by which the latter half of the frames may still move the ground


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
        gcps: what `read_control_points` takes, at least four points, better six or more; picked
            on the first frame unless they say on which. A Georeference of the first frame serves
            too. None takes an approximate place from the telemetry beside the video.
        boxes: vehicles to leave out: a folder of YOLO text files, or a function of a frame.
        frames: how many to use. "auto" samples the video, up to 64 frames, and stops when the
            background has converged; "all" is the mean of every frame, traffic and all where no
            boxes are given (a long video's frames add a stripe each, 128 or more to a pixel).
        crs: of the world, projected and in metres, when control points place the map; None keeps
            the points' own, or their UTM zone.
        progress: called with stage, done and total.

    Raises:
        VideoError: no frame could be read.
        RegistrationError: too few frames agree with the reference.
        BackgroundError: the registered frames do not give a background.
        GeoreferenceError: the control points or the telemetry do not fix a place.
    """
    _refuse_call(gcps, crs, frames)
    video = open_video(video)
    vehicles = read_boxes(boxes) if isinstance(boxes, str | Path) else boxes
    points = None if gcps is None or isinstance(gcps, Georeference) else read_control_points(gcps)
    reference = choose_reference(video, boxes=vehicles, time=_reference_time(points, gcps))
    if points is not None:
        points = _points_on_reference(points, video, reference, vehicles)
    place = gcps if isinstance(gcps, Georeference) else _find_place(points, video, reference, crs)
    if (place.height, place.width) != (video.height, video.width):
        raise ValueError(
            f"the georeference is of an image of {place.width} x {place.height} px, the frames "
            f"have {video.width} x {video.height}; make it for their size"
        )
    registered = RegisteredFrames(video, reference, vehicles, frames, progress)
    background = _background(registered, vehicles, frames)
    registration = collect(registered.rows, reference)
    _warn_of_less(registration, background)
    background = _straighten(background, place.radial)
    return AIM(
        image=background.image,
        world_from_image=place.world_from_image,
        world=place.world,
        coverage=background.coverage,
        contested=background.contested,
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
        if isinstance(self.count, int) or total is None:
            yield self.video.sampled(MOST if self.count == "auto" else int(self.count))
            return
        read: set[float] = set()
        for times, spacing in _batch_times(self.video.duration):
            # a keyframe within half a step is taken in place of the wanted frame
            yield _unread(self.video.read_at(times, spacing / 2), read)

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
    """The mean outside the boxes, the plain mean of all, or the mean of what is not traffic."""
    size = registered.reference.height, registered.reference.width
    tolerance = CONVERGED if frames == "auto" else 0.0
    if boxes or frames == "all":
        total = registered.video.frame_count or 0
        bands = min(max(total // ENOUGH, 1), 6) if frames == "all" else 1
        return average_frames(registered, size=size, boxes=boxes, tolerance=tolerance, bands=bands)
    try:
        return remove_traffic(registered, size=size, tolerance=tolerance)
    except BackgroundError as error:
        valid = sum(placement.valid for _, _, placement in registered.rows)
        raise RegistrationError(
            f"{valid} of {len(registered.rows)} frames could be laid on the reference at "
            f"{registered.reference.time:.1f} s"
            f"{_reasons(registered)}; at least {FEWEST} are needed to tell traffic from ground. "
            "Use more frames, or boxes, or frames='all' for the mean as it is"
        ) from error


def _reasons(registered: RegisteredFrames) -> str:
    counts = tally(placement.reason for _, _, placement in registered.rows)
    return f" ({', '.join(f'{kind}: {count}' for kind, count in counts.items())})" if counts else ""


def _refuse_call(gcps: Any, crs: str | None, frames: Count) -> None:
    if frames not in ("auto", "all") and not (isinstance(frames, int) and frames >= 1):
        raise ValueError(f"frames is {frames!r}; 'auto', 'all' or a number of frames is needed")
    if crs is not None and (gcps is None or isinstance(gcps, Georeference)):
        raise ValueError(f"crs is {crs}, but there are no control points to bring into it")


def _warn_of_less(registration: Registration, background: Background) -> None:
    """Say so when much of the video could not be used, or the map is smaller than the flight."""
    reference, valid = registration.reference, registration.valid
    if valid.mean() < 0.5:
        _warn(
            f"only {valid.sum()} of {len(valid)} frames could be laid on the reference at "
            f"{reference.time:.1f} s ({', '.join(tally(registration.reason))})"
        )
    if background.frames_used < 0.5 * valid.sum():
        _warn(
            f"boxes are known of {background.frames_used} of {valid.sum()} frames only, and the "
            "others are not used: give a file for every frame, empty where there is no vehicle"
        )
    if background.contested.mean() > 0.1:
        _warn(
            f"the ground is in doubt in {background.contested.mean():.0%} of the pixels: give "
            "boxes of the vehicles, or a longer video"
        )
    middle = np.array([[reference.width / 2, reference.height / 2]])
    centres = transform_points(registration.reference_from_frame[valid], middle)[:, 0]
    away = ~((centres > 0) & (centres < [reference.width, reference.height])).all(axis=1)
    if np.count_nonzero(away):
        _warn(
            f"the view leaves the reference at {reference.time:.1f} s in {np.count_nonzero(away)} "
            f"of {valid.sum()} frames, and the map ends there: build one map for each place"
        )


def _warn(message: str) -> None:
    warnings.warn(message, GeoaimWarning, stacklevel=4)


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
        if picked and video.frame_count is not None and picked >= video.frame_count:
            raise GeoreferenceError(
                f"control points name frame {picked}, but {video.source} has {video.frame_count} "
                "frames, counted from 0"
            )
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
    if abs(state.pitch[now] + np.pi / 2) > STEEP:
        raise GeoreferenceError(
            f"{video.source}: by its telemetry the camera looks "
            f"{-np.degrees(state.pitch[now]):.0f} degrees down; without control points only "
            "one that looks straight down (90) can be placed: give four or more"
        )
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


def _straighten(background: Background, radial: float) -> Background:
    """Take the lens out of an image, for a georeference that found its radial term."""
    if radial == 0.0:
        return background
    height, width = background.coverage.shape
    x, y = (np.empty((height, width), np.float32) for _ in range(2))
    columns = np.arange(width) + 0.5
    for row in range(height):
        wanted = np.column_stack([columns, np.full(width, row + 0.5)])
        x[row], y[row] = distort_points(wanted, radial, height, width).T - 0.5
    contested = cv2.remap(background.contested.view(np.uint8), x, y, cv2.INTER_NEAREST)
    return replace(
        background,
        image=np.asarray(cv2.remap(background.image, x, y, cv2.INTER_LINEAR), np.uint8),
        coverage=np.asarray(cv2.remap(background.coverage, x, y, cv2.INTER_NEAREST), np.uint16),
        contested=np.asarray(contested).astype(bool),
    )
