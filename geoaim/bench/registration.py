"""Registration against other methods: speed and error on hover videos with exact truth.

    python -m geoaim.bench.registration --json docs/bench/registration.json \
        --chart docs/images/registration.png
"""

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
from geoaim.bench.report import format_table, write_rows
from geoaim.bench.stills import STILLS
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.registration.patches import align_patches, make_template
from geoaim.mapping.video.video import open_video
from geoaim.synthetic import list_boxes, reference_from_frames, write_video

Frames = list[UInt8[Array, "H W 3"]]
HARD: tuple[Kind, ...] = ("cars", "shadow", "gain", "cut", "noise")
MAX_RIGHT_ERROR_PX = 0.3  # a frame with a larger error counts as wrong


def measure_corner_errors(
    matrices: Matrices, truth: Matrices, video: HoverVideo
) -> Float[Array, " T"]:
    """Measure how far the frame's corners are mapped from their true positions.

    Args:
        matrices: (T, 3, 3) reference_from_frame, NaN where a method refused.
        truth: (T, 3, 3) true reference_from_frame.
        video: the video, for the frame's size.

    Returns:
        (T,) mean distance over the four corners, pixels; NaN where refused.
    """
    corners = image_corners(video.clip.height, video.clip.width)
    distance = transform_points(matrices, corners) - transform_points(truth, corners)
    return np.linalg.norm(distance, axis=-1).mean(-1)


def measure(name: str, method: Method, video: HoverVideo, frames: Any) -> dict[str, Any]:
    """Run a method: its rate from the median time of a frame, its errors on valid frames.

    Args:
        name: the method's name.
        method: the method.
        video: the video with its truth.
        frames: the video's frames, as rendered or after coding.

    Returns:
        A row of the table.
    """
    boxes = [list_boxes(video.clip, index) for index in range(len(video))]
    matrices, seconds = method(frames, boxes)
    errors = measure_corner_errors(matrices, reference_from_frames(video.clip), video)
    registered = np.isfinite(errors)
    right = registered & video.is_valid & (errors < MAX_RIGHT_ERROR_PX)
    valid_errors = errors[video.is_valid & registered]
    return {
        "method": name,
        "frames_per_s": float(1 / np.median(seconds[1:])),
        "error_mean_px": float(valid_errors[valid_errors < 100].mean()),
        "error_p95_px": float(np.quantile(valid_errors, 0.95)),
        "error_max_px": float(valid_errors.max()),
        "right_share_of_valid": float(right.sum() / video.is_valid.sum()),
        "accepted_but_wrong": int((registered & ~right).sum()),
    }


def code_frames(video: HoverVideo) -> Frames:
    """Return the frames after H.264 coding by x264's preset "medium" at CRF 20."""
    with TemporaryDirectory() as folder:
        path = write_video(video, Path(folder) / "clip.mp4")
        return [frame.image for frame in open_video(path)]


def measure_codec_shift(
    raw: list[UInt8[Array, "H W 3"]], coded: list[UInt8[Array, "H W 3"]]
) -> float:
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
            corners = image_corners(*before.shape[:2])
            displacement = transform_points(alignment.matrix, corners) - corners
            shifts.append(np.linalg.norm(displacement, axis=1).mean())
    return float(np.mean(shifts))


def measure_accuracy(sizes: list[str], frames: int) -> list[dict[str, Any]]:
    """Run every method on plain videos of both stills, raw and after H.264."""
    rows = []
    for size in sizes:
        for still in STILLS:
            video = make_hover_video(still, size=size, count=frames)
            raw = list(video)
            coded = code_frames(video)
            shift = measure_codec_shift(raw, coded)
            for source, pictures in (("raw", raw), ("H.264", coded)):
                for name, method in list_methods().items():
                    row: dict[str, Any] = {"size": size, "still": still, "source": source}
                    row["codec_shift_px"] = shift if source == "H.264" else 0.0
                    rows.append(row | measure(name, method, video, pictures))
                    print(format_table(rows[-1:]).splitlines()[-1], flush=True)
    return rows


def measure_robustness(sizes: list[str], frames: int) -> list[dict[str, Any]]:
    """Run this library and stabilo on the difficult videos, without boxes."""
    chosen = {name: m for name, m in list_methods().items() if name in ("geoaim", "stabilo")}
    rows = []
    for size in sizes:
        for still in STILLS:
            for kind in HARD:
                video = make_hover_video(still, size=size, count=frames, kind=kind)
                pictures = list(video)
                for name, method in chosen.items():
                    row = {"size": size, "still": still, "kind": kind}
                    rows.append(row | measure(name, method, video, pictures))
                    print(format_table(rows[-1:]).splitlines()[-1], flush=True)
    return rows


def draw_chart(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw speed against error, one point for each method, size and still."""
    figure = Figure(figsize=(7.5, 4.5), layout="constrained")
    axes = figure.subplots()
    names = sorted({row["method"] for row in rows})
    for number, name in enumerate(names):
        for size, mark in (("1080p", "o"), ("4k", "s")):
            points = [r for r in rows if r["method"] == name and r["size"] == size]
            if points:
                axes.scatter(
                    [r["frames_per_s"] for r in points],
                    [r["error_mean_px"] for r in points],
                    color=f"C{number}",
                    marker=mark,
                    label=f"{name}, {size}",
                )
    axes.set(xscale="log", yscale="log", xlabel="frames a second", ylabel="mean corner error, px")
    axes.set_title(
        "Registration on rendered hover videos with exact truth (right and low is better)"
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=7, ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def main(
    json: Annotated[Path | None, typer.Option(help="JSON to write")] = None,
    chart_path: Annotated[Path | None, typer.Option("--chart", help="chart to write")] = None,
    sizes: Annotated[str, typer.Option(help="frame sizes, comma-separated")] = "1080p,4k",
    frames: Annotated[int, typer.Option(help="frames of each video")] = 60,
    threads: Annotated[int, typer.Option(help="OpenCV's threads")] = 2,
) -> None:
    """Measure all methods; print tables; write JSON and a chart if asked."""
    cv2.setNumThreads(threads)
    plain = measure_accuracy(sizes.split(","), frames)
    hard = measure_robustness(sizes.split(","), frames)
    print(format_table(plain), format_table(hard), sep="\n\n")
    command = "python -m geoaim.bench.registration"
    write_rows(plain, json, command=command, frames=frames, robustness=hard)
    if chart_path:
        draw_chart(plain, chart_path)


if __name__ == "__main__":
    typer.run(main)
