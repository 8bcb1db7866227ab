"""The time that `geoaim place` takes for a minute of video, by stage.

    python -m benchmarks.tracking.place_times --json docs/bench/place_times.json

A drawn place is filmed for a minute in 1080p, and taken all the way by one process with one thread.
Each stage's time is that between its reports of progress, so that what comes before its first
report counts to it.
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import torch
import typer

from benchmarks.results import JsonFile, measure_peak_megabytes, print_rows, write_rows
from benchmarks.synthetic.camera import render_frames
from benchmarks.synthetic.sample import HOVER, VIDEOS, make_sample
from benchmarks.tracking.benchmark import TEST_SEED
from geoaim.base.encode import write_video
from geoaim.mapping.video.video import open_video
from geoaim.pipeline import Evidence, place_video

SECONDS, RESOLUTION = 60.0, 0.0876  # metres per pixel of the frames, of the second way


def film_minute(path: Path) -> None:
    """Film a drawn junction."""
    hover = replace(HOVER, count=round(SECONDS * HOVER.frame_rate))
    size = VIDEOS["1080p"]
    sample = make_sample(TEST_SEED, minutes=SECONDS / 60, video=size, hover=hover)
    assert sample.clip is not None
    write_video(render_frames(sample.clip), path, frame_rate=hover.frame_rate, crf=26)


def time_stages(video: Path, folder: Path, evidence: Evidence) -> dict[str, tuple[float, float]]:
    """Take a video all the way; elapsed and processor seconds of each stage."""
    stages: dict[str, tuple[float, float]] = {}
    clocks = time.perf_counter, time.process_time
    last = [clock() for clock in clocks]

    def report(stage: str, done: float, total: float | None) -> None:
        now = [clock() for clock in clocks]
        before = stages.get(stage, (0.0, 0.0))
        stages[stage] = before[0] + now[0] - last[0], before[1] + now[1] - last[1]
        last[:] = now

    place_video(open_video(video, threads=1), folder, evidence, progress=report)
    report("write", 1, 1)
    return stages


def main(json: JsonFile = None) -> None:
    """Time a minute of video without any evidence, and with its scale known."""
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        video = Path(name, "minute.mp4")
        film_minute(video)
        for way, evidence in (
            ("nothing known", Evidence()),
            ("its scale known", Evidence(frame_resolution=RESOLUTION)),
        ):
            stages = time_stages(video, Path(name, way), evidence)
            stages["all"] = tuple(map(sum, zip(*stages.values(), strict=True)))  # type: ignore[assignment]
            rows += [
                {"way": way, "stage": stage, "s": elapsed, "processor s": spent}
                for stage, (elapsed, spent) in stages.items()
            ]
            rows[-1]["processor s a second of video"] = rows[-1]["processor s"] / SECONDS
    print_rows(rows)
    settings = {"seconds": SECONDS, "peak MiB": measure_peak_megabytes()}
    write_rows(rows, json, command="python -m benchmarks.tracking.place_times", **settings)


if __name__ == "__main__":
    typer.run(main)
