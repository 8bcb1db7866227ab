"""Standing queues without boxes: error, doubt and time of each background method.

    python -m geoaim.bench.background_queues -o docs/bench

Three generators that share no code, of 32 registered frames each, in which queues stand for 60 % of
the time and further cars follow when they leave. The rules were chosen on seeds 0 and 1 of
minsk_junction, munich_mos074, the drawn road and the hover video; these figures are of other seeds,
and of a place (munich_street02) that was kept for them.
"""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
import typer
from jaxtyping import UInt8
from numpy import ndarray as Array
from scipy.stats import trim_mean

from geoaim.bench.drawn_queue import draw_queue
from geoaim.bench.hover_videos import make_hover_video
from geoaim.bench.queue_clips import QueueClip, paste_queue
from geoaim.bench.report import Row, format_table, print_rows, write_rows
from geoaim.mapping import remove_traffic
from geoaim.mapping.background.running_mean import Background
from geoaim.mapping.background.warping import warp
from geoaim.mapping.video.frames import Frame
from geoaim.synthetic import measure_traffic_share, reference_from_frames, render_background

STANDING = 0.6  # share of the time
STOOD = 0.3  # share of the frames from which traffic counts as standing
WRONG = 25  # grey levels by which a pixel is off
CROP = np.s_[90:630, 160:1120]  # of a hover video, without the rim that drift uncovers

Stack = UInt8[Array, "K h w 3"]


def _film_queue(seed: int, count: int = 32) -> QueueClip:
    """Register frames of the hover video "queue" over a still by their true transforms."""
    video = make_hover_video("00003", size="720p", count=600, kind="queue", seed=seed)
    transforms = reference_from_frames(video.clip)
    chosen = np.linspace(0, len(video) - 1, count).round().astype(int)
    frames = [warp(video[i], transforms[i], (720, 1280))[CROP] for i in chosen]
    share = measure_traffic_share(video.clip)[CROP]
    return QueueClip(np.stack(frames), render_background(video.clip, 0)[CROP], share)


CLIPS: dict[str, Callable[[int], QueueClip]] = {
    "hover video": _film_queue,
    "pasted on minsk_junction": lambda seed: paste_queue(
        "minsk_junction", standing=STANDING, seed=seed
    ),
    "pasted on munich_street02": lambda seed: paste_queue(
        "munich_street02", standing=STANDING, seed=seed
    ),
    "drawn": lambda seed: draw_queue(standing=STANDING, seed=seed),
}


def _without_boxes(frames: Stack) -> Background:
    registered = [(Frame(i, float(i), None, image), np.eye(3)) for i, image in enumerate(frames)]
    return remove_traffic(registered, size=frames.shape[1:3])


SUBTRACTORS: dict[str, Callable[[], Any]] = {
    "MOG2": lambda: cv2.createBackgroundSubtractorMOG2(history=64, detectShadows=False),
    "KNN": lambda: cv2.createBackgroundSubtractorKNN(history=64, detectShadows=False),
    "GSOC": cv2.bgsegm.createBackgroundSubtractorGSOC,
}


def apply_subtractor(name: str, frames: Iterable[Array]) -> UInt8[Array, "H W 3"]:
    """Compute the background of uint8 frames by one of OpenCV's models, a key of `SUBTRACTORS`."""
    subtractor = SUBTRACTORS[name]()
    for image in frames:
        subtractor.apply(image)
    return np.asarray(subtractor.getBackgroundImage(), np.uint8)


METHODS: dict[str, Callable[[Stack], Any]] = {
    "without boxes": _without_boxes,
    "mean": lambda frames: frames.mean(axis=0),
    "trimmed mean": lambda frames: trim_mean(frames, 0.2, axis=0),
    "median": lambda frames: np.median(frames, axis=0),
    **{name: partial(apply_subtractor, name) for name in SUBTRACTORS},
}


def measure_queue(clip: QueueClip, method: Callable[[Stack], Any]) -> Row:
    """Measure a method on a clip: error where queues stood, and what is marked contested.

    Returns:
        RMSE (grey levels), wrong % of pixels, seconds, and the % of wrong and of good pixels that
        are marked: NaN of methods that mark none.
    """
    start = time.perf_counter()
    result = method(clip.frames)
    seconds = time.perf_counter() - start
    image = result.image if isinstance(result, Background) else np.rint(result)
    error = np.abs(image.astype(np.float32) - clip.ground)
    wrong, stood = error.max(axis=-1) > WRONG, clip.share >= STOOD
    row = {
        "RMSE": float(np.sqrt((error[stood] ** 2).mean())),
        "wrong %": 100 * float(wrong[stood].mean()),
        "seconds": seconds,
        "wrong marked %": np.nan,
        "good marked %": np.nan,
    }
    if isinstance(result, Background):
        if wrong.any():
            row["wrong marked %"] = 100 * float(result.contested[wrong].mean())
        row["good marked %"] = 100 * float(result.contested[~wrong].mean())
    return row


def _measure_clips(seeds: list[int]) -> Iterator[Row]:
    for name, make in CLIPS.items():
        for seed in seeds:
            clip = make(seed)
            for method, compute in METHODS.items():
                yield {"clip": name, "seed": seed, "method": method, **measure_queue(clip, compute)}


def draw_error_against_time(rows: list[Row], path: Path) -> None:
    """Draw each method's median error against its median time, as SVG and PNG beside `path`."""
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for method in METHODS:
        own = [row for row in rows if row["method"] == method]
        x, y = (float(np.median([row[key] for row in own])) for key in ("seconds", "RMSE"))
        axes.plot(x, y, "o", color="tab:red" if method == "without boxes" else "tab:gray")
        axes.annotate(method, (x, y), xytext=(5, 4), textcoords="offset points")
    axes.set(xscale="log", ylim=(0, None), xlabel="seconds for 32 frames of 960 x 540")
    axes.set_ylabel("RMSE where queues stood, grey levels")
    axes.margins(x=0.2)
    for suffix in (".svg", ".png"):
        figure.savefig(path.with_suffix(suffix), dpi=120)
    plt.close(figure)


def main(
    output: Annotated[Path, typer.Option("-o", help="folder to write to")],
    seeds: Annotated[str, typer.Option(help="comma-separated")] = "2,3",
) -> None:
    """Measure all methods on all clips; write JSON, Markdown and the chart."""
    cv2.setNumThreads(1)
    rows = print_rows(_measure_clips([int(seed) for seed in seeds.split(",")]))
    output.mkdir(parents=True, exist_ok=True)
    path = output / "background_queues.json"
    command = " ".join(["python -m geoaim.bench.background_queues", *sys.argv[1:]])
    write_rows(rows, path, command=command, standing=STANDING)
    path.with_suffix(".md").write_text(format_table(rows) + "\n", encoding="utf-8")
    draw_error_against_time(rows, path)


if __name__ == "__main__":
    typer.run(main)
