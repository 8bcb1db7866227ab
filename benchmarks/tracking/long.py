"""Time and memory of tracking by the length of a video, with 40 vehicles in view at all times.

    python -m benchmarks.tracking.long --json tracking_long.json

30 drive on straight lanes, one after another, and 10 stand. 5 % of the boxes are missed and each
side has noise of 2 px. Each length runs in a process of its own; tracks are written as a table.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import typer

from benchmarks.results import (
    JsonFile,
    measure_peak_megabytes,
    print_rows,
    run_in_process,
    write_rows,
)
from geoaim.base.world import World
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.tracking.pipeline import track_boxes
from geoaim.tracks.files import write_tracks

FRAMES = (9_000, 36_000)  # at 30 frames/s: 5 and 20 minutes
RATE, SIZE, RESOLUTION = 30.0, (1080, 1920), 0.08
LANES, STANDING = 15, 10
CAR = np.array([4.5, 1.8]) / RESOLUTION  # pixels
MISSES, NOISE_PX = 0.05, 2.0
SPEED = 10.0  # m/s, give or take a fifth by lane


def make_boxes(frames: int, generator: np.random.Generator) -> Iterator[DetectedBoxes]:
    """Make the boxes of each frame: two vehicles on each lane, and those that stand."""
    lane = np.repeat(np.arange(LANES), 2)
    speed = SPEED / RESOLUTION * np.linspace(0.8, 1.2, LANES)[lane] * (-1.0) ** lane
    length = SIZE[1] + CAR[0]
    start = generator.uniform(0, length / 2, LANES)[lane] + np.tile([0, length / 2], LANES)
    rows = np.linspace(60, SIZE[0] - 60, LANES + 1)
    standing = np.column_stack([np.linspace(150, 1700, STANDING), np.full(STANDING, rows[-1])])
    for frame in range(frames):
        x = (start + speed * frame / RATE) % length - CAR[0] / 2
        middle = np.concatenate([np.column_stack([x, rows[lane]]), standing])
        middle = middle[generator.uniform(size=len(middle)) >= MISSES]
        boxes = np.concatenate([middle - CAR / 2, middle + CAR / 2], axis=1)
        boxes = boxes + NOISE_PX * generator.standard_normal(boxes.shape)
        boxes = boxes.clip(0, np.tile(SIZE[::-1], 2))
        boxes = boxes[(boxes[:, 2:] - boxes[:, :2]).min(axis=1) > NOISE_PX]
        yield DetectedBoxes(boxes, types=("car",) * len(boxes))


def _measure(frames: int) -> dict[str, Any]:
    """Measure one length in this process."""
    boxes = list(make_boxes(frames, np.random.default_rng(frames)))
    count = sum(len(part.boxes) for part in boxes)
    matrix = np.array([[RESOLUTION, 0, 0], [0, -RESOLUTION, 0], [0, 0, 1.0]])
    matrices = np.tile(matrix, (frames, 1, 1))
    times, before = np.arange(frames) / RATE, measure_peak_megabytes()
    start = time.process_time()
    tracks = track_boxes(boxes, matrices, times, World("EPSG:32633"), SIZE)
    tracked, peak = time.process_time(), measure_peak_megabytes()
    with TemporaryDirectory() as folder:
        write_tracks(tracks, Path(folder, "tracks.parquet"))
    return {
        "frames": frames,
        "boxes": count,
        "agents": len(tracks.ids),
        "tracking, processor s": tracked - start,
        "ms a box": 1e3 * (tracked - start) / count,
        "writing, processor s": time.process_time() - tracked,
        "MiB before": before,
        "MiB tracked": peak,
        "MiB written": measure_peak_megabytes(),
    }


def main(json: JsonFile = None) -> None:
    """Measure time and memory by length."""
    rows = print_rows(run_in_process(_measure, frames) for frames in FRAMES)
    write_rows(rows, json, command="python -m benchmarks.tracking.long")


if __name__ == "__main__":
    typer.run(main)
