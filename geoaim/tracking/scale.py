"""The scale of a video by the vehicles in it, and whether a map's scale can be right."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy import ndimage

from geoaim.aim.aim import AIM
from geoaim.base.errors import TracksError, warn
from geoaim.base.progress import Progress, no_progress, notebook_progress
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.mapping.video.video import Video, VideoSource, open_video
from geoaim.tracking.find_vehicles import search_frames
from geoaim.tracking.frame_poses import locate_frames
from geoaim.tracks.agent_types import TYPICAL_SIZES
from geoaim.tracks.tracks import Tracks

FRAMES, MAX_WIDTH_PX = 10, 1920  # that are searched for vehicles; wider ones are reduced
STARTS = (0.08, 0.02, 0.3)  # metres per pixel with which the search begins
MAX_STEPS, TOLERANCE = 6, 0.03  # of the scale from one search to the next, as a share
MIN_BOXES = 20  # in all of these frames
SLIMNESS = (1.7, 3.2)  # length over width of cars
WINDOW = 0.12  # standard deviation of the logarithms of sizes of cars
SIGMA = 0.2  # standard deviation of a proposed scale, as a share
MIN_FACTOR = 2.0  # by which vehicles are smaller or larger than cars where the scale is doubted
CAR_M = float(np.sqrt(np.prod(TYPICAL_SIZES["car"])))  # square root of its area
MIN_AGENTS = 3  # whose sizes tell a wrong scale


@dataclass(frozen=True)
class ProposedScale:
    """The scale of a video at which most of its vehicles are as large as cars."""

    resolution: float  # metres per pixel of the frames
    boxes: int  # of vehicles, by which it is proposed


def propose_scale(
    video: VideoSource, aim: AIM, *, progress: Progress = notebook_progress
) -> ProposedScale:
    """Propose the scale of a video: that at which most of its vehicles are as large as cars.

    Vehicles are found at a first scale; their sizes give the next one, until it stays.

    Args:
        video: what `open_video` opens.
        aim: a map of this video in a local plane of any scale.
        progress: called with the stage, the searches done and how many there are at most.

    Returns:
        The scale, to about 20 %.

    Raises:
        RegistrationError: the frames cannot be registered to the map.
        TracksError: too few vehicles are found.
    """
    small, factor = _reduce(open_video(video))
    poses = locate_frames(small, aim, None, no_progress)
    unit = aim.resolution / factor  # of the map for a pixel of the reduced frames
    for start in STARTS:
        resolution, count = start, 0
        for step in range(MAX_STEPS):
            progress("propose the scale", step, MAX_STEPS)
            larger = np.diag([resolution / unit, resolution / unit, 1.0])
            scaled = replace(aim, world_from_image=larger @ aim.world_from_image)
            placed = replace(poses, world_from_frame=larger @ poses.world_from_frame)
            try:
                sides = _measure(search_frames(small, scaled, placed))
            except TracksError:  # no scale at which vehicles are found
                break
            count, last = len(sides), resolution
            if count < MIN_BOXES:
                break
            resolution = CAR_M / _find_most(sides)
            if abs(resolution / last - 1) < TOLERANCE:
                break
        if count >= MIN_BOXES:
            progress("propose the scale", 1, 1)
            return ProposedScale(resolution / factor, count)
    raise TracksError(
        "the scale is not known, and too few moving vehicles are found to propose one: give the "
        "metres per pixel of the frames (--frame-resolution), control points or imagery"
    )


def _reduce(video: Video) -> tuple[Video, float]:
    """A few frames of a video in memory, and by how much they are smaller."""
    factor = min(1.0, MAX_WIDTH_PX / video.width)
    size = round(video.width * factor), round(video.height * factor)
    frames = [frame.image for frame in video.sample(FRAMES)]
    if factor < 1:
        frames = [np.asarray(cv2.resize(f, size, interpolation=cv2.INTER_AREA)) for f in frames]
    return open_video(frames, rate=video.rate), size[0] / video.width


def _measure(found: list[DetectedBoxes | None]) -> Float[Array, " n"]:
    """Square roots of the areas of boxes that are as slim as cars, pixels."""
    corners = [boxes.get_corners() for boxes in found if boxes is not None]
    edges = np.diff(np.concatenate([*corners, np.empty((0, 4, 2))])[:, :3], axis=1)
    width, length = np.sort(np.linalg.norm(edges, axis=2), axis=1).T
    slim = (width > 0) & (length > SLIMNESS[0] * width) & (length < SLIMNESS[1] * width)
    return np.asarray(np.sqrt(length[slim] * width[slim]))


def _find_most(sides: Float[Array, " n"]) -> float:
    """The side about which most lie, as shares of it; a small piece counts less than a vehicle."""
    logs = np.log(sides)
    steps = np.arange(logs.min() - WINDOW, logs.max() + WINDOW, WINDOW / 20)
    counts, _ = np.histogram(logs, steps, weights=sides)
    smooth = ndimage.gaussian_filter1d(counts, 20)
    return float(np.exp(steps[smooth.argmax()] + WINDOW / 40))


def check_scale(tracks: Tracks, aim: AIM) -> float | None:
    """Check by the sizes of vehicles whether the scale of a map can be right, if it is assumed.

    Args:
        tracks: agents whose types follow from their sizes.
        aim: the map; control points or imagery tell the scale, telemetry or a user assumes it.

    Returns:
        By how much the scale is too small (above 1) or too large, with a warning; None: it may be
        right.
    """
    georeference = aim.report.get("georeference", {})
    if not georeference.get("approximate", False):
        return None
    if len(tracks.ids) < MIN_AGENTS:
        return None
    factor = CAR_M / _find_most(np.sqrt(tracks.sizes.prod(axis=1)))
    if 1 / MIN_FACTOR < factor < MIN_FACTOR:
        return None
    length, width = np.array(TYPICAL_SIZES["car"]) / factor
    warn(
        f"most of what moves is about {length:.2g} x {width:.2g} m; if these are cars, the map's "
        f"scale is wrong, and a pixel has {factor:.2g} times as many metres (--frame-resolution)"
    )
    return factor
