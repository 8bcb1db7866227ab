"""The whole way, H.264 file to AIM, against decoding alone; and what length costs.

    python -m geoaim.bench.pipeline --json docs/bench/pipeline.json

The long files repeat one made clip's packets, so that ten minutes of 4K take seconds to make.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import av
import cv2
import numpy as np
import typer

from geoaim.bench.hover_videos import make_hover_video
from geoaim.bench.report import format_table, measure_peak_megabytes, write_rows
from geoaim.geometry import transform_points
from geoaim.mapping.background.estimate import average_frames
from geoaim.mapping.pipeline import build_aim
from geoaim.mapping.registration.register import choose_reference, place_frames
from geoaim.mapping.video.video import open_video
from geoaim.synthetic import write_video

THREADS = 2
GROUND = np.array([[0.04, 0, 0], [0, -0.04, 0], [0, 0, 1.0]])


def decode(path: Path) -> int:
    """Decode all frames and do nothing with them."""
    return sum(1 for _ in open_video(path, threads=THREADS))


def mean_of_all(path: Path) -> int:
    """Register every frame and average every one, all rows of it."""
    return _mean(path, bands=1)


def mean_of_bands(path: Path) -> int:
    """Register every frame; each adds one of 12 stripes: a pixel averages every twelfth frame."""
    return _mean(path, bands=12)


def register_all(path: Path) -> int:
    """Register every frame, and no more."""
    video = open_video(path, threads=THREADS)
    return sum(1 for _ in place_frames(video, choose_reference(video)))


def _mean(path: Path, *, bands: int) -> int:
    video = open_video(path, threads=THREADS)
    reference = choose_reference(video)
    placements = place_frames(video, reference)
    frames = ((frame, placement.matrix) for frame, placement in placements if placement.valid)
    size = reference.height, reference.width
    return average_frames(frames, size=size, bands=bands).frames_used


def opencv_script(path: Path) -> int:
    """What a script does: VideoCapture, ORB 2000, MAGSAC++, warp, accumulate, every frame."""
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


def throughput(path: Path, runs: int) -> list[dict[str, Any]]:
    """Frames a second of each way, in turn, its setup included; medians, share of decode-only."""
    ways: list[Callable[[Path], int]] = [
        decode,
        register_all,
        mean_of_bands,
        mean_of_all,
        opencv_script,
    ]
    rates: dict[str, list[float]] = {way.__name__: [] for way in ways}
    decode(path)  # warms the file's pages
    for run in range(runs):
        for way in ways:
            if way is opencv_script and run > 0:  # slow
                continue
            start = time.perf_counter()
            count = way(path)
            rates[way.__name__].append(count / (time.perf_counter() - start))
    limit = float(np.median(rates["decode"]))
    return [
        {
            "way": name,
            "frames_per_s": float(np.median(measured)),
            "share_of_decode_only": float(np.median(measured)) / limit,
        }
        for name, measured in rates.items()
    ]


def length(clip: Path, folder: Path, minutes: list[int]) -> list[dict[str, Any]]:
    """Seconds and peak memory of build_aim and of decoding, each in a process of its own."""
    rows = []
    for duration in minutes:
        path = repeat_packets(clip, folder / f"{duration}min.mp4", 60.0 * duration)
        for way in ("build_aim", "decode"):
            seconds, peak = _in_process(way, path)
            row = {"minutes": duration, "way": way, "seconds": seconds, "peak_rss_mb": peak}
            rows.append(row)
            print(format_table(rows[-1:]).splitlines()[-1], flush=True)
        path.unlink()
    return rows


def repeat_packets(clip: Path, path: Path, seconds: float) -> Path:
    """Copy the packets of a clip again and again, without decoding them."""
    with av.open(str(path), "w") as out:
        copied: Any = None
        offset = 0
        while True:
            with av.open(str(clip)) as container:
                stream = container.streams.video[0]
                copied = copied or out.add_stream_from_template(stream)
                span = int(stream.duration or 0)
                if stream.time_base is None or offset * stream.time_base >= seconds:
                    return path
                for packet in container.demux(stream):
                    if packet.dts is not None and packet.pts is not None:
                        packet.pts += offset
                        packet.dts += offset
                        packet.stream = copied
                        out.mux(packet)
                offset += span


def _in_process(way: str, path: Path) -> tuple[float, float]:
    command = [sys.executable, "-m", "geoaim.bench.pipeline", "--one", way, "--clip", str(path)]
    seconds, peak = subprocess.run(
        command, check=True, capture_output=True, text=True
    ).stdout.split()[-2:]
    return float(seconds), float(peak)


def _run_one(way: str, path: Path) -> None:
    """One measurement, printed as seconds and peak megabytes."""
    start = time.perf_counter()
    if way == "decode":
        decode(path)
    else:
        video = open_video(path, threads=THREADS)
        pixels = np.array([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9], [0.5, 0.5]])
        pixels *= [video.width, video.height]
        places = transform_points(GROUND, pixels)
        keys = ("u", "v", "x", "y", "crs")
        both = zip(pixels, places, strict=True)
        build_aim(video, [dict(zip(keys, (*p, *q, "local"), strict=True)) for p, q in both])
    print(time.perf_counter() - start, measure_peak_megabytes())


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    size: Annotated[str, typer.Option(help="of the made clip")] = "4k",
    frames: Annotated[int, typer.Option(help="of the made clip, 30 a second")] = 150,
    megabits: Annotated[float, typer.Option(help="a second; drones record 4K at 60 to 100")] = 60.0,
    seconds: Annotated[float, typer.Option(help="of the video for throughput")] = 20.0,
    runs: Annotated[int, typer.Option(help="counted, in turn")] = 2,
    minutes: Annotated[str, typer.Option(help="lengths to compare, or nothing")] = "1,10",
    one: Annotated[str, typer.Option(hidden=True)] = "",
    clip: Annotated[Path | None, typer.Option(help="use this file instead of making one")] = None,
) -> None:
    """Measure throughput and length; print tables, and write JSON when asked."""
    cv2.setNumThreads(THREADS)
    if one and clip:
        _run_one(one, clip)
        return
    with TemporaryDirectory() as name:
        folder = Path(name)
        video = clip or write_video(
            make_hover_video("00003", size=size, count=frames, kind="queue"),
            folder / "clip.mp4",
            megabits=megabits,
        )
        rates = throughput(repeat_packets(video, folder / "short.mp4", seconds), runs)
        print(format_table(rates))
        lasting = length(video, folder, [int(m) for m in minutes.split(",") if m])
        command = "python -m geoaim.bench.pipeline"
        write_rows(
            rates,
            json,
            command=command,
            threads=THREADS,
            size=size,
            megabits=megabits,
            seconds=seconds,
            length=lasting,
        )


if __name__ == "__main__":
    typer.run(main)
