"""Registration against other methods: speed and error on hover videos with exact truth."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import pandas as pd
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from benchmarks.charts import draw_fronts, draw_sizes
from benchmarks.curves import average_methods, judge_choices, mark_pareto_fronts, summarise_sizes
from benchmarks.data import find_data
from benchmarks.hover_videos import HoverVideo, Kind, film_place, make_hover_video
from benchmarks.registration.methods import Matrices, Method, list_methods, to_grey
from benchmarks.registration.settings import SETTINGS, measure_models, measure_sizes
from benchmarks.results import Results, Row, collect
from benchmarks.stills import STILLS
from benchmarks.synthetic import list_boxes, reference_from_frames, write_video
from benchmarks.synthetic.roads.layouts import PlaceKind
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.progress import Progress
from geoaim.mapping.registration.motion_models import MIN_ACCURACY_GAIN_PX
from geoaim.mapping.registration.patches import align_patches, make_template
from geoaim.mapping.video.video import open_video

Frames = list[UInt8[Array, "H W 3"]]
Videos = dict[tuple[str, str], HoverVideo]  # videos by size and what they show
SIZES = ("1080p", "4k")
FRAMES, QUICK_FRAMES = 60, 12  # length of each video
HARD: tuple[Kind, ...] = ("cars", "shadow", "gain", "cut", "noise")
MAX_RIGHT_ERROR_PX = 0.3  # a frame with a larger error counts as wrong
MAX_AVERAGED_ERROR_PX = 100  # larger ones would hide all others in a mean


def measure_corner_distances(
    actual: Matrices, expected: Float[Array, "#T 3 3"], size: tuple[int, int]
) -> Float[Array, " T"]:
    """Measure how far apart two transforms map the corners of a frame.

    Args:
        actual: (T, 3, 3) reference_from_frame, NaN where a frame is rejected.
        expected: (T, 3, 3) the same by other means, or (1, 3, 3).
        size: (height, width) of the frame, pixels.

    Returns:
        (T,) mean distance over the four corners, pixels; NaN where rejected.
    """
    corners = image_corners(*size)
    distance = transform_points(actual, corners) - transform_points(expected, corners)
    return np.linalg.norm(distance, axis=-1).mean(-1)


def measure_rate_and_errors(method: Method, video: HoverVideo, frames: Frames) -> dict[str, Any]:
    """Measure a method on a video: frames per second, errors, right frames, wrong ones accepted.

    Frames per second of processor time are from the median of a frame, without the first. The mean
    error leaves out errors of 100 px and more; the 95 % quantile and the maximum include them.

    Args:
        method: the method.
        video: the video with its truth.
        frames: all frames of the video, RGB, as rendered or after coding.

    Returns:
        Figures of a row of the table, by name. Errors (px) are of frames that show the scene and
        are not rejected; "right" are those below `MAX_RIGHT_ERROR_PX`.
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
        "error_mean_px": float(valid_errors[valid_errors < MAX_AVERAGED_ERROR_PX].mean()),
        "error_p95_px": float(np.quantile(valid_errors, 0.95)),
        "error_max_px": float(valid_errors.max()),
        "right_share_of_valid": float(right.sum() / video.is_valid.sum()),
        "accepted_but_wrong": int((registered & ~right).sum()),
    }


def code_frames(video: Iterable[UInt8[Array, "H W 3"]]) -> Frames:
    """Return the frames after H.264 coding by x264's preset "medium" at CRF 20."""
    with TemporaryDirectory() as folder:
        path = write_video(video, Path(folder) / "clip.mp4")
        return [frame.image for frame in open_video(path)]


def measure_codec_shift(raw: Frames, coded: Frames) -> float:
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


def measure_accuracy(videos: Videos) -> Iterator[dict[str, Any]]:
    """Run every method on videos, raw and after H.264."""
    methods = list_methods()
    for (size, still), video in videos.items():
        raw = list(video)
        coded = code_frames(video)
        shift = measure_codec_shift(raw, coded)
        for source, pictures, moved in (("raw", raw, 0.0), ("H.264", coded, shift)):
            case = {"size": size, "still": still, "source": source}
            for name, method in methods.items():
                row = measure_rate_and_errors(method, video, pictures)
                yield case | {"codec_shift_px": moved, "method": name} | row


def measure_robustness(frames: int) -> Iterator[dict[str, Any]]:
    """Run this library and stabilo on the difficult videos, without boxes."""
    methods = {name: m for name, m in list_methods().items() if name in ("geoaim", "stabilo")}
    for size, still, kind in product(SIZES, STILLS, HARD):
        video = make_hover_video(still, size=size, count=frames, kind=kind)
        pictures = list(video)
        for name, method in methods.items():
            case = {"size": size, "still": still, "kind": kind, "method": name}
            yield case | measure_rate_and_errors(method, video, pictures)


def make_videos(quick: bool) -> Videos:
    """Make plain videos: over real stills if GEOAIM_DATA is set, else over drawn places."""
    if quick:
        return {("720p", "junction"): film_place("junction", size="720p", count=QUICK_FRAMES)}
    if find_data() is None:
        kinds: tuple[PlaceKind, ...] = ("junction", "roundabout")
        return {("1080p", kind): film_place(kind, size="1080p", count=FRAMES) for kind in kinds}
    return {
        (size, still): make_hover_video(still, size=size, count=FRAMES)
        for size, still in product(SIZES, STILLS)
    }


def measure_registration(quick: bool, progress: Progress) -> Results:
    """Measure other methods, and the settings of this one by their size.

    Args:
        quick: whether to take one small video.
        progress: called with what is measured, what is done and all there is.

    Returns:
        Tables and charts.
    """
    cv2.setNumThreads(1)
    videos = make_videos(quick)
    runs = 2 * len(videos) * len(list_methods())
    rows = collect(measure_accuracy(videos), "methods and videos", progress, runs)
    hard = []
    if len(videos) > len(STILLS):
        hard = collect(measure_robustness(FRAMES), "hard videos and methods", progress)
    sizes = measure_sizes(list(videos.values())[:2], progress)
    cases = collect(measure_models(quick), "camera motions", progress)
    panels = _average_stills(rows)
    tables: dict[str, Sequence[Row]] = {
        "rows": rows,
        "robustness": hard,
        "fronts": mark_pareto_fronts(panels, "ms", "error, px"),
        "defaults": summarise_sizes(sizes),
        "choice of the motion model": [judge_choices(cases, MIN_ACCURACY_GAIN_PX)],
        "sizes": sizes,
        "cases": cases,
    }
    axes = ("ms a frame", "mean error at the corners, px")
    charts = {
        "fronts": draw_fronts(panels, cost="ms", error="error, px", labels=axes),
        "sizes": draw_sizes(sizes, dict.fromkeys(SETTINGS, axes[1])),
    }
    return Results("Registration of hover videos with exact truth", tables, charts)


def _average_stills(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Means of each method over the stills, by size and source."""
    table = pd.DataFrame(rows).rename(columns={"error_mean_px": "error, px"})
    table["ms"] = 1e3 / table.frames_per_s
    groups = table.groupby(["size", "source"], sort=False)
    return {
        f"{size}, {source}": average_methods(own, ["ms", "error, px"])
        for (size, source), own in groups
    }
