"""Which frames of a video are used, and in what order: each laid on the reference once."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.mapping.registration.keyframes import Placement
from geoaim.mapping.registration.register import Reference, place_frames
from geoaim.mapping.video.detections import Boxes
from geoaim.mapping.video.video import Frame, Video
from geoaim.progress import Progress

Count = int | Literal["auto", "all"]
FIRST_BATCH = 16  # frames of "auto"; doubled until the background has converged
MOST = 64  # frames of "auto"


@dataclass(frozen=True, eq=False)
class RegisteredFrames:
    """Valid frames and their places; re-iterable: each frame is laid on the reference once.

    They come in batches, each spread over the whole video and as large as all before it.
    """

    video: Video
    reference: Reference
    boxes: Boxes | None
    count: Count
    progress: Progress
    placed: dict[float, Placement] = field(default_factory=dict)
    rows: list[tuple[int, float, Placement]] = field(default_factory=list)

    def __iter__(self) -> Iterator[tuple[Frame, Float[Array, "3 3"]]]:
        total = self._total()
        stage = "average" if self.rows else "register"
        for read, (frame, placement) in enumerate(self._placements(), 1):
            self.progress(stage, read, total)
            if placement.valid:
                yield frame, placement.matrix

    def _placements(self) -> Iterator[tuple[Frame, Placement]]:
        again = bool(self.rows)
        for batch in self._batches():
            if again:
                yield from ((f, self.placed[f.time]) for f in batch if f.time in self.placed)
                continue
            for frame, placement in place_frames(batch, self.reference, boxes=self.boxes):
                self.placed[frame.time] = placement
                self.rows.append((frame.index, frame.time, placement))
                yield frame, placement

    def _batches(self) -> Iterator[Iterator[Frame]]:
        total = self.video.frame_count
        if self.count == "all" or (total is not None and total <= FIRST_BATCH):
            yield iter(self.video)
            return
        if isinstance(self.count, int) or total is None:
            yield self.video.sampled(MOST if self.count == "auto" else int(self.count))
            return
        read: set[float] = set()
        for times, spacing in _batch_times(self.video.duration):
            # a keyframe within half a step is taken in place of the wanted frame
            yield _unread(self.video.read_at(times, spacing / 2), read)

    def _total(self) -> float | None:
        if self.count == "all" or self.video.frame_count is None:
            return self.video.frame_count
        most = MOST if self.count == "auto" else self.count
        return min(most, self.video.frame_count)


def _batch_times(duration: float) -> Iterator[tuple[Float[Array, " n"], float]]:
    """Times of each batch, seconds, and the spacing between all that were read so far."""
    whole = duration * (1 - 1e-6)
    count = FIRST_BATCH
    yield np.linspace(0, whole, count, endpoint=False), whole / count
    while 2 * count <= MOST:
        yield (np.arange(count) + 0.5) * whole / count, whole / count / 2
        count *= 2


def _unread(frames: Iterator[Frame], read: set[float]) -> Iterator[Frame]:
    for frame in frames:
        if frame.time not in read:
            read.add(frame.time)
            yield frame
