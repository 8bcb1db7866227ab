"""Throughput of the mapping pipeline against decoding alone, and its cost by video length.

    python -m benchmarks.pipeline --json docs/bench/pipeline.json

Long files repeat the packets of one rendered clip, so that ten minutes of 4K take seconds to make.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import av
import cv2
import numpy as np
import typer

from benchmarks.hover_videos import make_hover_video
from benchmarks.results import (
    JsonFile,
    measure_peak_megabytes,
    print_rows,
    run_in_process,
    write_rows,
)
from benchmarks.synthetic import write_video
from geoaim.aim.aim import AIM
from geoaim.base.geometry import transform_points
from geoaim.mapping.background.running_mean import average_frames
from geoaim.mapping.pipeline import build_aim
from geoaim.mapping.registration.register import choose_reference, register_frames
from geoaim.mapping.sampling import FrameCount
from geoaim.mapping.video.video import open_video

THREADS = 2
SIZE, FRAMES = "4k", 90  # size and length of the rendered clip, at 30 frames/s
DURATION = 20.0  # s of the video whose throughput is measured
MINUTES = (1, 10)  # durations of the videos that are built
MEGABITS = 60.0  # Mbit/s of the clip; drones record 4K at 60 to 100
GROUND = np.array([[0.04, 0, 0], [0, -0.04, 0], [0, 0, 1.0]])


def decode(path: Path) -> int:
    """Decode all frames and return their number."""
    return sum(1 for _ in open_video(path, threads=THREADS))


def register_all(path: Path) -> int:
    """Register all frames and return their number."""
    video = open_video(path, threads=THREADS)
    return sum(1 for _ in register_frames(video, choose_reference(video)))


def average(path: Path, bands: int) -> int:
    """Register all frames and average them in `bands`, as `average_frames` does; return a count."""
    video = open_video(path, threads=THREADS)
    reference = choose_reference(video)
    frames = (
        (frame, placement.reference_from_frame)
        for frame, placement in register_frames(video, reference)
        if placement.valid
    )
    size = reference.height, reference.width
    return average_frames(frames, size=size, bands=bands).frames_used


def _run_opencv_script(path: Path) -> int:
    """Average all frames as scripts do: VideoCapture, ORB, MAGSAC++, warp, accumulate."""
    capture = cv2.VideoCapture(str(path))
    orb, matcher = cv2.ORB.create(2000), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    first: Any = None
    total: Any = None
    count = 0
    while True:
        found, bgr = capture.read()
        if not found:
            return count
        points, descriptors = orb.detectAndCompute(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), None)
        if first is None:
            first, total = (points, descriptors), np.zeros(bgr.shape, np.float32)
        pairs = matcher.match(descriptors, first[1])
        source = np.array([points[pair.queryIdx].pt for pair in pairs])
        target = np.array([first[0][pair.trainIdx].pt for pair in pairs])
        matrix, _ = cv2.findHomography(source, target, cv2.USAC_MAGSAC, 2.0)
        cv2.accumulate(cv2.warpPerspective(bgr, matrix, bgr.shape[1::-1]), total)
        count += 1


METHODS: dict[str, Callable[[Path], int]] = {
    "decode": decode,
    "register_all": register_all,
    "average_bands": partial(average, bands=12),  # every twelfth frame for a pixel
    "average_all": partial(average, bands=1),
    "run_opencv_script": _run_opencv_script,
}


def measure_throughput(path: Path) -> Iterator[dict[str, Any]]:
    """Measure the frames per second of each method in one run, set-up included."""
    decode(path)  # fills the page cache
    limit = np.nan
    for name, method in METHODS.items():
        start = time.perf_counter()
        count = method(path)
        rate = count / (time.perf_counter() - start)
        limit = rate if method is decode else limit
        yield {"method": name, "frames_per_s": rate, "share_of_decode_only": rate / limit}


def _measure_lengths(clip: Path) -> Iterator[dict[str, Any]]:
    """Measure seconds and peak MiB of `build_aim` and of decoding, each in its own process."""
    for minute in MINUTES:
        path = repeat_packets(clip, clip.with_name(f"{minute}min.mp4"), 60.0 * minute)
        for method in (build, decode):
            seconds, peak = run_in_process(_measure_cost, method, path)
            row = {"minutes": minute, "method": "build_aim" if method is build else "decode"}
            yield row | {"seconds": seconds, "peak_rss_mb": peak}
        path.unlink()


def repeat_packets(clip: Path, path: Path, duration: float) -> Path:
    """Repeat the packets of a clip without decoding them.

    Args:
        clip: video to repeat.
        path: video to write.
        duration: duration of the video to write, seconds.

    Returns:
        `path`.
    """
    with av.open(str(path), "w") as out:
        copied: Any = None
        offset = 0
        while True:
            with av.open(str(clip)) as container:
                stream = container.streams.video[0]
                copied = copied or out.add_stream_from_template(stream)
                span = int(stream.duration or 0)
                if stream.time_base is None or offset * stream.time_base >= duration:
                    return path
                for packet in container.demux(stream):
                    if packet.dts is not None and packet.pts is not None:
                        packet.pts += offset
                        packet.dts += offset
                        packet.stream = copied
                        out.mux(packet)
                offset += span


def build(path: Path, *, frames: FrameCount = "auto") -> AIM:
    """Build an AIM of a video with five made-up control points."""
    video = open_video(path, threads=THREADS)
    pixels = np.array([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9], [0.5, 0.5]])
    pixels *= [video.width, video.height]
    points = np.hstack([pixels, transform_points(GROUND, pixels)])
    gcps = [dict(zip("uvxy", row, strict=True), crs="local") for row in points]
    return build_aim(video, gcps, frames=frames)


def _measure_cost(method: Callable[[Path], object], path: Path) -> tuple[float, float]:
    """Measure the seconds of a method and the peak MiB of this process."""
    cv2.setNumThreads(THREADS)
    start = time.perf_counter()
    method(path)
    return time.perf_counter() - start, measure_peak_megabytes()


def main(json: JsonFile = None) -> None:
    """Measure throughput and the cost of length; print tables; write JSON if asked."""
    cv2.setNumThreads(THREADS)
    with TemporaryDirectory() as folder:
        video = make_hover_video("00003", size=SIZE, count=FRAMES, kind="queue")
        clip = write_video(video, Path(folder, "clip.mp4"), megabits=MEGABITS)
        short = repeat_packets(clip, clip.with_name("short.mp4"), DURATION)
        rates = print_rows(measure_throughput(short))
        lengths = print_rows(_measure_lengths(clip))
    settings = {"threads": THREADS, "size": SIZE, "megabits": MEGABITS, "duration": DURATION}
    command = "python -m benchmarks.pipeline"
    write_rows(rates, json, command=command, **settings, lengths=lengths)


if __name__ == "__main__":
    typer.run(main)
