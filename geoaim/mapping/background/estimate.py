"""Estimate the background of registered frames: the ground without traffic.

`average_frames` is the mean of the frames, outside of detected boxes where these are given.
`remove_traffic` needs no detections: it reads the frames twice, first to find the traffic in small
copies. The memory of the means does not grow with the number of frames.
"""

from collections.abc import Iterable

from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.mapping.background.running_mean import Background, RunningMean, add_to_mean, finish_mean
from geoaim.mapping.background.traffic_search import TrafficSearch, add_to_search, average_ground
from geoaim.mapping.video.detections import Detections
from geoaim.mapping.video.frames import Frame

Registered = tuple[Frame, Float[Array, "3 3"]]  # a frame and its image_from_frame


def average_frames(
    frames: Iterable[Registered],
    *,
    size: tuple[int, int],
    detections: Detections | None = None,
    bands: int = 1,
) -> Background:
    """Average registered frames, without the boxes of detections where these are given.

    Each pixel is the mean of all frames that show it. With `bands`, it is the mean of every
    `bands`-th frame: each frame is warped to one of as many horizontal bands only, in turn.

    Args:
        frames: each with its image_from_frame (3, 3), read once.
        size: (height, width) of the image, pixels.
        detections: boxes to leave out of a frame, grown by 12 %. A frame of which nothing is
            known (None) is left out as a whole.
        bands: number of horizontal bands of the image.

    Returns:
        The background.

    Raises:
        BackgroundError: no frame.
    """
    mean = RunningMean(size, detections=detections, bands=bands)
    for frame, image_from_frame in frames:
        add_to_mean(mean, frame, image_from_frame)
    return finish_mean(mean)


def remove_traffic(frames: Iterable[Registered], *, size: tuple[int, int]) -> Background:
    """Average the pixels of registered frames that `traffic_removal` classifies as ground.

    Some 30 to 60 frames spread over the video suffice. Each takes 5 to 8 MB of memory.

    Args:
        frames: each with its image_from_frame (3, 3); read twice, so no one-shot iterator.
        size: (height, width) of the image, pixels.

    Raises:
        BackgroundError: fewer than 4 frames.
        TypeError: the frames can be read only once.
    """
    if iter(frames) is frames:
        raise TypeError("the frames are read twice: give a list, or make __iter__ start anew")
    search = TrafficSearch(size)
    for frame, image_from_frame in frames:
        add_to_search(search, frame, image_from_frame)
    return average_ground(frames, search)
