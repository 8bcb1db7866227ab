"""Choose the frames of a video from which a map is built, with traffic removed or as a mean."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.mapping.registration.register import Registration
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video

FrameCount = int | Literal["auto", "all"]

FIRST_BATCH_FRAMES = 16  # doubled until the background has converged
MAX_AUTO_FRAMES = 64
CONVERGED_GREY_LEVELS = 3.0  # largest change of the background by the second half of the frames
MAX_KEPT_BYTES = 1_600_000_000  # memory for frames that are not decoded twice: 64 RGB frames of 4K
MIN_FRAMES_PER_BAND = 50  # with "all", each frame fills one band of rows, which is twice as fast
MAX_BANDS = 12


@dataclass(frozen=True, eq=False)
class Sampling:
    """A choice of frames, and how they are averaged."""

    # returns a new iterator over batches; each batch yields frames in order of time
    read: Callable[[], Iterator[Iterator[Frame]]]
    frame_count: int | None  # maximum number of frames that `read` yields; None when it is unknown
    # change at which the background has converged, grey levels; 0 reads all frames
    tolerance: float = 0.0
    # n horizontal bands of the image: each pixel averages every n-th frame, which takes n times
    # less work per frame
    bands: int = 1
    plain_mean: bool = False  # whether the mean includes traffic that no detections mask
    fits_memory: bool = False  # whether the frames may be kept, so that they are decoded once


def parse_frame_count(text: str) -> FrameCount:
    """Parse "auto", "all" or a number of frames.

    Raises:
        ValueError: it is something else.

    >>> parse_frame_count("16")
    16
    """
    if text in ("auto", "all"):
        return "auto" if text == "auto" else "all"
    if not text.isdecimal() or int(text) < 1:
        raise ValueError(f"{text!r} is not auto, all or a number")
    return int(text)


def sample_video(video: Video, frames: FrameCount) -> Sampling:
    """Choose frames of a video: "auto", "all", or up to a number of them; nothing is read yet.

    "auto" will read up to 64, until the background converges: batches that are each spread over
    the whole video, and as large as all before them together. Where the samples are closer than
    the keyframes, one pass decodes all batches.

    Raises:
        ValueError: `frames` is none of these.
    """
    total = video.frame_count
    if frames == "all":
        bands = min(max((total or 0) // MIN_FRAMES_PER_BAND, 1), MAX_BANDS)
        return Sampling(lambda: iter([iter(video)]), total, bands=bands, plain_mean=True)
    if frames == "auto":
        fits = _fit_into_memory(video, min(total or MAX_AUTO_FRAMES, MAX_AUTO_FRAMES))
        if total is None or total <= FIRST_BATCH_FRAMES:
            read = partial(_read_one_batch, video, MAX_AUTO_FRAMES)
            return Sampling(read, total, CONVERGED_GREY_LEVELS, fits_memory=fits)
        one_pass = fits and video.keyframe_interval > 2 * video.duration / MAX_AUTO_FRAMES
        read = partial(_read_in_one_pass if one_pass else _read_batches, video)
        count = min(MAX_AUTO_FRAMES, total)
        return Sampling(read, count, CONVERGED_GREY_LEVELS, fits_memory=fits)
    if not isinstance(frames, int) or frames < 1:
        raise ValueError(f"frames is {frames!r}; 'auto', 'all' or a number of frames is needed")
    read, fits = partial(_read_one_batch, video, frames), _fit_into_memory(video, frames)
    return Sampling(read, None if total is None else min(frames, total), fits_memory=fits)


def read_registered(
    sampling: Sampling, registration: Registration
) -> Iterator[tuple[Frame, Float[Array, "3 3"]]]:
    """Read sampled frames again: yield each that is registered, with its reference_from_frame."""
    rows = {time: row for row, time in enumerate(registration.time.tolist())}
    valid = registration.valid
    registered = (frame for frame in chain.from_iterable(sampling.read()) if frame.time in rows)
    for frame in registered:
        row = rows[frame.time]
        if valid[row]:
            yield frame, registration.reference_from_frame[row]


def _fit_into_memory(video: Video, count: int) -> bool:
    return 3 * video.height * video.width * count <= MAX_KEPT_BYTES


def _read_one_batch(video: Video, count: int) -> Iterator[Iterator[Frame]]:
    yield video.sample(count)


def _read_in_one_pass(video: Video) -> Iterator[Iterator[Frame]]:
    """Yield the batches of `_read_batches`, all of whose frames are decoded first, in one pass."""
    batches = list(_list_batch_times(video.duration))
    times = np.sort(np.concatenate([times for times, _ in batches]))
    frames = list(video.read_at(times, batches[-1][1] / 2))
    decoded = np.array([frame.time for frame in frames])
    read: set[float] = set()
    for times, _ in batches:
        nearest = np.abs(decoded - times[:, None]).argmin(1)
        # copies, so that what is converted of them does not stay in memory
        yield _skip_read((replace(frames[index]) for index in nearest), read)


def _read_batches(video: Video) -> Iterator[Iterator[Frame]]:
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
