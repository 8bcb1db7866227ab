"""Short clips by keyframe spacing: decoding, all frames and sampled ones; registration with set-up.

    python -m geoaim.bench.short_clips --json docs/bench/short_clips.json

Each method runs in turn in one process; medians of wall-clock and of CPU time.
"""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from geoaim.bench.hover_videos import make_hover_video
from geoaim.bench.pipeline import THREADS, build, decode
from geoaim.bench.registration_methods import list_methods
from geoaim.bench.report import format_table, write_rows
from geoaim.mapping.registration.register import choose_reference, register_frames
from geoaim.mapping.video.video import open_video
from geoaim.synthetic import write_video

STILL = "00003"
MEGABITS = 20.0
SET_UP_FRAMES = 60
ORB = "ORB 2000 + MAGSAC"
ORB_FRAMES = 10  # each takes as long as the others


def measure_spacings(
    clip: Path, folder: Path, spacings: list[int], runs: int
) -> list[dict[str, Any]]:
    """Measure decoding, `frames="all"` and `frames="auto"` for each number of frames a keyframe.

    Args:
        clip: video that is encoded anew with each spacing.
        folder: where these videos are written.
        spacings: frames from one keyframe to the next.
        runs: timed runs of each method, in turn.

    Returns:
        Rows of the table, with seconds.
    """
    methods: dict[str, Callable[[Path], object]] = {
        "decode": decode,
        "all": lambda path: build(path, frames="all"),
        "auto": build,
    }
    rows = []
    for spacing in spacings:
        frames = (frame.image for frame in open_video(clip))
        path = write_video(
            frames, folder / f"{spacing}.mp4", megabits=MEGABITS, keyframe_interval=spacing
        )
        times = {name: np.empty((runs, 2)) for name in methods}
        for run in range(runs):
            for name, method in methods.items():
                start = np.array([time.perf_counter(), time.process_time()])
                method(path)
                times[name][run] = [time.perf_counter(), time.process_time()] - start
        for name, measured in times.items():
            wall, cpu = np.median(measured, axis=0)
            rows.append(
                {
                    "frames_per_keyframe": spacing,
                    "method": name,
                    "seconds": wall,
                    "cpu_seconds": cpu,
                }
            )
        print(format_table(rows[-len(methods) :]), flush=True)
    return rows


def measure_set_up(runs: int) -> list[dict[str, Any]]:
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


def main(
    json: Annotated[Path | None, typer.Option(help="JSON to write")] = None,
    frames: Annotated[int, typer.Option(help="frames of the clip, at 30 frames/s")] = 300,
    spacings: Annotated[
        str, typer.Option(help="frames per keyframe, comma-separated")
    ] = "1,30,300",
    runs: Annotated[int, typer.Option(help="timed runs of each method")] = 3,
    clip: Annotated[Path | None, typer.Option(help="use this file instead of making one")] = None,
) -> None:
    """Measure short clips and the set-up; print tables; write JSON if asked."""
    cv2.setNumThreads(1)
    rows = measure_set_up(runs)
    print(format_table(rows))
    cv2.setNumThreads(THREADS)
    with TemporaryDirectory() as name:
        folder = Path(name)
        source = clip or write_video(
            make_hover_video(STILL, size="1080p", count=frames, kind="queue"),
            folder / "clip.mp4",
            megabits=MEGABITS,
        )
        spaced = measure_spacings(source, folder, [int(n) for n in spacings.split(",")], runs)
    command = "python -m geoaim.bench.short_clips" + (" --clip CLIP" if clip else "")
    write_rows(rows + spaced, json, command=command, threads=THREADS, frames=frames)


if __name__ == "__main__":
    typer.run(main)
