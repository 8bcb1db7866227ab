"""Collect small copies of frames, have `traffic_removal` find their traffic, average the rest.

Boxes of detections count as unseen, as does what looks like what other frames have boxes of; what
they miss else is found as all traffic is. All frames that are given count; `mapping.sampling`
chooses them.
"""

from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import BackgroundError
from geoaim.base.geometry import transform_boxes
from geoaim.mapping.background.exposure import (
    apply_gain,
    black_level,
    estimate_gain,
    start_exposure,
)
from geoaim.mapping.background.missed_boxes import find_missed_vehicles
from geoaim.mapping.background.running_mean import Background, Registered, RunningMean, draw_outside
from geoaim.mapping.background.traffic_removal import MIN_FRAMES, find_traffic
from geoaim.mapping.background.warping import draw_footprint, enlarge_mask, warp
from geoaim.mapping.video.detections import Detections, convert_boxes
from geoaim.mapping.video.frames import Frame

MAX_SMALL_SIDE_PX = 1024  # longest side of the small frames in which traffic is searched


class TrafficSearch:
    """Small copies of the frames that are added, in which traffic is searched once, at the end."""

    def __init__(self, size: tuple[int, int], detections: Detections | None = None) -> None:
        self.size, self.detections = size, detections
        self._reduction = -(-max(size) // MAX_SMALL_SIDE_PX)
        self._exposure = start_exposure(size)
        self._stack: list[UInt8[Array, "h w 3"]] = []  # warped to the image
        self._seen: list[Bool[Array, "h w"]] = []  # what each shows of the image outside of boxes
        self._boxes: list[Float[Array, "_ 4"]] = []  # in pixels of the stack; [] without any
        self._times: list[float] = []  # seconds

    @property
    def frame_count(self) -> int:
        """Number of frames that were added."""
        return len(self._times)

    def add(self, frame: Frame, image_from_frame: Float[Array, "3 3"]) -> None:
        """Add a registered frame; with detections, one without an entry in them is skipped.

        Args:
            frame: the frame.
            image_from_frame: (3, 3) pixels of the frame to pixels of the background.
        """
        outside = boxes = None
        if self.detections is not None:
            boxes = convert_boxes(self.detections(frame))
            outside = draw_outside(self.detections, frame, image_from_frame, self.size)
            if outside is None:
                return
        small = -(-self.size[0] // self._reduction), -(-self.size[1] // self._reduction)
        small_from_image = np.diag([small[1] / self.size[1], small[0] / self.size[0], 1.0])
        gain = estimate_gain(self._exposure, frame, image_from_frame)
        pixels, small_from_frame = _shrink_frame(frame, self._reduction, gain)
        matrix = small_from_image @ image_from_frame @ np.linalg.inv(small_from_frame)
        seen = draw_footprint(pixels.shape, matrix, small)
        if outside is not None:
            seen *= np.asarray(cv2.resize(outside, small[::-1], interpolation=cv2.INTER_NEAREST))
        if boxes is not None:
            corners = transform_boxes(small_from_image @ image_from_frame, boxes.boxes)
            self._boxes.append(np.hstack([corners.min(axis=1), corners.max(axis=1)]))
        self._stack.append(warp(pixels, matrix, small))
        self._seen.append(seen.view(bool))
        self._times.append(frame.time)

    def average(self, frames: Iterable[Registered]) -> Background:
        """Average the frames that were added, in the same order, without their traffic.

        The small frames are dropped.

        Raises:
            BackgroundError: fewer than 4 frames.
        """
        if self.frame_count < MIN_FRAMES:
            raise BackgroundError(
                f"{self.frame_count} registered frames; at least {MIN_FRAMES} are needed to tell "
                "traffic from ground: register more frames, give detections, or average the "
                "frames as they are"
            )
        stack, seen = np.stack(self._stack), np.stack(self._seen)
        missed = find_missed_vehicles(stack, seen, self._boxes) if self._boxes else None
        if missed is not None:
            seen &= ~missed
        self._stack.clear()
        self._seen.clear()
        traffic = find_traffic(stack, seen, np.argsort(self._times, kind="stable"))
        if missed is not None:
            np.logical_or(traffic.masks, missed, out=traffic.masks)
        del stack, seen, missed
        mean = RunningMean(self.size, self.detections)
        if (known := self.detections) is not None:
            frames = (pair for pair in frames if known(pair[0]) is not None)
        # the masks first: when they run out, no further frame is read
        for mask, (frame, image_from_frame) in zip(traffic.masks, frames, strict=False):
            mean.add(frame, image_from_frame, enlarge_mask(~mask, self.size))
        ground = mean.finish()
        contested = enlarge_mask(traffic.contested, self.size).view(bool) & (ground.coverage > 0)
        return replace(ground, contested=ground.contested | contested)


def remove_traffic(
    frames: Iterable[Registered], *, size: tuple[int, int], detections: Detections | None = None
) -> Background:
    """Average the pixels of registered frames that `traffic_removal` classifies as ground.

    Args:
        frames: some 30 to 60, spread over the video, each with its image_from_frame (3, 3). Each
            takes 5 to 8 MB of memory. They are read twice.
        size: (height, width) of the image, pixels.
        detections: boxes of vehicles, which may miss some; a frame for which it gives None is left
            out as a whole.

    Returns:
        The background.

    Raises:
        BackgroundError: fewer than 4 frames.
        TypeError: the frames can be read only once.
    """
    if iter(frames) is frames:
        raise TypeError(
            "the frames are read twice: give a list, or make __iter__ start again from the first"
        )
    search = TrafficSearch(size, detections)
    for frame, image_from_frame in frames:
        search.add(frame, image_from_frame)
    return search.average(frames)


def _shrink_frame(
    frame: Frame, reduction: int, gain: float
) -> tuple[UInt8[Array, "h w 3"], Float[Array, "3 3"]]:
    """A small RGB copy, near enough for comparisons, and its small_from_frame."""
    height, width = frame.grey.shape
    size = (-(-width // reduction), -(-height // reduction))
    if frame.planes is None:
        pixels = cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA)
    else:
        parts = [cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in frame.planes]
        pixels = cv2.cvtColor(cv2.merge(parts), cv2.COLOR_YUV2RGB)
    neutral = 0.0 if frame.planes is None else black_level(frame)
    scale = np.diag([size[0] / width, size[1] / height, 1.0])
    return apply_gain(np.asarray(pixels, np.uint8), gain, neutral), scale
