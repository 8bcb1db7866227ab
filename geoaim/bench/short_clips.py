"""Short clips by keyframe spacing: decoding, all frames and sampled ones; registration with set-up.

    python -m geoaim.bench.short_clips --json docs/bench/short_clips.json

Each method runs in turn in one process; medians of wall-clock and of CPU time.
"""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import typer

from geoaim.bench.hover_videos import make_hover_video
from geoaim.bench.pipeline import THREADS, build, decode
from geoaim.bench.registration_methods import list_methods
from geoaim.bench.report import JsonFile, print_rows, write_rows
from geoaim.mapping.registration.register import choose_reference, register_frames
from geoaim.mapping.video.video import open_video
from geoaim.synthetic import write_video

STILL = "00003"
MEGABITS = 20.0
FRAMES, RUNS = 300, 3  # of the clip, at 30 frames/s; timed runs of each method
METHODS = ("decode", "all", "auto")
SET_UP_FRAMES = 60
ORB = "ORB 2000 + MAGSAC"
ORB_FRAMES = 10  # each takes as long as the others


def measure_spacings(clip: Path, spacing: int, runs: int) -> list[dict[str, Any]]:
    """Measure decoding, "all" and "auto" on a clip with a keyframe every `spacing` frames.

    Args:
        clip: video that is encoded anew, beside it.
        spacing: frames from one keyframe to the next.
        runs: timed runs of each method, in turn.

    Returns:
        Rows of the table: medians of wall-clock and CPU seconds.
    """
    frames = (frame.image for frame in open_video(clip))
    path = clip.with_name(f"{spacing}.mp4")
    write_video(frames, path, megabits=MEGABITS, keyframe_interval=spacing)
    methods: list[Callable[[], object]] = [
        lambda: decode(path),
        lambda: build(path, frames="all"),
        lambda: build(path),
    ]
    times = np.empty((len(methods), runs, 2))
    for run in range(runs):
        for number, method in enumerate(methods):
            start = np.array([time.perf_counter(), time.process_time()])
            method()
            times[number, run] = [time.perf_counter(), time.process_time()] - start
    return [
        {"frames_per_keyframe": spacing, "method": name, "seconds": wall, "cpu_seconds": cpu}
        for name, (wall, cpu) in zip(METHODS, np.median(times, axis=1), strict=True)
    ]


def _measure_set_up(runs: int) -> list[dict[str, Any]]:
    """Measure registration of 60 raw frames with its set-up against ORB, on one thread; medians."""
    frames = list(make_hover_video(STILL, size="1080p", count=SET_UP_FRAMES))
    _, orb_seconds = list_methods()[ORB](frames[:ORB_FRAMES], [])
    orb = float(np.median(orb_seconds))
    rows = []
    for name, reference_time in (("the first frame", 0.0), ("chosen", None)):
        seconds = np.empty((runs, 2))
        for run in range(runs):
            start = time.perf_counter()
            reference = choose_reference(open_video(frames), time=reference_time)
            ready = time.perf_counter()
            for _ in register_frames(open_video(frames), reference):
                pass
            seconds[run] = ready - start, time.perf_counter() - ready
        set_up, registration = np.median(seconds, axis=0)
        each = registration / len(frames)
        rows.append(
            {
                "reference": name,
                "set_up_in_frames": set_up / each,
                "rate_of_frames_over_orb": orb / each,
                "rate_with_set_up_over_orb": orb * len(frames) / (set_up + registration),
            }
        )
    return rows


def main(json: JsonFile = None) -> None:
    """Measure short clips and the set-up; print tables; write JSON if asked."""
    cv2.setNumThreads(1)
    rows = print_rows(_measure_set_up(RUNS))
    cv2.setNumThreads(THREADS)
    with TemporaryDirectory() as folder:
        video = make_hover_video(STILL, size="1080p", count=FRAMES, kind="queue")
        clip = write_video(video, Path(folder, "clip.mp4"), megabits=MEGABITS)
        for spacing in (1, 30, FRAMES):
            rows += print_rows(measure_spacings(clip, spacing, RUNS))
    write_rows(rows, json, command="python -m geoaim.bench.short_clips", threads=THREADS)


if __name__ == "__main__":
    typer.run(main)
