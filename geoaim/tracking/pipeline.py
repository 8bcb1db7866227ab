"""Track the agents of a video: frames and detections -> tracks in the world of an AIM."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.errors import TracksError
from geoaim.base.progress import Progress, notebook_progress
from geoaim.base.world import World
from geoaim.hdmap.drivable import sample_lane_directions
from geoaim.hdmap.lanelet2 import HDMap
from geoaim.mapping.video.detections import DetectedBoxes, DetectionSource, read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import VideoSource, open_video
from geoaim.tracking.association import associate
from geoaim.tracking.frame_poses import locate_frames
from geoaim.tracking.ground_detections import place_boxes
from geoaim.tracking.noise import DEFAULT_NOISE_PX, estimate_noise
from geoaim.tracking.standing import Directions
from geoaim.tracking.states import CUT_SIGMA_M, make_states
from geoaim.tracks.tracks import Tracks

ASSOCIATIONS = 2  # the second one knows the noise of the boxes
NOISE_MARGIN = 1.4  # by which boxes scatter more in jumps than they usually do


def track_video(
    video: VideoSource,
    aim: AIM,
    detections: DetectionSource,
    *,
    hdmap: HDMap | None = None,
    progress: Progress = notebook_progress,
) -> Tracks:
    """Track the agents of a video in the world of an AIM.

    The frames are registered to each other and to the AIM, which takes the boxes of a detector to
    the ground; there they are associated, and smoothed in both directions of time.

    Args:
        video: what `open_video` opens.
        aim: an AIM of the same ground, best one that was built of this video.
        detections: boxes of each frame, as `read_detections` reads them, or what it returns.
        hdmap: lanes, which tell the headings of vehicles that do not move; None: not known.
        progress: called with the stage, the frames done and the frames in all (None: unknown).

    Returns:
        The tracks at the times of all frames, with observed states, with whether each state was
        seen or bridges a gap, and with uncertainties.

    Raises:
        VideoError: the video cannot be opened.
        RegistrationError: the frames cannot be registered to each other, or not to the AIM.
        TracksError: no track is found.
        GeoaimError: detections are in no known format.
    """
    opened = open_video(video)
    found = read_detections(detections, video=opened)
    boxes: dict[int, DetectedBoxes | None] = {}

    def read_frames() -> Iterator[Frame]:
        for frame in opened.read_all():
            boxes[frame.index] = found(frame)
            yield frame

    recorded = replace(opened, read_all=read_frames)
    poses = locate_frames(recorded, aim, lambda frame: boxes.get(frame.index), progress)
    known = [boxes.get(index) for index in poses.registration.index.tolist()]
    lanes = None if hdmap is None else Directions(*sample_lane_directions(hdmap))
    size = opened.height, opened.width
    return track_boxes(known, poses.world_from_frame, poses.times, aim.world, size, lanes=lanes)


def track_boxes(
    frames: Sequence[DetectedBoxes | None],
    world_from_frame: Float[Array, "T 3 3"],
    times: Float[Array, "T"],
    world: World,
    size: tuple[int, int],
    *,
    lanes: Directions | None = None,
) -> Tracks:
    """Track agents from their boxes in frames whose place in the world is known.

    Args:
        frames: boxes of each frame; None for a frame without any known.
        world_from_frame: transform of each frame's pixels to metres; NaN where it is not known.
        times: of the frames, s.
        world: the plane of those metres.
        size: (height, width) of the frames, pixels.
        lanes: directions of lanes, for vehicles that never move; None: not known.

    Returns:
        The tracks at the times of all frames.

    Raises:
        TracksError: no track is found.
    """
    detections = place_boxes(frames, world_from_frame, size)
    cut = detections.cut.any(axis=(1, 2))
    track, noise = np.full(len(detections.step), -1), DEFAULT_NOISE_PX
    for _ in range(ASSOCIATIONS):
        sigma = np.where(cut, CUT_SIGMA_M, noise * detections.resolution)
        track = associate(detections, times, sigma)
        noise = max(NOISE_MARGIN * estimate_noise(detections, track), DEFAULT_NOISE_PX)
    if not (track >= 0).any():
        known = sum(boxes is not None for boxes in frames)
        raise TracksError(
            f"{len(track)} detections in {known} of {len(frames)} frames give no track; detections "
            "of the same agents in successive frames are needed"
        )
    return make_states(detections, track, times, world, lanes)
