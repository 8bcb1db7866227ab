"""Poses of a video's frames in the world of an AIM: registered to each other, then to the AIM."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.errors import RegistrationError, warn
from geoaim.base.progress import Progress
from geoaim.mapping.box_evidence import FRAMES, MIN_BOXES, check_evidence, view_frames, view_map
from geoaim.mapping.registration.features import detect_features, match_features
from geoaim.mapping.registration.frame_registration import (
    FrameRegistration,
    make_keyframe,
    mask_detections,
    register_frame,
)
from geoaim.mapping.registration.patches import make_template
from geoaim.mapping.registration.register import Registration, register
from geoaim.mapping.registration.rest import check_rest
from geoaim.mapping.video.detections import DetectedBoxes, Detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video

MIN_COVERED = 0.3  # share of the reference frame that the AIM must cover


@dataclass(frozen=True, eq=False)
class FramePoses:
    """Where the frames of a video lie in the world of an AIM."""

    world_from_frame: Float[Array, "T 3 3"]  # pixels to metres; NaN where a frame is rejected
    times: Float[Array, "T"]  # s
    registration: Registration  # of the frames to their reference


def locate_frames(
    video: Video, aim: AIM, detections: Detections | None, progress: Progress
) -> FramePoses:
    """Locate the frames of a video, without agents, in the world of an AIM of the same ground.

    Raises:
        RegistrationError: the frames cannot be registered to each other, or not to the AIM.
    """
    boxes: dict[int, DetectedBoxes | None] = {}

    def read_frames() -> Iterator[Frame]:
        for frame in video.read_all():
            boxes[frame.index] = None if detections is None else detections(frame)
            yield frame

    recorded = replace(video, read_all=read_frames)
    time, aim_from_reference = _find_built_reference(video, aim), np.eye(3)
    registration = register(recorded, detections=detections, reference_time=time, progress=progress)
    if time is None:
        frame = next(video.frames_at([registration.reference.time]))
        aim_from_reference, _ = place_reference(frame, aim, detections)
    world_from_reference = aim.world_from_image @ aim_from_reference
    matrices = world_from_reference @ registration.reference_from_frame
    poses = FramePoses(matrices, registration.time, registration)
    if detections is not None:
        _check_boxes(video, aim, poses, boxes)
    return poses


def _check_boxes(
    video: Video, aim: AIM, poses: FramePoses, boxes: Mapping[int, DetectedBoxes | None]
) -> None:
    """Warn of boxes that do not lie on what differs from the map."""
    known = np.flatnonzero(np.isfinite(poses.world_from_frame).all(axis=(1, 2)))
    rows = known[np.unique(np.linspace(0, len(known) - 1, FRAMES).round().astype(int))]
    frames, index = video.frames_at(poses.times[rows]), poses.registration.index[rows].tolist()
    map_from_frame = np.linalg.inv(aim.world_from_image) @ poses.world_from_frame[rows]
    grey = np.asarray(cv2.cvtColor(aim.image, cv2.COLOR_RGB2GRAY), np.uint8)
    by_number = dict(zip(index, map_from_frame, strict=True))
    views = view_frames(frames, by_number, grey, aim.coverage > 0)
    numbers = poses.registration.index.tolist()
    matrices = dict(zip(numbers, poses.registration.reference_from_frame, strict=True))
    size = video.width, video.height
    few = check_evidence(views, boxes, matrices, size, video.listed.rate)
    if few is not None and any(own is not None and len(own.boxes) for own in boxes.values()):
        warn(
            f"{few} boxes of what moves on could be compared with the picture; {MIN_BOXES} are "
            "needed to tell whether boxes are of these frames, which is taken for granted"
        )


def _find_built_reference(video: Video, aim: AIM) -> float | None:
    """Find the time (s) of the frame of this video whose pixels the AIM has; None for another one.

    An AIM states its source and its reference frame. That frame then lies where the AIM's pixels
    do, which a search may doubt: dashes of lanes fit 20 % as well one dash further.
    """
    built, place = (aim.report.get(name) or {} for name in ("registration", "georeference"))
    time, size = built.get("reference_time_s"), (video.height, video.width)
    named = aim.report.get("source") == Path(video.source).name
    if time is None or not named or place.get("radial") or aim.coverage.shape != size:
        return None
    frame = next(iter(video.frames_at([time])), None)
    if frame is None or frame.index != built.get("reference_index"):
        return None
    grey = np.asarray(cv2.cvtColor(aim.image, cv2.COLOR_RGB2GRAY), np.uint8)
    return time if check_rest(frame.grey, make_template(grey)).valid else None


def place_reference(
    frame: Frame, aim: AIM, detections: Detections | None
) -> tuple[Float[Array, "3 3"], FrameRegistration]:
    """Place a frame in the image of an AIM: by features, then by patches of the AIM as it sees it.

    Gives the transform of the frame's pixels to those of the AIM, and the registration by patches.

    Raises:
        RegistrationError: the frame and the AIM do not match.
    """
    size = frame.grey.shape
    grey = np.asarray(cv2.cvtColor(aim.image, cv2.COLOR_RGB2GRAY), np.uint8)
    hidden = aim.coverage == 0
    features = detect_features(frame.grey, exclude=mask_detections(frame, detections))
    found = match_features(detect_features(grey, exclude=hidden), features, "homography", size=size)
    if found is None:
        raise RegistrationError(
            f"the frame at {frame.time:.2f} s does not match the AIM: too few features agree; give "
            "an AIM that is made of this video, or of the same ground in a similar light"
        )
    view, seen = view_map(grey, ~hidden, found, size)
    if seen.mean() < MIN_COVERED:
        raise RegistrationError(
            f"the AIM covers {seen.mean():.0%} of the frame at {frame.time:.2f} s; at least "
            f"{MIN_COVERED:.0%} are needed"
        )
    keyframe = make_keyframe(view, ~seen, np.eye(3), 0.0)
    placement, _ = register_frame(frame.grey, [keyframe], keyframe, np.eye(3), "homography")
    if not placement.valid:
        raise RegistrationError(
            f"the frame at {frame.time:.2f} s does not match the AIM: {placement.reason}; give an "
            "AIM that is made of this video, or of the same ground in a similar light"
        )
    return found @ placement.reference_from_frame, placement
