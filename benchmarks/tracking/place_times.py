"""The time that `geoaim place` takes for a minute of video, by stage.

    python -m benchmarks.tracking.place_times --json docs/bench/place_times.json

A drawn junction is filmed in 1080p; the packets of 15 s are repeated for a minute, and nothing else
is known of it. One process with one thread. Each stage's time is that between its reports of
progress, so that what comes before its first report counts to it.
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import torch
import typer

from benchmarks.pipeline import repeat_packets
from benchmarks.results import JsonFile, measure_peak_megabytes, print_rows, write_rows
from benchmarks.synthetic.camera import render_frames
from benchmarks.synthetic.sample import HOVER, VIDEOS, make_sample
from benchmarks.tracking.benchmark import TEST_SEED
from geoaim.base.encode import write_video
from geoaim.mapping.video.video import open_video
from geoaim.pipeline import place_video

CLIP_SECONDS, SECONDS = 15.0, 60.0


def film_minute(folder: Path) -> Path:
    """Film a drawn junction for a minute that repeats itself."""
    hover = replace(HOVER, count=round(CLIP_SECONDS * HOVER.frame_rate))
    size = VIDEOS["1080p"]
    sample = make_sample(TEST_SEED, minutes=CLIP_SECONDS / 60, video=size, hover=hover)
    assert sample.clip is not None
    frames = render_frames(sample.clip)
    clip = write_video(frames, folder / "clip.mp4", frame_rate=hover.frame_rate, crf=26)
    return repeat_packets(clip, folder / "minute.mp4", SECONDS)


def time_stages(video: Path, folder: Path) -> dict[str, tuple[float, float]]:
    """Take a video all the way; elapsed and processor seconds of each stage."""
    stages: dict[str, tuple[float, float]] = {}
    last = time.perf_counter(), time.process_time()

    def report(stage: str, done: float, total: float | None) -> None:
        nonlocal last
        now = time.perf_counter(), time.process_time()
        before = stages.get(stage, (0.0, 0.0))
        stages[stage] = before[0] + now[0] - last[0], before[1] + now[1] - last[1]
        last = now

    place_video(open_video(video, threads=1), folder, progress=report)
    report("write", 1, 1)
    return stages


def main(json: JsonFile = None) -> None:
    """Time a minute of video of which nothing is known."""
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        stages = time_stages(film_minute(Path(name)), Path(name, "place"))
    elapsed, spent = (sum(times) for times in zip(*stages.values(), strict=True))
    stages["all"] = elapsed, spent
    rows: list[dict[str, Any]] = [
        {"stage": stage, "s": one, "processor s": other, "per second of video": other / SECONDS}
        for stage, (one, other) in stages.items()
    ]
    print_rows(rows)
    settings = {"seconds": SECONDS, "peak MiB": measure_peak_megabytes()}
    write_rows(rows, json, command="python -m benchmarks.tracking.place_times", **settings)


if __name__ == "__main__":
    typer.run(main)
