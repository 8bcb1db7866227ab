"""Backgrounds against exact truth at 4K: error, sharpness, time and memory of each method.

    python -m geoaim.bench.background --json docs/bench/background.json

The synthetic video ("queue") has traffic over a fifth of the frame and queues that stand for 60 %
of the time. Every method reads the same H.264 frames, sampled over the clip, with true transforms,
in a process of its own. Real sequences have no truth: there methods are compared with each other.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import typer
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.bench.background_queues import apply_subtractor
from geoaim.bench.data import require_data
from geoaim.bench.hover_videos import make_hover_video
from geoaim.bench.report import (
    JsonFile,
    measure_peak_megabytes,
    print_rows,
    run_in_process,
    write_rows,
)
from geoaim.bench.stills import STILLS
from geoaim.encode import write_video
from geoaim.mapping.background.exposure import apply_gain, estimate_gain, start_exposure
from geoaim.mapping.background.running_mean import Background, average_frames
from geoaim.mapping.background.traffic_search import remove_traffic
from geoaim.mapping.background.warping import warp
from geoaim.mapping.registration.register import register
from geoaim.mapping.video.detections import Detections, read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import open_video
from geoaim.synthetic import (
    list_boxes,
    measure_traffic_share,
    reference_from_frames,
    render_background,
)

Image = UInt8[Array, "H W 3"]

SIZE, FRAMES = "4k", 60  # of the synthetic videos, and frames sampled over each
THREADS = 2  # of OpenCV and of the decoder
MARGIN_PX = 100  # left out of the figures: the camera's drift leaves the rim to fewer frames
MIN_STANDING_SHARE = 0.3  # of the time, from which traffic counts as standing


@dataclass(frozen=True, eq=False)
class _RegisteredFrames:
    """Frames of a video with their transforms, in an order that spreads over it; re-iterable."""

    video: Iterable[Frame]  # the frames
    size: tuple[int, int]  # (height, width) of the frames
    reference_from_frame: Float[Array, "T 3 3"]  # of each frame, by its index
    detections: Detections | None = None  # boxes of vehicles, or None

    def __iter__(self) -> Iterator[tuple[Frame, Float[Array, "3 3"]]]:
        return ((frame, self.reference_from_frame[frame.index]) for frame in self.video)


def _compute_median(frames: _RegisteredFrames) -> Image:
    """numpy.median of all warped frames, held in memory, 64 rows at a time."""
    stack = list(_warp_frames(frames))
    result = np.empty((*frames.size, 3), np.uint8)
    for row in range(0, frames.size[0], 64):
        part = np.stack([image[row : row + 64] for image in stack])
        result[row : row + 64] = np.rint(np.median(part, axis=0))
    return result


METHODS: dict[str, Callable[[_RegisteredFrames], Any]] = {
    "plain mean": lambda frames: average_frames(frames, size=frames.size),
    "mean masked by boxes": lambda frames: average_frames(
        frames, size=frames.size, detections=frames.detections
    ),
    "without boxes": lambda frames: remove_traffic(frames, size=frames.size),
    "numpy median": _compute_median,
    "MOG2": lambda frames: apply_subtractor("MOG2", _warp_frames(frames)),
    "GSOC": lambda frames: apply_subtractor("GSOC", _warp_frames(frames)),
}


def _warp_frames(frames: _RegisteredFrames) -> Iterator[Image]:
    """Frames as RGB, warped to the reference at one exposure, for the other methods."""
    exposure = start_exposure(frames.size)
    for frame, matrix in frames:
        gain = estimate_gain(exposure, frame, matrix)
        yield apply_gain(warp(frame.image, matrix, frames.size), gain, 0.0)


def _spread_indices(count: int) -> list[int]:
    """The numbers below `count`, every first part spread over the whole (van der Corput)."""
    digits = max(count - 1, 0).bit_length()
    return sorted(range(count), key=lambda index: int(f"{index:0{digits}b}"[::-1], 2))


def _write_input(still: str, folder: Path) -> None:
    """Encode frames sampled over a synthetic clip of 20 s, and write the truth beside them."""
    video = make_hover_video(still, size=SIZE, count=600, kind="queue")
    order = np.linspace(0, len(video) - 1, FRAMES).round().astype(int)[_spread_indices(FRAMES)]
    write_video((video[index] for index in order), folder / "frames.mp4", frame_rate=1)
    boxes = [np.insert(list_boxes(video.clip, i), 0, n, axis=1) for n, i in enumerate(order)]
    np.savez(
        folder / "truth.npz",
        # the first frame in order is the reference
        reference_from_frame=reference_from_frames(video.clip)[order],
        boxes=np.concatenate(boxes),
        clean=render_background(video.clip, 0),
        share=measure_traffic_share(video.clip),
    )


def _read_input(folder: Path) -> tuple[_RegisteredFrames, Any]:
    """The frames that `_write_input` wrote, and the arrays of the truth."""
    truth = np.load(folder / "truth.npz")
    boxes = truth["boxes"]
    video = open_video(folder / "frames.mp4", threads=cv2.getNumThreads())
    by_frame = read_detections([boxes[boxes[:, 0] == i, 1:] for i in range(len(boxes))])
    size = video.height, video.width
    return _RegisteredFrames(video, size, truth["reference_from_frame"], by_frame), truth


def _run_method(name: str, folder: Path) -> dict[str, Any]:
    """Run one method in this process and measure it against the truth: a row of the table."""
    cv2.setNumThreads(THREADS)
    frames, truth = _read_input(folder)
    start = time.perf_counter()
    result = METHODS[name](frames)
    seconds = time.perf_counter() - start
    peak = measure_peak_megabytes()
    image = result.image if isinstance(result, Background) else result
    clean, zones = truth["clean"], _divide_zones(truth["share"])
    error = (image.astype(np.float32) - clean) ** 2
    first = next(iter(frames))[0].image
    energy = _measure_gradient_energy(image, first, clean, zones["static"])
    held = replace(frames, video=list(frames.video))  # so that decoding is not timed
    start = time.perf_counter()
    METHODS[name](held)
    return {
        "method": name,
        **{zone: float(np.sqrt(error[where].mean())) for zone, where in zones.items()},
        "gradient energy %": 100 * energy,
        "seconds": seconds,
        "decoded beforehand": time.perf_counter() - start,
        "peak MB": peak,
    }


def _measure_gradient_energy(
    image: Image, frame: Image, clean: Image, where: Bool[Array, "H W"]
) -> float:
    """Sharpness: gradient energy of an image over that of a single frame.

    Both are correlated with the gradients of the truth, so that their noise does not count.
    """
    truth = _compute_gradients(clean)[:, where]
    mean, single = ((_compute_gradients(p)[:, where] * truth).sum() for p in (image, frame))
    return float((mean / single) ** 2)


def _compute_gradients(image: Image) -> Float32[Array, "2 H W"]:
    """Differences of neighbours to the right and below, which show the finest detail."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.stack([np.roll(grey, -1, axis) - grey for axis in (1, 0)])


def _divide_zones(share: Float32[Array, "H W"]) -> dict[str, Bool[Array, "H W"]]:
    inside = np.zeros(share.shape, bool)
    inside[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] = True
    passed, stood = (share > 0) & (share < MIN_STANDING_SHARE), share >= MIN_STANDING_SHARE
    return {"static": inside & (share == 0), "passed": inside & passed, "stood": inside & stood}


def _measure_synthetic(still: str) -> Iterator[dict[str, Any]]:
    """Measure each method on one still; times also as multiples of the plain mean's."""
    with TemporaryDirectory() as name:
        _write_input(still, Path(name))
        mean_time = np.nan
        for method in METHODS:
            row = run_in_process(_run_method, method, Path(name))
            mean_time = row["decoded beforehand"] if method == "plain mean" else mean_time
            yield {"still": still, **row, "times plain mean": row["decoded beforehand"] / mean_time}


def _measure_real(data: Path) -> Iterator[dict[str, Any]]:
    """Measure real sequences, which have no truth: differences, contested pixels."""
    for place in ("hover/minsk_junction", "hover/munich_mos074", "hover/munich_street02"):
        video = open_video(data / place)
        registration = register(video)
        detections = read_detections(data / place)
        size, matrices = (video.height, video.width), registration.reference_from_frame
        frames = _RegisteredFrames(video, size, matrices, detections)
        yield _compare_methods(place, frames, registration.valid)
    for path in sorted((data / "static").glob("*.mp4")):
        images = [frame.image for frame in open_video(path).sample(64)]
        still = np.broadcast_to(np.eye(3), (len(images), 3, 3))
        frames = _RegisteredFrames(open_video(images), images[0].shape[:2], still)
        yield _compare_methods(path.name, frames, np.ones(len(images), bool))


def _compare_methods(
    name: str, frames: _RegisteredFrames, valid: Bool[Array, "T"]
) -> dict[str, Any]:
    keep = [pair for pair in frames if valid[pair[0].index]]
    start = time.perf_counter()
    ground = remove_traffic(keep, size=frames.size)
    seconds = time.perf_counter() - start
    plain = average_frames(keep, size=frames.size)
    boxed = float("nan")
    if frames.detections is not None:
        mean = average_frames(keep, size=frames.size, detections=frames.detections)
        boxed = _measure_differing_share(mean, ground)
    return {
        "sequence": name,
        "frames": ground.frames_used,
        "seconds": seconds,
        "contested %": 100 * float(ground.contested.mean()),
        "gains": f"{ground.gains.min():.3f} to {ground.gains.max():.3f}",
        "differs from mean %": _measure_differing_share(plain, ground),
        "differs from boxes %": boxed,
    }


def _measure_differing_share(one: Background, other: Background) -> float:
    """Percent of pixels that differ by more than 20 grey levels over 5 x 5 pixels."""
    both = (one.coverage > 0) & (other.coverage > 0)
    differs = cv2.blur(cv2.absdiff(one.image, other.image).max(-1), (5, 5)) > 20
    return 100 * float((differs & both).mean())


def main(json: JsonFile = None) -> None:
    """Measure the background methods on synthetic videos, and compare them on real ones."""
    data = require_data()
    cv2.setNumThreads(THREADS)
    synthetic = print_rows(row for still in STILLS for row in _measure_synthetic(still))
    real = print_rows(_measure_real(data))
    command = "python -m geoaim.bench.background"
    write_rows(synthetic, json, command=command, size=SIZE, frames=FRAMES, real=real)


if __name__ == "__main__":
    typer.run(main)
