"""Collect small copies of frames, have `traffic_removal` find their traffic, average the rest.

Boxes of detections count as unseen: what they miss is found as all traffic is. All frames that are
given count; `mapping.sampling` chooses them.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import BackgroundError
from geoaim.mapping.background import running_mean
from geoaim.mapping.background.exposure import apply_gain, black_level, estimate_gain
from geoaim.mapping.background.traffic_removal import MIN_FRAMES, Traffic, find_traffic
from geoaim.mapping.background.warping import draw_footprint, enlarge_mask, warp
from geoaim.mapping.video.detections import Detections
from geoaim.mapping.video.frames import Frame

MAX_SMALL_SIDE_PX = 1024  # longest side of the small frames in which traffic is searched


@dataclass(eq=False)
class TrafficSearch(running_mean.Accumulation):
    """Small copies of the frames that `add_to_search` has added so far, and the traffic in them."""

    detections: Detections | None = None  # known traffic, or None
    # the small frames, warped to the image
    stack: list[UInt8[Array, "h w 3"]] = field(init=False, default_factory=list)
    # the pixels of the image that each small frame shows outside of boxes
    seen: list[Bool[Array, "h w"]] = field(init=False, default_factory=list)
    # their times, s
    times: list[float] = field(init=False, default_factory=list)
    # the traffic in these frames; None if it was not searched since the last one was added
    traffic: Traffic | None = field(init=False, default=None)

    @property
    def reduction(self) -> int:
        """Size of the image over that of the small frames."""
        return -(-max(self.size) // MAX_SMALL_SIDE_PX)


def remove_traffic(
    frames: Iterable[running_mean.Registered],
    *,
    size: tuple[int, int],
    detections: Detections | None = None,
) -> running_mean.Background:
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
    search = TrafficSearch(size, detections=detections)
    for frame, image_from_frame in frames:
        add_to_search(search, frame, image_from_frame)
    return average_ground(frames, search)


def add_to_search(
    search: TrafficSearch, frame: Frame, image_from_frame: Float[Array, "3 3"]
) -> None:
    """Add a registered frame to a search, in place, and search at 16, 32, 64 frames.

    Args:
        search: the search; if it has detections, a frame without an entry in them is skipped.
        frame: the frame.
        image_from_frame: (3, 3) pixels of the frame to pixels of the background.
    """
    outside = None
    if search.detections is not None:
        outside = running_mean.draw_outside(search.detections, frame, image_from_frame, search.size)
        if outside is None:
            return
    small = -(-search.size[0] // search.reduction), -(-search.size[1] // search.reduction)
    small_from_image = np.diag([small[1] / search.size[1], small[0] / search.size[0], 1.0])
    gain = estimate_gain(search.exposure, frame, image_from_frame)
    pixels, small_from_frame = _shrink_frame(frame, search.reduction, gain)
    matrix = small_from_image @ image_from_frame @ np.linalg.inv(small_from_frame)
    seen = draw_footprint(pixels.shape, matrix, small)
    if outside is not None:
        seen *= np.asarray(cv2.resize(outside, small[::-1], interpolation=cv2.INTER_NEAREST))
    search.stack.append(warp(pixels, matrix, small))
    search.seen.append(seen.view(bool))
    search.times.append(frame.time)
    search.traffic = None
    if search.tolerance > 0 and running_mean.is_time_to_check(len(search.stack)):
        search.traffic = _find_traffic(search)
        ground = search.traffic.background.astype(np.float32)
        running_mean.measure_change(search, running_mean.average_blocks(ground, search.reduction))


def average_ground(
    frames: Iterable[running_mean.Registered], search: TrafficSearch
) -> running_mean.Background:
    """Average frames without the traffic of a search; the search's small frames are dropped.

    The frames are those that `add_to_search` got, in the same order.

    Raises:
        BackgroundError: fewer than 4 frames.
    """
    if len(search.stack) < MIN_FRAMES:
        raise BackgroundError(
            f"{len(search.stack)} registered frames; at least {MIN_FRAMES} are needed to tell "
            "traffic from ground: register more frames, give detections, or average the frames as "
            "they are"
        )
    traffic = search.traffic or _find_traffic(search)
    search.stack.clear()
    search.seen.clear()
    mean = running_mean.RunningMean(search.size, detections=search.detections)
    if (known := search.detections) is not None:
        frames = (pair for pair in frames if known(pair[0]) is not None)
    # the masks first: when they run out, no further frame is read
    for mask, (frame, image_from_frame) in zip(traffic.masks, frames, strict=False):
        running_mean.add_to_mean(mean, frame, image_from_frame, enlarge_mask(~mask, search.size))
    ground = running_mean.finish_mean(mean)
    contested = enlarge_mask(traffic.contested, search.size).view(bool) & (ground.coverage > 0)
    return replace(ground, contested=ground.contested | contested, change=search.change)


def _find_traffic(search: TrafficSearch) -> Traffic:
    """Find traffic in the small frames, which become views of one array: nothing is held twice."""
    stack, seen = np.stack(search.stack), np.stack(search.seen)
    search.stack[:], search.seen[:] = stack, seen
    return find_traffic(stack, seen, np.argsort(search.times, kind="stable"))


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
