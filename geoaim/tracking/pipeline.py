"""Track the agents of a video: frames and detections -> tracks in the world of an AIM."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.errors import TracksError, warn
from geoaim.base.progress import Progress, notebook_progress
from geoaim.base.world import World
from geoaim.hdmap.drivable import sample_lane_directions
from geoaim.hdmap.lanelet2 import HDMap
from geoaim.mapping.pipeline import MIN_USED_SHARE
from geoaim.mapping.video.detections import DetectedBoxes, DetectionSource, read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video, VideoSource, open_video, warn_of_pace
from geoaim.tracking.association import MIN_HITS, MIN_START_SCORE, Tracklets, associate
from geoaim.tracking.box_checks import (
    check_sizes,
    check_standing,
    check_tracks,
    drop_doubled_boxes,
    find_askew,
)
from geoaim.tracking.find_vehicles import keep_certain, measure_certainty, search_frames
from geoaim.tracking.frame_poses import FramePoses, locate_frames
from geoaim.tracking.ground_detections import GroundDetections, place_boxes, select_detections
from geoaim.tracking.roofs import correct_roofs
from geoaim.tracking.scale import check_scale
from geoaim.tracking.standing import Directions
from geoaim.tracking.states import make_states
from geoaim.tracks.changes import select_agents
from geoaim.tracks.tracks import Tracks

MAX_DOUBLED = 0.05  # share of doubled boxes without a warning
MAX_UNUSED = 0.25  # share of boxes in no track without a warning
# s; tracks that last less are taken for pieces of others: 30 of 289 of a real video, and 3 of 15 of
# the sample without a detector, of which two are over 4 m wide. Not measured against a truth
MIN_TRACK_S = 0.5


@dataclass(frozen=True, eq=False)
class FollowedVideo:
    """The tracks of a video, and what they are of.

    Attributes:
        tracks: a state for each frame in which an agent is there.
        poses: where the frames lie, in the order of the tracks' times.
        unused: share of the given boxes that are in no track; 0 where none are given.
        certainty: share of the tracks that the network expects to be right; None: boxes are given.
    """

    tracks: Tracks
    poses: FramePoses
    unused: float
    certainty: float | None = None


def track_video(
    video: VideoSource,
    aim: AIM,
    detections: DetectionSource | None = None,
    *,
    hdmap: HDMap | None = None,
    flying_height: float | None = None,
    progress: Progress = notebook_progress,
) -> Tracks:
    """Track the agents of a video in the world of an AIM.

    The frames are registered to each other and to the AIM, which takes the boxes of a detector to
    the ground; there they are associated, and smoothed in both directions of time.

    Args:
        video: what `open_video` opens.
        aim: an AIM of the same ground, best one that was built of this video.
        detections: boxes of each frame, as `read_detections` reads them, or what it returns. None:
            vehicles are found by `find_vehicles` in four frames a second.
        hdmap: lanes, which tell the headings of vehicles that do not move; None: not known.
        flying_height: as in `track_boxes`.
        progress: called with the stage, the frames done and the frames in all (None: unknown).

    Returns:
        The tracks at the times of all frames, or of those that were searched, with observed states,
        with whether each state was seen or bridges a gap, and with uncertainties.

    Raises:
        VideoError: the video cannot be opened.
        RegistrationError: the frames cannot be registered to each other, or not to the AIM.
        TracksError: no track is found.
        GeoaimError: detections are in no known format.
    """
    given = hdmap, flying_height, progress
    return follow_video(open_video(video), aim, detections, *given).tracks


def follow_video(
    opened: Video,
    aim: AIM,
    detections: DetectionSource | None,
    hdmap: HDMap | None,
    flying_height: float | None,
    progress: Progress,
) -> FollowedVideo:
    """Track the agents of a video as `track_video` does, and keep where its frames lie."""
    warn_of_pace(opened)
    if detections is None:
        poses = locate_frames(opened, aim, None, progress)
        known = search_frames(opened, aim, poses, progress)
    else:
        poses, known = _locate_boxes(opened, aim, detections, progress)
    lanes = None if hdmap is None else Directions(*sample_lane_directions(hdmap))
    size = opened.height, opened.width
    times = find_image_times(opened, poses.registration.index, poses.times)
    matrices = poses.world_from_frame
    if detections is None:
        searched = [step for step, boxes in enumerate(known) if boxes is not None]
        known, matrices = [known[step] for step in searched], matrices[searched]
        times = times[searched]
        placed = _place_boxes(known, matrices, size, flying_height)
        followed = keep_certain(placed, associate(placed, times))
    else:
        followed = _follow_boxes(known, matrices, times, size, flying_height)
    tracks = _drop_fragments(make_states(*followed, times, aim.world, lanes))
    check_tracks(tracks)
    check_standing(tracks)
    _warn_of_lost_frames(poses)
    if detections is None:
        check_scale(tracks, aim)
        return FollowedVideo(tracks, poses, 0.0, float(measure_certainty(*followed).mean()))
    if text := find_askew(tracks):
        warn(
            f"{text}: are some of them people (--classes), or are the boxes turned? Four corners "
            "turn them; an angle is not read, and one from 0 to 1 may be taken for a score"
        )
    count = sum(len(boxes.boxes) for boxes in known if boxes is not None)
    return FollowedVideo(tracks, poses, 1 - len(followed[0].step) / max(count, 1))


def _warn_of_lost_frames(poses: FramePoses) -> None:
    """Warn where most frames do not lie on the map."""
    located = np.isfinite(poses.world_from_frame).all(axis=(1, 2)).mean()
    if located < MIN_USED_SHARE:
        warn(f"only {located:.0%} of the frames lie on the map; agents are followed in these alone")


def _locate_boxes(
    video: Video, aim: AIM, detections: DetectionSource, progress: Progress
) -> tuple[FramePoses, list[DetectedBoxes | None]]:
    """Locate the frames without what was detected in them; with the boxes of each frame."""
    found = read_detections(detections, video=video)
    boxes: dict[int, DetectedBoxes | None] = {}

    def read_frames() -> Iterator[Frame]:
        for frame in video.read_all():
            boxes[frame.index] = found(frame)
            yield frame

    recorded = replace(video, read_all=read_frames)
    poses = locate_frames(recorded, aim, lambda frame: boxes.get(frame.index), progress)
    return poses, [boxes.get(index) for index in poses.registration.index.tolist()]


def find_image_times(
    video: Video, index: Int[Array, "T"], times: Float[Array, "T"]
) -> Float[Array, "T"]:
    """Find the times of images, by gaps in the numbers that they are named by."""
    if video.names is None:
        return times
    if video.rate == 1.0:
        warn(
            f"{video.source}: images count as one a second; if they are not, give their rate "
            "(--image-rate, or open_video(folder, rate=...))"
        )
    found = [re.fullmatch(r"(.*?)(\d+)", Path(name).stem) for name in video.names]
    parts = [part for part in found if part is not None]
    if len(parts) < len(found) or len({part[1] for part in parts}) > 1:
        return times
    numbers = np.array([int(part[2]) for part in parts], float)
    gaps = np.diff(numbers)
    if not len(gaps) or gaps.min() <= 0 or np.ptp(gaps) == 0:
        return times
    warn(f"{video.source}: the numbers of its images have gaps, which count as time")
    return np.asarray((numbers - numbers[0]) / gaps.min() / video.rate)[index]


def track_boxes(  # noqa: PLR0913  (its options)
    frames: Sequence[DetectedBoxes | None],
    world_from_frame: Float[Array, "T 3 3"],
    times: Float[Array, "T"],
    world: World,
    size: tuple[int, int],
    *,
    lanes: Directions | None = None,
    flying_height: float | None = None,
) -> Tracks:
    """Track agents from their boxes in frames whose place in the world is known.

    Args:
        frames: boxes of each frame; None for a frame without any known.
        world_from_frame: transform of each frame's pixels to metres; NaN where it is not known.
        times: of the frames, s.
        world: the plane of those metres.
        size: (height, width) of the frames, pixels.
        lanes: directions of lanes, for vehicles that never move; None: not known.
        flying_height: of the camera above the ground, m, looking straight down; roofs, which lean
            outwards, are corrected by it, and what may be left is stated. None: neither is done.

    Returns:
        The tracks at the times of all frames.

    Raises:
        TracksError: no track is found.
    """
    followed = _follow_boxes(frames, world_from_frame, times, size, flying_height)
    tracks = _drop_fragments(make_states(*followed, times, world, lanes))
    check_tracks(tracks)
    return tracks


def _drop_fragments(tracks: Tracks) -> Tracks:
    """Drop tracks that last for under `MIN_TRACK_S`, or half of a video that is as short."""
    there, count = tracks.present, len(tracks.times)
    first = tracks.times[there.argmax(axis=1)]
    lasting = tracks.times[count - 1 - there[:, ::-1].argmax(axis=1)] - first
    kept = lasting >= min(MIN_TRACK_S, float(tracks.times[-1] - tracks.times[0]) / 2)
    if not kept.any():
        raise TracksError(
            f"all of {len(kept)} tracks last under {MIN_TRACK_S:g} s; vehicles that are seen for "
            "longer are needed"
        )
    return tracks if kept.all() else select_agents(tracks, kept)


def _follow_boxes(
    frames: Sequence[DetectedBoxes | None],
    world_from_frame: Float[Array, "T 3 3"],
    times: Float[Array, "T"],
    size: tuple[int, int],
    flying_height: float | None,
) -> tuple[GroundDetections, Tracklets]:
    """Place boxes on the ground and associate them; those of no track are left out."""
    frames, doubled, empty = drop_doubled_boxes(frames)
    if doubled > MAX_DOUBLED * sum(len(boxes.boxes) for boxes in frames if boxes is not None):
        warn(f"{doubled} boxes lie on another one, or are a part of one, and are left out")
    if empty:
        warn(f"{empty} boxes without an area, or with values missing, are left out")
    detections = _place_boxes(frames, world_from_frame, size, flying_height)
    check_sizes(detections)
    tracklets = associate(detections, times)
    kept = np.flatnonzero(tracklets.track >= 0)
    if not len(kept):
        known = sum(boxes is not None for boxes in frames)
        raise TracksError(
            f"{len(detections.step)} detections in {known} of {len(frames)} frames give no track; "
            "detections of the same agents in successive frames are needed"
        )
    _report_unused_boxes(detections, tracklets.track)
    detections = select_detections(detections, kept)
    tracklets = replace(tracklets, track=tracklets.track[kept], sigma=tracklets.sigma[kept])
    return detections, tracklets


def _place_boxes(
    frames: Sequence[DetectedBoxes | None],
    world_from_frame: Float[Array, "T 3 3"],
    size: tuple[int, int],
    flying_height: float | None,
) -> GroundDetections:
    """Place boxes on the ground, those of roofs where the camera's height is known."""
    placed = place_boxes(frames, world_from_frame, size)
    if flying_height is None:
        return placed
    return correct_roofs(placed, world_from_frame, size, flying_height)


def _report_unused_boxes(detections: GroundDetections, track: Int[Array, "M"]) -> None:
    """Warn where many boxes are in no track, and say why."""
    unused = track < 0
    if unused.mean() > MAX_UNUSED:
        low = int((detections.score[unused] < MIN_START_SCORE).sum())
        warn(
            f"{unused.sum()} of {len(track)} boxes are in no track: {low} have scores under "
            f"{MIN_START_SCORE} and {unused.sum() - low} are of what is seen in fewer than "
            f"{MIN_HITS} frames that follow each other"
        )
