"""Time and memory of `build_aim` beside a plain script: ORB, a homography, the median of 32 frames.

    python -m benchmarks.plain_script my_video.mp4 --json plain_script.json

Without a video, 7 s of a hover video at 1080p are made. Its packets, repeated, are a second video
of 60 s. Each runs in a process of its own, twice; the second run counts.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import UInt8
from numpy import ndarray as Array

from benchmarks.hover_videos import make_hover_video
from benchmarks.pipeline import THREADS, build, repeat_packets
from benchmarks.results import (
    JsonFile,
    measure_peak_megabytes,
    print_rows,
    run_in_process,
    write_rows,
)
from benchmarks.synthetic import write_video

SECONDS, RATE, FRAMES = 7, 30, 32
LONG_SECONDS = 60.0


def take_median(path: Path) -> UInt8[Array, "H W 3"]:
    """Take the median of frames that are registered to the first one by ORB, as scripts do."""
    capture: Any = cv2.VideoCapture(str(path))
    count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    chosen = set(np.linspace(0, count - 1, FRAMES).round().astype(int).tolist())
    orb, matcher = cv2.ORB.create(2000), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    first: Any = None
    warped: list[Any] = []
    for index in range(count):
        found, bgr = capture.read()
        if not found or index not in chosen:
            continue
        points, descriptors = orb.detectAndCompute(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), None)
        first = first or (points, descriptors)
        pairs = matcher.match(descriptors, first[1])
        source = np.array([points[pair.queryIdx].pt for pair in pairs])
        target = np.array([first[0][pair.trainIdx].pt for pair in pairs])
        matrix, _ = cv2.findHomography(source, target, cv2.RANSAC, 3.0)
        warped.append(cv2.warpPerspective(bgr, matrix, bgr.shape[1::-1]))
    return np.asarray(np.median(warped, axis=0), np.uint8)


METHODS: dict[str, Callable[[Path], Any]] = {"build_aim": build, "plain script": take_median}


def _measure(name: str, path: Path) -> dict[str, Any]:
    """Measure a method in this process."""
    cv2.setNumThreads(THREADS)
    for _ in range(2):
        start, processor = time.perf_counter(), time.process_time()
        METHODS[name](path)
        row = {"s": time.perf_counter() - start, "processor s": time.process_time() - processor}
    return {"method": name} | row | {"MiB": measure_peak_megabytes()}


def main(
    video: Annotated[Path | None, typer.Argument(help="the video; none: one is made")] = None,
    json: JsonFile = None,
) -> None:
    """Measure both on a video; print the table; write JSON if asked."""
    with TemporaryDirectory() as folder:
        if (path := video) is None:
            made = make_hover_video("00003", size="1080p", count=SECONDS * RATE, kind="queue")
            path = write_video(made, Path(folder, "clip.mp4"), megabits=20.0)

        def measure() -> Iterator[dict[str, Any]]:
            long = repeat_packets(path, Path(folder, "long.mp4"), LONG_SECONDS)
            for case, file in (("as it is", path), ("repeated to 60 s", long)):
                for name in METHODS:
                    yield {"video": case} | run_in_process(_measure, name, file)

        rows = print_rows(measure())
    write_rows(rows, json, command="python -m benchmarks.plain_script", threads=THREADS)


if __name__ == "__main__":
    typer.run(main)
