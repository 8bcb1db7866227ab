"""The stages in order: video -> registration -> background -> georeference -> AIM."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from geoaim.aim import AIM
from geoaim.errors import BackgroundError, GeoaimWarning, RegistrationError
from geoaim.geometry import transform_points
from geoaim.mapping.background.estimate import Background, average_frames, remove_traffic
from geoaim.mapping.background.traffic_removal import FEWEST
from geoaim.mapping.georeference.control_points import read_control_points
from geoaim.mapping.georeference.estimate import Georeference, distort_points
from geoaim.mapping.georeference.from_video import find_place, points_on_reference, reference_time
from geoaim.mapping.registration.register import (
    Registration,
    choose_reference,
    collect,
    tally,
)
from geoaim.mapping.report import report_background, report_georeference, report_registration
from geoaim.mapping.sampling import Count, RegisteredFrames
from geoaim.mapping.video.detections import Boxes, read_boxes
from geoaim.mapping.video.video import open_video
from geoaim.progress import Progress, no_progress

ENOUGH = 50  # frames for a pixel of "all", beyond which stripes share the frames: twice as fast
CONVERGED = 3.0  # grey levels by which the latter half of the frames may still move the ground


def build_aim(
    video: Any,
    gcps: Any = None,
    *,
    boxes: str | Path | Boxes | None = None,
    frames: Count = "auto",
    crs: str | None = None,
    progress: Progress = no_progress,
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
            boxes are given (a long video's frames add a stripe each, 50 or more to a pixel).
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
    reference = choose_reference(video, boxes=vehicles, time=reference_time(points, gcps))
    if points is not None:
        points = points_on_reference(points, video, reference, vehicles)
    place = gcps if isinstance(gcps, Georeference) else find_place(points, video, reference, crs)
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


def _background(registered: RegisteredFrames, boxes: Boxes | None, frames: Count) -> Background:
    """The mean outside the boxes, the plain mean of all, or the mean of what is not traffic."""
    size = registered.reference.height, registered.reference.width
    tolerance = CONVERGED if frames == "auto" else 0.0
    if boxes or frames == "all":
        total = registered.video.frame_count or 0
        bands = min(max(total // ENOUGH, 1), 12) if frames == "all" else 1
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
