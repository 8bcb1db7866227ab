"""The stages in order: video -> registration -> background -> georeference -> AIM."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import GeoaimWarning, RegistrationError
from geoaim.geometry import transform_points
from geoaim.mapping.background.estimate import (
    Background,
    RunningMean,
    TrafficSearch,
    add_to_mean,
    add_to_search,
    average_ground,
    finish_mean,
    start_mean,
    start_search,
)
from geoaim.mapping.background.traffic_removal import FEWEST
from geoaim.mapping.georeference.control_points import read_control_points
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.normalised_plane import distort_points
from geoaim.mapping.georeference.reference_frame import (
    choose_reference_time,
    georeference_reference_frame,
    transform_points_to_reference,
)
from geoaim.mapping.registration.register import (
    Reference,
    Registration,
    choose_reference,
    collect_registration,
    count_reasons,
    register_frames,
)
from geoaim.mapping.report import report_background, report_georeference, report_registration
from geoaim.mapping.sampling import FrameCount, Sampling, read_registered, sample_video
from geoaim.mapping.video.detections import Detections, read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import open_video
from geoaim.progress import Progress, no_progress

Accumulated = TypeVar("Accumulated", RunningMean, TrafficSearch)


def build_aim(
    video: Any,
    gcps: Any = None,
    *,
    detections: str | Path | Detections | None = None,
    frames: FrameCount = "auto",
    crs: str | None = None,
    progress: Progress = no_progress,
) -> AIM:
    """Build an aerial image-based map from a hovering camera's video and control points.

    Args:
        video: what `open_video` takes: a video file, a folder or glob of images, arrays.
        gcps: what `read_control_points` takes, at least four points, better six or more; picked
            on the first frame unless they say on which. A Georeference of the first frame serves
            too. None takes an approximate place from the telemetry beside the video.
        detections: vehicles to leave out: a folder of YOLO text files, or a function of a frame.
        frames: how many to use. "auto" samples the video, up to 64 frames, and stops when the
            background has converged; "all" is the mean of every frame, traffic and all where no
            detections are given (a long video's frames add a stripe each, 50 or more to a pixel).
        crs: of the world, projected and in metres, when control points place the map; None keeps
            the points' own, or their UTM zone.
        progress: called with stage, done and total.

    Raises:
        VideoError: no frame could be read.
        RegistrationError: too few frames agree with the reference.
        BackgroundError: the registered frames do not give a background.
        GeoreferenceError: the control points or the telemetry do not fix a place.
    """
    if crs is not None and (gcps is None or isinstance(gcps, Georeference)):
        raise ValueError(f"crs is {crs}, but there are no control points to bring into it")
    video = open_video(video)
    sampling = sample_video(video, frames)
    vehicles = read_detections(detections) if isinstance(detections, str | Path) else detections
    points = None if gcps is None or isinstance(gcps, Georeference) else read_control_points(gcps)
    first = choose_reference_time(gcps if points is None else points)
    reference = choose_reference(video, detections=vehicles, time=first)
    if points is not None:
        points = transform_points_to_reference(points, video, reference, vehicles)
    place = gcps
    if not isinstance(gcps, Georeference):
        place = georeference_reference_frame(points, video, reference, crs)
    if (place.height, place.width) != (video.height, video.width):
        raise ValueError(
            f"the georeference is of an image of {place.width} x {place.height} px, the frames "
            f"have {video.width} x {video.height}; make it for their size"
        )
    registration, background = _register_and_average(sampling, reference, vehicles, progress)
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
            "background": report_background(background, _method(vehicles, sampling)),
            "georeference": report_georeference(place, points),
        },
    )


def _register_and_average(
    sampling: Sampling, reference: Reference, detections: Detections | None, progress: Progress
) -> tuple[Registration, Background]:
    """Register and average the frames; without detections, read them again to remove traffic."""
    size = (reference.height, reference.width)
    register = partial(_register_until_converged, sampling, reference, detections, progress)
    if detections or sampling.plain_mean:
        mean = start_mean(
            size, detections=detections, tolerance=sampling.tolerance, bands=sampling.bands
        )
        return register(mean, add_to_mean), finish_mean(mean)
    search = start_search(size, sampling.tolerance)
    registration = register(search, add_to_search)
    _refuse_few_frames(registration)
    frames = read_registered(sampling, registration, progress)
    return registration, average_ground(frames, search)


def _register_until_converged(
    sampling: Sampling,
    reference: Reference,
    detections: Detections | None,
    progress: Progress,
    background: Accumulated,
    add: Callable[[Accumulated, Frame, Float[Array, "3 3"]], None],
) -> Registration:
    """Register frames and add each to a background, until that has converged."""
    placements = (
        register_frames(batch, reference, detections=detections) for batch in sampling.read()
    )
    rows = []
    for frame, placement in chain.from_iterable(placements):
        rows.append((frame.index, frame.time, placement))
        progress("register", len(rows), sampling.frame_count)
        if placement.valid:
            add(background, frame, placement.reference_from_frame)
            if background.converged:
                break
    return collect_registration(rows, reference)


def _refuse_few_frames(registration: Registration) -> None:
    valid = registration.valid
    if valid.sum() < FEWEST:
        counts = count_reasons(registration.reason)
        reasons = ", ".join(f"{kind}: {count}" for kind, count in counts.items())
        raise RegistrationError(
            f"{valid.sum()} of {len(valid)} frames could be laid on the reference at "
            f"{registration.reference.time:.1f} s{f' ({reasons})' if reasons else ''}; at least "
            f"{FEWEST} are needed to tell traffic from ground. "
            "Use more frames, or detections, or frames='all' for the mean as it is"
        )


def _warn_of_less(registration: Registration, background: Background) -> None:
    """Say so when much of the video could not be used, or the map is smaller than the flight."""
    reference, valid = registration.reference, registration.valid
    if valid.mean() < 0.5:
        _warn(
            f"only {valid.sum()} of {len(valid)} frames could be laid on the reference at "
            f"{reference.time:.1f} s ({', '.join(count_reasons(registration.reason))})"
        )
    if background.frames_used < 0.5 * valid.sum():
        _warn(
            f"detections are known of {background.frames_used} of {valid.sum()} frames only; the "
            "others are not used: give a file for every frame, empty where there is no vehicle"
        )
    if background.contested.mean() > 0.1:
        _warn(
            f"the ground is in doubt in {background.contested.mean():.0%} of the pixels: give "
            "detections of the vehicles, or a longer video"
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


def _method(detections: Detections | None, sampling: Sampling) -> str:
    if detections:
        return "mean masked by detections"
    return "mean" if sampling.plain_mean else "mean of what is not traffic"


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
