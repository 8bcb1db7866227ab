"""Cost of a synthetic place: its traffic, image and video, each beside a lower bound.

    python -m geoaim.bench.generation --json docs/bench/generation.json

Lower bounds: for traffic, one NumPy addition of 40 numbers (a step makes some hundreds); for an
image, one Fourier transform of its size; for frames, one bilinear warp of the ground by OpenCV.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from geoaim.bench.report import JsonFile, format_table, time_medians, write_rows
from geoaim.geometry import to_opencv
from geoaim.synthetic import VIDEOS, draw_place, make_place, make_sample, render_frame, write_video
from geoaim.synthetic.traffic.simulate import DT, WARM_UP_S, prepare_traffic, simulate_traffic

RATES = {"usual": {}, "busy": {"lane_rate": 0.13, "pedestrian_rate": 0.26}}


def time_traffic(minutes: float, name: str, repeats: int) -> dict[str, Any]:
    """Time the traffic of a junction.

    Args:
        minutes: duration of the traffic.
        name: its density, a key of `RATES`.
        repeats: number of timed runs; the median counts.

    Returns:
        A row of the table.
    """
    model = prepare_traffic(make_place(1).roads, np.random.default_rng(0))
    some = np.ones(40)
    floor = time_medians([lambda: [np.add(some, some) for _ in range(10_000)]], 5)[0] / 10_000
    rates: dict[str, float] = dict(RATES[name])
    durations, agents = [], []
    for seed in range(repeats + 1):
        generator = np.random.default_rng(seed)
        start = time.perf_counter()
        recording = simulate_traffic(model, duration=60 * minutes, generator=generator, **rates)
        durations.append(time.perf_counter() - start)
        agents.append(
            (len(recording.vehicle_rows) + len(recording.pedestrian_rows)) / len(recording.times)
        )
    middle = float(np.median(durations[1:]))
    steps = (60 * minutes + WARM_UP_S) / DT
    return {
        "what": f"traffic, {minutes:g} min, {name}",
        "seconds": middle,
        "lower bound": "np.add of 40",
        "times the bound": middle / steps / floor,
        "more": f"{np.mean(agents[1:]):.0f} agents, {60 * minutes / middle:.0f} x real time",
    }


def time_preparation(repeats: int) -> dict[str, Any]:
    """Time the road layout and the tables that its traffic needs."""
    generator = np.random.default_rng(0)
    plan = time_medians([lambda: make_place(1)], repeats)[0]
    roads = make_place(1).roads
    tables = time_medians([lambda: prepare_traffic(roads, generator)], repeats)[0]
    return {
        "what": "layout and tables of a junction",
        "seconds": plan + tables,
        "lower bound": "-",
        "times the bound": float("nan"),
        "more": f"layout {plan:.2f} s, tables {tables:.2f} s",
    }


def time_drawing(resolution: float, repeats: int) -> dict[str, Any]:
    """Time the image of a junction."""
    place = make_place(1)
    size = draw_place(place, resolution=resolution).shape[:2]
    noise = np.random.default_rng(0).standard_normal(size)
    seconds = time_medians([lambda: draw_place(place, resolution=resolution)], repeats)[0]
    return {
        "what": f"image, {resolution:g} m/px",
        "seconds": seconds,
        "lower bound": "Fourier transform",
        "times the bound": seconds / time_medians([lambda: np.fft.rfft2(noise)], 5)[0],
        "more": f"{size[1]} x {size[0]} px, {np.prod(size) / 1e6 / seconds:.2f} Mpx/s",
    }


def time_video(size: str, count: int) -> dict[str, Any]:
    """Time the rendering and the encoding of a junction's video."""
    clip = make_sample(1, video=VIDEOS[size]).clip
    assert clip is not None
    frames, times, floors = [], [], []
    ground = np.empty((*clip.base.shape, 3), np.uint8)
    for index in range(count):
        start = time.perf_counter()
        frames.append(render_frame(clip, index))
        times.append(time.perf_counter() - start)
        matrix = clip.frame_from_background[index] @ np.linalg.inv(clip.base_from_background)
        start = time.perf_counter()
        cv2.warpPerspective(ground, to_opencv(matrix), (clip.width, clip.height))
        floors.append(time.perf_counter() - start)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "clip.mp4"
        coded = time_medians(
            [lambda: write_video(frames, path, frame_rate=clip.hover.frame_rate)], 1
        )[0]
    return {
        "what": f"{count} frames of {size}",
        "seconds": float(np.sum(times)) + coded,
        "lower bound": "warpPerspective, linear",
        "times the bound": float(np.median(times) / np.median(floors)),
        "more": f"rendering {np.sum(times):.1f} s, H.264 {coded:.1f} s",
    }


def main(
    json: JsonFile = None,
    repeats: Annotated[int, typer.Option(help="runs of each measurement; the median counts")] = 5,
    frames: Annotated[int, typer.Option(help="frames of each video")] = 100,
    threads: Annotated[int, typer.Option(help="OpenCV's threads")] = 2,
) -> None:
    """Measure all parts; print a table; write JSON if asked."""
    cv2.setNumThreads(threads)
    rows = [time_preparation(repeats)]
    rows += [time_traffic(1.0, name, repeats) for name in RATES]
    rows += [time_traffic(5.0, "usual", 2)]
    rows += [time_drawing(metres, min(repeats, 3)) for metres in (0.2, 0.1, 0.05)]
    rows += [time_video(size, frames) for size in ("720p", "1080p")]
    print(format_table(rows))
    write_rows(rows, json, command="python -m geoaim.bench.generation", repeats=repeats)


if __name__ == "__main__":
    typer.run(main)
