"""Read a video in batches of frames, each spread over the whole video."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video

FIRST_BATCH_FRAMES = 16  # doubled until the background has converged
MAX_AUTO_FRAMES = 64


def read_in_one_pass(video: Video) -> Iterator[Iterator[Frame]]:
    """Yield the batches of `read_batches`, all of whose frames are decoded first, in one pass."""
    batches = list(_list_batch_times(video.duration))
    times = np.sort(np.concatenate([times for times, _ in batches]))
    frames = list(video.read_at(times, batches[-1][1] / 2))
    decoded = np.array([frame.time for frame in frames])
    read: set[float] = set()
    for times, _ in batches:
        nearest = np.abs(decoded - times[:, None]).argmin(1)
        # copies, so that what is converted of them does not stay in memory
        yield _skip_read((replace(frames[index]) for index in nearest), read)


def read_batches(video: Video) -> Iterator[Iterator[Frame]]:
    """Yield batches of 16, 16 and 32 frames, each spread over a video of known length.

    No frame comes twice. Batches must be read to their ends, in order.
    """
    read: set[float] = set()
    for times, spacing in _list_batch_times(video.duration):
        # a keyframe within half a step replaces a frame
        yield _skip_read(video.read_at(times, spacing / 2), read)


def _skip_read(frames: Iterable[Frame], read: set[float]) -> Iterator[Frame]:
    """Yield the frames whose times are not yet in `read`, and add these."""
    for frame in frames:
        if frame.time not in read:
            read.add(frame.time)
            yield frame


def _list_batch_times(duration: float) -> Iterator[tuple[Float[Array, " n"], float]]:
    """Yield the times of each batch (s), and the spacing of all times so far (s)."""
    end = duration * (1 - 1e-6)
    count = FIRST_BATCH_FRAMES
    yield np.linspace(0, end, count, endpoint=False), end / count
    while 2 * count <= MAX_AUTO_FRAMES:
        yield (np.arange(count) + 0.5) * end / count, end / count / 2
        count *= 2
