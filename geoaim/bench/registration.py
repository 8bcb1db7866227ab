"""Registration against other methods: speed and error on hover videos with exact truth.

    python -m geoaim.bench.registration --json docs/bench/registration.json \
        --chart docs/images/registration.png
"""

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure
from numpy import ndarray as Array

from geoaim.bench.hover_videos import HoverVideo, Kind, make_hover_video
from geoaim.bench.registration_methods import Matrices, Method, list_methods, to_grey
from geoaim.bench.report import ChartFile, JsonFile, print_rows, write_rows
from geoaim.bench.stills import STILLS
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.registration.patches import align_patches, make_template
from geoaim.mapping.video.video import open_video
from geoaim.synthetic import list_boxes, reference_from_frames, write_video

Frames = list[UInt8[Array, "H W 3"]]
HARD: tuple[Kind, ...] = ("cars", "shadow", "gain", "cut", "noise")
MAX_RIGHT_ERROR_PX = 0.3  # a frame with a larger error counts as wrong


def measure_corner_distances(
    actual: Matrices, expected: Float[Array, "#T 3 3"], size: tuple[int, int]
) -> Float[Array, " T"]:
    """Measure how far apart two transforms map the corners of a frame.

    Args:
        actual: (T, 3, 3) reference_from_frame, NaN where a frame is refused.
        expected: (T, 3, 3) the same by other means, or (1, 3, 3).
        size: (height, width) of the frame, pixels.

    Returns:
        (T,) mean distance over the four corners, pixels; NaN where refused.
    """
    corners = image_corners(*size)
    distance = transform_points(actual, corners) - transform_points(expected, corners)
    return np.linalg.norm(distance, axis=-1).mean(-1)


def measure(method: Method, video: HoverVideo, frames: Any) -> dict[str, Any]:
    """Run a method: its rate from the median time of a frame, its errors on valid frames.

    Args:
        method: from `list_methods`.
        video: the video with its truth.
        frames: the video's frames, as rendered or after coding.

    Returns:
        By name: frames_per_s, error_mean_px, error_p95_px and error_max_px of corners,
        right_share_of_valid (0 to 1), and accepted_but_wrong, a number of frames.
    """
    boxes = [list_boxes(video.clip, index) for index in range(len(video))]
    matrices, seconds = method(frames, boxes)
    truth, size = reference_from_frames(video.clip), (video.clip.height, video.clip.width)
    errors = measure_corner_distances(matrices, truth, size)
    registered = np.isfinite(errors)
    right = registered & video.is_valid & (errors < MAX_RIGHT_ERROR_PX)
    valid_errors = errors[video.is_valid & registered]
    return {
        "frames_per_s": float(1 / np.median(seconds[1:])),
        "error_mean_px": float(valid_errors[valid_errors < 100].mean()),
        "error_p95_px": float(np.quantile(valid_errors, 0.95)),
        "error_max_px": float(valid_errors.max()),
        "right_share_of_valid": float(right.sum() / video.is_valid.sum()),
        "accepted_but_wrong": int((registered & ~right).sum()),
    }


def _code_frames(video: HoverVideo) -> Frames:
    """Return the frames after H.264 coding by x264's preset "medium" at CRF 20."""
    with TemporaryDirectory() as folder:
        path = write_video(video, Path(folder) / "clip.mp4")
        return [frame.image for frame in open_video(path)]


def _measure_codec_shift(raw: Frames, coded: Frames) -> float:
    """Measure how far coding itself shifts a frame, in pixels, on every fourth frame.

    Predicted blocks keep part of a motion that the encoder found too small to code. A method that
    sees one frame at a time cannot be much better than this.
    """
    shifts = []
    for before, after in zip(raw[1::4], coded[1::4], strict=True):
        alignment = align_patches(
            make_template(to_grey(before, 1)), to_grey(after, 1), np.eye(3), "homography"
        )
        if alignment is not None:
            moved, still = alignment.matrix[None], np.eye(3)[None]
            shifts.append(measure_corner_distances(moved, still, before.shape[:2])[0])
    return float(np.mean(shifts))


def _measure_accuracy(sizes: list[str], frames: int) -> Iterator[dict[str, Any]]:
    """Run every method on plain videos of both stills, raw and after H.264."""
    methods = list_methods()
    for size, still in product(sizes, STILLS):
        video = make_hover_video(still, size=size, count=frames)
        raw = list(video)
        coded = _code_frames(video)
        shift = _measure_codec_shift(raw, coded)
        for source, pictures, moved in (("raw", raw, 0.0), ("H.264", coded, shift)):
            case = {"size": size, "still": still, "source": source, "codec_shift_px": moved}
            for name, method in methods.items():
                yield case | {"method": name} | measure(method, video, pictures)


def _measure_robustness(sizes: list[str], frames: int) -> Iterator[dict[str, Any]]:
    """Run this library and stabilo on the difficult videos, without boxes."""
    methods = {name: m for name, m in list_methods().items() if name in ("geoaim", "stabilo")}
    for size, still, kind in product(sizes, STILLS, HARD):
        video = make_hover_video(still, size=size, count=frames, kind=kind)
        pictures = list(video)
        for name, method in methods.items():
            case = {"size": size, "still": still, "kind": kind, "method": name}
            yield case | measure(method, video, pictures)


def _draw_chart(rows: Sequence[Any], path: Path) -> None:
    """Draw speed against error, one point for each method, size and still."""
    figure = Figure(figsize=(7.5, 4.5), layout="constrained")
    axes = figure.subplots()
    names = sorted({row["method"] for row in rows})
    sizes = sorted({row["size"] for row in rows})
    for (number, name), (size, mark) in product(enumerate(names), zip(sizes, "os", strict=False)):
        points = [r for r in rows if r["method"] == name and r["size"] == size]
        speeds, errors = ([r[key] for r in points] for key in ("frames_per_s", "error_mean_px"))
        axes.scatter(speeds, errors, color=f"C{number}", marker=mark, label=f"{name}, {size}")
    axes.set(xscale="log", yscale="log", xlabel="frames a second", ylabel="mean corner error, px")
    axes.set_title("Rendered hover videos with exact truth (right and low is better)")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=7, ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def main(
    json: JsonFile = None,
    chart: ChartFile = None,
    sizes: Annotated[str, typer.Option(help="frame sizes, comma-separated")] = "1080p,4k",
    frames: Annotated[int, typer.Option(help="frames of each video")] = 60,
    threads: Annotated[int, typer.Option(help="OpenCV's threads")] = 2,
) -> None:
    """Measure all methods; print tables; write JSON and a chart if asked."""
    cv2.setNumThreads(threads)
    plain = print_rows(_measure_accuracy(sizes.split(","), frames))
    hard = print_rows(_measure_robustness(sizes.split(","), frames))
    command = "python -m geoaim.bench.registration"
    write_rows(plain, json, command=command, frames=frames, robustness=hard)
    if chart:
        _draw_chart(plain, chart)


if __name__ == "__main__":
    typer.run(main)
