"""Build an AIM from video: registration, background, georeference, in this order."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NoReturn, TypeVar

import cv2
import numpy as np

from geoaim.aim.aim import AIM
from geoaim.base.errors import RegistrationError, warn
from geoaim.base.geometry import transform_points
from geoaim.base.progress import Progress, notebook_progress, report_each
from geoaim.mapping.background.running_mean import Background, RunningMean, average_frames
from geoaim.mapping.background.traffic_removal import MIN_FRAMES
from geoaim.mapping.background.traffic_search import TrafficSearch
from geoaim.mapping.box_evidence import FRAMES, check_evidence, view_frames
from geoaim.mapping.georeference.control_points import (
    ControlPoints,
    ControlPointSource,
    read_control_points,
)
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.reference_frame import (
    choose_reference_time,
    georeference_reference_frame,
    is_anywhere,
)
from geoaim.mapping.georeference.transform_models import distort_points
from geoaim.mapping.registration import register
from geoaim.mapping.registration.ambiguity import MOVING_PART
from geoaim.mapping.registration.hover import find_hovers
from geoaim.mapping.report import (
    report_background,
    report_georeference,
    report_position,
    report_registration,
)
from geoaim.mapping.sampling import FrameCount, Sample, sample_video, select_registered_frames
from geoaim.mapping.video.detections import (
    BoxReader,
    DetectedBoxes,
    Detections,
    DetectionSource,
    convert_boxes,
    read_detections,
)
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video, VideoSource, open_video

Ground = TypeVar("Ground", Background, AIM)  # an image of the ground and what is known of it
MIN_USED_SHARE = 0.5  # the build warns if a smaller share of the frames is used
MAX_TYPICAL_UNCERTAINTY_PX = 1.0  # the build warns if the registration is less certain
MAX_CONTESTED_SHARE = 0.1  # the build warns if a greater share of the pixels is contested
MAX_OUTSIDE_SHARE = 0.2  # of a frame, outside the map; the build warns of more
SURVEY_ADVICE = (
    "of the photos of a survey flight, make an orthophoto first (with OpenDroneMap, for example) "
    "and read it as imagery"
)


def build_aim(
    video: VideoSource,
    gcps: ControlPointSource | Georeference | None = None,
    *,
    detections: DetectionSource | None = None,
    frames: FrameCount = "auto",
    crs: str | None = None,
    progress: Progress = notebook_progress,
) -> AIM:
    """Build an aerial image-based map from a hovering camera's video and control points.

    Args:
        video: what `open_video` opens: a video file, a folder or glob of images, or arrays. Of a
            camera on a mast or a tripod that is not recognised as such,
            `replace(open_video(path), is_fixed=True)`: frames that are not at rest are then
            rejected, and traffic is no reason to reject one.
        gcps: what `read_control_points` reads: at least four points, better six or more, picked on
            the first frame unless they name another. Or the georeference of the first frame; one
            that only gives a scale (`make_local_georeference`) is of the reference frame, which is
            the first one if the others can be registered to it. None places the map approximately
            by the telemetry beside the video.
        detections: vehicles to leave out, as `read_detections` reads them: a folder of YOLO text
            files, or a function of a frame. What they miss, or all traffic if they are None, is
            found by the frames themselves.
        frames: how many frames are used: a number, spread over the video; "auto", 64; or "all",
            which averages every frame, and traffic too if there are no detections. With "all",
            each frame of a long video adds one stripe only, so that a pixel averages at least 50
            frames.
        crs: CRS of the map, projected and in metres, if control points place it; None keeps that of
            the points, or takes their UTM zone.
        progress: called with the stage, the frames done and the frames in all (None: unknown).

    Returns:
        The map, in the pixels of the reference frame without lens distortion; its report has the
        keys source, registration, background, georeference and position.

    Raises:
        VideoError: no frame could be read.
        RegistrationError: too few frames can be registered to the reference.
        BackgroundError: the registered frames give no background.
        GeoreferenceError: the control points or the telemetry do not fix a place.
        ValueError: `frames`, `crs` or the size of a georeference does not fit the other arguments.
    """
    if crs is not None and (gcps is None or isinstance(gcps, Georeference)):
        raise ValueError(f"crs is {crs}, but there are no control points to transform to it")
    opened = open_video(video)
    sample = sample_video(opened, frames)
    found = None if detections is None else read_detections(detections, video=opened)
    vehicles = None if found is None else _remember(found)
    given = gcps if gcps is None or isinstance(gcps, Georeference) else read_control_points(gcps)
    photos = opened.names is not None
    try:
        reference = register.choose_reference(
            opened,
            detections=vehicles,
            model="rest" if opened.is_fixed else None,
            time=choose_reference_time(given, opened),
            probes=list(sample.read()) if sample.is_kept else (),
            prefer_first=is_anywhere(given),
        )
        georeference, points, reference = _georeference(given, opened, reference, vehicles, crs)
        registration, background = _register_and_average(
            sample, reference, vehicles, progress, photos=photos
        )
    except RegistrationError as error:
        cut = "" if photos else _advise_cut(opened, sample)
        problem, *otherwise = error.args  # what helps where the camera never hovers
        raise RegistrationError(f"{problem}{cut or ''.join(otherwise)}") from error
    _warn_of_limits(registration, background, photos=photos, has_boxes=vehicles is not None)
    if isinstance(found, BoxReader):  # what is asked of any frame without its picture
        _check_boxes(opened, registration, background, found)
    if not photos:
        _warn_of_other_views(registration, lambda: _advise_cut(opened, sample))
    background = remove_distortion(background, georeference.radial)
    method = _describe_method(vehicles, sample, registration)
    return AIM(
        image=background.image,
        world_from_image=georeference.world_from_image,
        world=georeference.world,
        coverage=background.coverage,
        contested=background.contested,
        report={
            "source": Path(opened.source).name,
            "registration": report_registration(registration),
            "background": report_background(background, method),
            "georeference": report_georeference(georeference, points),
            "position": report_position(georeference, points),
        },
    )


def _remember(detections: Detections) -> Detections:
    """Ask for the boxes of each frame once: a detector takes longer than all stages together."""
    known: dict[float, DetectedBoxes | None] = {}

    def look_up(frame: Frame) -> DetectedBoxes | None:
        if frame.time not in known:
            known[frame.time] = convert_boxes(detections(frame))
        return known[frame.time]

    return look_up


def _georeference(
    gcps: ControlPoints | Georeference | None,
    video: Video,
    reference: register.Reference,
    detections: Detections | None,
    crs: str | None,
) -> tuple[Georeference, ControlPoints | None, register.Reference]:
    """Georeference the reference frame; with the control points in its pixels, and the frame."""
    if isinstance(gcps, Georeference):
        if (gcps.height, gcps.width) != (video.height, video.width):
            raise ValueError(
                f"the georeference is of an image of {gcps.width} x {gcps.height} px, the frames "
                f"have {video.width} x {video.height}; make it for their size"
            )
        return gcps, None, reference
    return georeference_reference_frame(gcps, video, reference, detections, crs)


def _register_and_average(
    sample: Sample,
    reference: register.Reference,
    detections: Detections | None,
    progress: Progress,
    *,
    photos: bool,
) -> tuple[register.Registration, Background]:
    """Register the frames, find traffic in small copies, and average the rest, twice over them."""
    size = reference.height, reference.width
    search = TrafficSearch(size, detections)
    mean = RunningMean(size, detections, sample.bands)
    background = mean if sample.plain_mean else search
    rows = []
    for frame, result in register.register_frames(sample.read(), reference, detections=detections):
        rows.append((frame.index, frame.time, result))
        progress("register", len(rows), sample.count)
        if result.valid:
            background.add(frame, result.reference_from_frame)
    registration = register.collect_registration(rows, reference)
    if sample.plain_mean:
        return registration, mean.finish()
    again = report_each(
        select_registered_frames(sample.read(), registration), progress, "average", sample.count
    )
    if search.frame_count >= MIN_FRAMES:
        return registration, search.average(again)
    if detections:
        return registration, average_frames(again, size=size, detections=detections)
    if not photos:
        _refuse_few_frames(registration)
    _refuse_other_places(registration)
    plain = average_frames(again, size=size)
    return registration, replace(plain, contested=plain.coverage > 0)


def _advise_cut(video: Video, sample: Sample) -> str:
    """Say when the camera hovers, if it does so in parts of the video only."""
    if not (hovers := find_hovers(sample.read())):
        return ""
    parts = " and ".join(f"'{video.source}#t={start:.1f},{end:.1f}'" for start, end in hovers)
    return (
        f". The view stays in {parts} (seconds): name one of these as the video for a map of that "
        "part, with points that are picked on its frames"
    )


def _refuse_few_frames(registration: register.Registration) -> NoReturn:
    valid, counts = registration.valid, register.count_reasons(registration.reason)
    advice = ""
    if MOVING_PART in counts:
        advice = "; if the camera stands on a mast or a tripod, say so (--fixed-camera)"
    reasons = ", ".join(f"{kind}: {count}" for kind, count in counts.items())
    raise RegistrationError(
        f"{valid.sum()} of {len(valid)} frames could be registered to the reference at "
        f"{registration.reference.time:.1f} s{f' ({reasons})' if reasons else ''}; at least "
        f"{MIN_FRAMES} are needed to tell traffic from ground",
        ". Use more frames, or detections, or frames='all' (--frames all) for the mean with "
        f"traffic{advice}",
    )


def _refuse_other_places(registration: register.Registration) -> None:
    """Refuse several photos of which no other shows the ground of the reference."""
    valid = registration.valid
    if len(valid) > 1 and valid.sum() == 1:
        raise RegistrationError(
            f"none of the other {len(valid) - 1} photos could be registered to photo "
            f"{registration.reference.index + 1}: a map is of one place, seen from one position. "
            f"Build one map of each photo, or of each hover; {SURVEY_ADVICE}"
        )


def _warn_of_limits(
    registration: register.Registration, background: Background, *, photos: bool, has_boxes: bool
) -> None:
    """Warn when much of the video could not be used, or the map is smaller than the flight."""
    reference, valid = registration.reference, registration.valid
    if len(valid) == 1:
        warn("the map is a single image: what stands or moves in it stays in it")
        return
    if photos and valid.sum() < MIN_FRAMES and background.contested[background.coverage > 0].all():
        warn(
            f"only {valid.sum()} of {len(valid)} photos show the ground of photo "
            f"{reference.index + 1}: too few to tell traffic from ground, which stays in the map "
            f"and is contested everywhere; {SURVEY_ADVICE}"
        )
        return
    typical = float(np.median(registration.uncertainty[valid]))
    if typical > MAX_TYPICAL_UNCERTAINTY_PX:
        warn(
            f"frames are registered to about {typical:.1f} px only, since parts of the image move "
            "apart (relief, waves, rolling shutter, compression): markings may be doubled in the "
            "background"
        )
    if background.frames_used < MIN_USED_SHARE * valid.sum():
        warn(
            f"detections are known of {background.frames_used} of {valid.sum()} frames only; the "
            "others are not used: give a file for every frame, empty where there is no vehicle"
        )
    if background.contested.mean() > MAX_CONTESTED_SHARE:
        advice = "look for vehicles without a box" if has_boxes else "give boxes of the vehicles"
        warn(
            f"the ground is uncertain in {background.contested.mean():.0%} of the pixels: "
            f"{advice}, or give a longer video"
        )


def _warn_of_other_views(
    registration: register.Registration, advise_cut: Callable[[], str]
) -> None:
    """Warn when frames show other ground than the reference, where the map ends."""
    reference, valid = registration.reference, registration.valid
    size = [reference.width, reference.height]
    shares = np.linspace(0.05, 0.95, 10)
    grid = np.stack(np.meshgrid(shares, shares), axis=-1).reshape(-1, 2) * size
    views = transform_points(registration.reference_from_frame[valid], grid)
    outside = 1 - ((views > 0) & (views < size)).all(axis=2).mean(axis=1)
    leaves = outside > MAX_OUTSIDE_SHARE
    found = []
    if valid.mean() < MIN_USED_SHARE:
        found.append(
            f"only {valid.sum()} of {len(valid)} frames could be registered to the reference at "
            f"{reference.time:.1f} s ({', '.join(register.count_reasons(registration.reason))})"
        )
    if leaves.any():
        found.append(
            f"the view leaves the reference at {reference.time:.1f} s in {leaves.sum()} of "
            f"{valid.sum()} frames, by up to {outside.max():.0%} of the image; the map ends there"
        )
    if found:
        warn("; ".join(found) + advise_cut())


def _check_boxes(
    video: Video, registration: register.Registration, background: Background, boxes: BoxReader
) -> None:
    """Warn of boxes that do not lie on what differs from the background."""
    valid = registration.valid
    index, place = registration.index[valid], registration.reference_from_frame[valid]
    chosen = np.unique(np.linspace(0, len(index) - 1, FRAMES).round().astype(int))
    frames = list(video.frames_at(registration.time[valid][chosen]))
    # late boxes are told by those of the frames between; the camera moves evenly there
    numbers = np.arange(index[0], index[-1] + 1)
    places = [np.interp(numbers, index, values) for values in place.reshape(-1, 9).T]
    matrices = dict(zip(numbers.tolist(), np.stack(places, 1).reshape(-1, 3, 3), strict=True))
    known: dict[int, DetectedBoxes | None] = {}
    for number in numbers.tolist():
        name = None if video.names is None else video.names[number]
        at = replace(frames[0], index=number, time=video.find_time(number), name=name)
        known[number] = boxes(at)
    grey = np.asarray(cv2.cvtColor(background.image, cv2.COLOR_RGB2GRAY), np.uint8)
    views = view_frames(frames, matrices, grey, background.coverage > 0)
    check_evidence(views, known, matrices, (video.width, video.height), video.listed.rate)


def _describe_method(
    detections: Detections | None, sample: Sample, registration: register.Registration
) -> str:
    if detections:
        return "mean masked by detections"
    plain = sample.plain_mean or registration.valid.sum() < MIN_FRAMES
    return "mean" if plain else "mean without traffic"


def remove_distortion(background: Ground, radial: float) -> Ground:
    """Resample a background or a map without the radial distortion of the lens.

    Args:
        background: the background or map.
        radial: the lens term of a `Georeference`.

    Returns:
        The same without distortion.
    """
    if radial == 0.0:
        return background
    height, width = background.coverage.shape
    x, y = (np.empty((height, width), np.float32) for _ in range(2))
    columns = np.arange(width) + 0.5
    for row in range(height):
        centres = np.column_stack([columns, np.full(width, row + 0.5)])
        x[row], y[row] = distort_points(centres, radial, height, width).T - 0.5  # OpenCV's origin
    contested = cv2.remap(background.contested.view(np.uint8), x, y, cv2.INTER_NEAREST)
    return replace(
        background,
        image=np.asarray(cv2.remap(background.image, x, y, cv2.INTER_LINEAR), np.uint8),
        coverage=np.asarray(cv2.remap(background.coverage, x, y, cv2.INTER_NEAREST), np.uint16),
        contested=np.asarray(contested).astype(bool),
    )
