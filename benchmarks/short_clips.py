"""Cost of `build_aim` on short clips by the interval of their keyframes, and the map's error.

    python -m benchmarks.short_clips --json docs/bench/short_clips.json

Processor time and decoded frames are measured, which a busy machine hardly changes.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import typer
from jaxtyping import UInt8
from numpy import ndarray as Array

from benchmarks.hover_videos import make_hover_video
from benchmarks.pipeline import THREADS, build, decode
from benchmarks.results import JsonFile, Row, print_rows, write_rows
from benchmarks.synthetic import write_video
from benchmarks.synthetic.camera import render_background
from geoaim.mapping.sampling import FrameCount
from geoaim.mapping.video import decoding

SIZE, MEGABITS, RATE = "1080p", 20.0, 30
# seconds of a clip, and from one keyframe to the next
CLIPS = ((2, 2), (10, 1), (10, 2), (10, 5), (10, 10))
CHOICES: tuple[FrameCount, ...] = ("auto", "all")


def measure_clip(path: Path, truth: UInt8[Array, "H W 3"]) -> Iterator[Row]:
    """Measure `build_aim` on a clip: its cost, also over that of decoding, and the map's error.

    Args:
        path: the clip.
        truth: (H, W, 3) the ground in its first frame.

    Yields:
        A row for each choice of frames.
    """
    limit = _measure_processor(decode, path)[0]
    for frames in CHOICES:
        seconds, decoded, aim = _measure_processor(partial(build, frames=frames), path)
        error = (aim.image.astype(float) - truth)[aim.coverage > 0]
        yield {
            "frames": frames,
            "decoded frames": decoded,
            "processor, s": seconds,
            "of one decoding": seconds / limit,
            "RMSE, grey levels": float(np.sqrt(np.mean(error**2))),
        }


def _measure_processor(method: Callable[[Path], Any], path: Path) -> tuple[float, int, Any]:
    """Processor seconds of a method, the number of frames that it decodes, and its result."""
    count, original = 0, decoding._decode  # noqa: SLF001

    def count_frames(codec: Any, packets: Iterator[Any]) -> Iterator[Any]:
        nonlocal count
        for frame in original(codec, packets):
            count += frame is not None
            yield frame

    with patch.object(decoding, "_decode", count_frames):
        start = time.process_time()
        result = method(path)
        return time.process_time() - start, count, result


def _measure_clips(folder: Path) -> Iterator[Row]:
    """Measure `CLIPS`, cut from one hover video with a queue."""
    count = RATE * max(duration for duration, _ in CLIPS)
    video = make_hover_video("00003", size=SIZE, count=count, kind="queue")
    pictures, truth = list(video), render_background(video.clip)
    for duration, interval in CLIPS:
        path = folder / f"{duration}_{interval}.mp4"
        frames, every = pictures[: RATE * duration], RATE * interval
        write_video(frames, path, megabits=MEGABITS, keyframe_interval=every)
        for row in measure_clip(path, truth):
            yield {"clip, s": duration, "keyframe every, s": interval, **row}


def main(json: JsonFile = None) -> None:
    """Measure short clips; print the table; write JSON if asked."""
    cv2.setNumThreads(THREADS)
    with TemporaryDirectory() as folder:
        rows = print_rows(_measure_clips(Path(folder)))
    settings = {"threads": THREADS, "size": SIZE, "megabits": MEGABITS}
    write_rows(rows, json, command="python -m benchmarks.short_clips", **settings)


if __name__ == "__main__":
    typer.run(main)
