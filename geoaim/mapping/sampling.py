"""Choose the frames of a video of which a map is made."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.mapping.registration.register import Registration
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video

FrameCount = int | Literal["auto", "all"]

AUTO_FRAMES = 64  # 2.35 grey levels of error, 2.18 with 32; one long queue 1.9, with 32 3.0
MAX_KEPT_BYTES = 1_600_000_000  # memory for frames that are not decoded twice: 64 RGB frames of 4K
MIN_FRAMES_PER_BAND = 50  # with "all", each frame fills one band of rows, which is twice as fast
MAX_BANDS = 12


@dataclass(frozen=True, eq=False)
class Sample:
    """The frames of a video of which a map is made, and how they are averaged."""

    read: Callable[[], Iterator[Frame]]  # reads them in order of time, each time anew
    count: int | None  # of frames; None when it is unknown
    is_kept: bool = False  # whether they are in memory already
    # n horizontal bands of the image: each pixel averages every n-th frame, which takes n times
    # less work per frame
    bands: int = 1
    plain_mean: bool = False  # whether the mean includes traffic that no detections mask


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


def sample_video(video: Video, frames: FrameCount) -> Sample:
    """Choose all frames of a video, or up to a number of them, which are decoded if they fit."""
    total = video.frame_count
    if frames == "all":
        bands = min(max((total or 0) // MIN_FRAMES_PER_BAND, 1), MAX_BANDS)
        return Sample(video.read_all, total, bands=bands, plain_mean=True)
    number = AUTO_FRAMES if frames == "auto" else frames
    if not isinstance(number, int) or number < 1:
        raise ValueError(f"frames is {frames!r}; 'auto', 'all' or a number of frames is needed")
    count = number if total is None else min(number, total)
    if 3 * video.height * video.width * count > MAX_KEPT_BYTES:
        return Sample(lambda: video.sample(number), None if total is None else count)
    kept = list(video.sample(number))
    # copies, so that what is converted of them does not stay in memory
    return Sample(lambda: map(replace, kept), len(kept), is_kept=True)


def select_registered_frames(
    frames: Iterable[Frame], registration: Registration
) -> Iterator[tuple[Frame, Float[Array, "3 3"]]]:
    """Yield the frames that are registered, each with its reference_from_frame."""
    rows = {time: row for row, time in enumerate(registration.time.tolist())}
    valid = registration.valid
    for frame in frames:
        row = rows.get(frame.time)
        if row is not None and valid[row]:
            yield frame, registration.reference_from_frame[row]
