"""Registration of a video without truth: this library and plain rivals, how consistent and fast.

Frames are registered to three references by each method. A way from one reference over a frame to
another must end where the direct way ends; the distance, divided by the root of three since three
registrations share it, is the error of one. An error that a frame has to all references cancels:
a method that finds no motion is consistent, but leaves the frames different from the reference, so
that this difference is measured too.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from numpy import ndarray as Array

from geoaim.base.errors import RegistrationError
from geoaim.base.geometry import transform_points
from geoaim.base.labels import label_points, scale_axes
from geoaim.base.progress import Progress
from geoaim.mapping.registration.patches import shrink_image
from geoaim.mapping.registration.register import choose_reference, register_frames
from geoaim.mapping.registration.rivals import Rival, match_orb, maximise_ecc, track_corners
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import VideoSource, open_video

FRAMES, QUICK_FRAMES = 30, 10  # spread over the video
DECODED = 30  # frames whose decoding is timed
GRID = 5  # points a side over which the error is averaged
Matrices = Float[Array, "T 3 3"]
# gives reference_from_frame, NaN where a frame is rejected, and what is stated of its error (px)
Register = Callable[[], tuple[Matrices, Float[Array, " T"]]]
Prepare = Callable[[Sequence[Frame], int], Register]  # takes frames and the reference's number
SMALLEST_PX = 1e-4  # of the picture's axis, which is logarithmic


def measure_own_video(source: VideoSource, quick: bool, progress: Progress) -> list[dict[str, Any]]:
    """Measure how consistent and how fast each method registers a video.

    Args:
        source: what `open_video` opens.
        quick: whether to take fewer frames.
        progress: called with what is measured, what is done and all there is.

    Returns:
        A row for each method, and first one for decoding alone, which has only a time: method, ms
        (of a processor for each frame), preparation (ms, once a video), registered (%), error
        (px, RMS over the image), difference (grey levels, median) and stated (px; ours only).

    Raises:
        VideoError: the video cannot be read.
        RegistrationError: it has fewer than four frames.
    """
    cv2.setNumThreads(1)
    video = open_video(source, threads=1)
    frames = list(video.sample(QUICK_FRAMES if quick else FRAMES))
    if len(frames) < 4:
        raise RegistrationError(f"{video.source} has {len(frames)} frames; four or more are needed")
    start = time.process_time()
    decoded = sum(1 for _ in islice(video, DECODED))
    rows = [{"method": "decoding alone", "ms": 1e3 * (time.process_time() - start) / decoded}]
    frames = list(open_video([frame.grey for frame in frames]))  # in arrays, all read
    for name, prepare in METHODS.items():
        progress("methods", len(rows) - 1, len(METHODS))
        rows.append({"method": name, **_measure_method(prepare, frames)})
    progress("methods", len(METHODS), len(METHODS))
    return rows


def _measure_method(prepare: Prepare, frames: Sequence[Frame]) -> dict[str, float]:
    references = [0, len(frames) // 3, 2 * len(frames) // 3]
    start = time.process_time()
    registers = [prepare(frames, index) for index in references]
    prepared = time.process_time()
    found = [register() for register in registers]
    seconds = time.process_time() - prepared
    matrices = np.array([one for one, _ in found])
    stated = np.array([one for _, one in found])
    others = np.array(references)[:, None] != np.arange(len(frames))
    return {
        "ms": 1e3 * seconds / others.size,
        "preparation, ms": 1e3 * (prepared - start) / len(references),
        "registered, %": 100 * float(np.isfinite(matrices[others][:, 0, 0]).mean()),
        "error, px": measure_loops(matrices, references, frames[0].grey.shape),
        "difference, grey levels": _measure_difference(matrices[0], frames),
        "stated, px": _root_mean_square(stated[others]),
    }


def measure_loops(
    matrices: Float[Array, "R T 3 3"], references: Sequence[int], size: tuple[int, ...]
) -> float:
    """Measure the error of a registration by ways from one reference over a frame to another.

    Args:
        matrices: reference_from_frame of each reference and frame, pixels; NaN where rejected.
        references: the numbers of the frames that are references.
        size: height and width of a frame.

    Returns:
        The root mean square over the image, pixels; NaN where no way is complete.
    """
    height, width = size
    x, y = np.meshgrid(np.linspace(0, width, GRID), np.linspace(0, height, GRID))
    grid = np.column_stack([x.ravel(), y.ravel()])
    distances = []
    for one, direct in zip(matrices, references, strict=True):
        for other, between in zip(matrices, references, strict=True):
            if between == direct:
                continue
            free = [k for k in range(len(one)) if k not in (direct, between)]
            way = transform_points(one[between] @ other[free], grid)
            distances.append(np.hypot(*(way - transform_points(one[free], grid)).T))
    return _root_mean_square(np.concatenate(distances, axis=1)) / np.sqrt(3)


def _measure_difference(matrices: Matrices, frames: Sequence[Frame]) -> float:
    """Median difference of registered frames from the first, grey levels; one of many pixels."""
    first, values = frames[0].grey, []
    for frame, matrix in zip(frames[1:], matrices[1:], strict=True):
        if np.isfinite(matrix).all():
            moved = cv2.warpPerspective(
                frame.grey, matrix, first.shape[::-1], borderMode=cv2.BORDER_CONSTANT
            )
            shown = cv2.warpPerspective(np.ones_like(first), matrix, first.shape[::-1]) > 0
            values.append(np.median(cv2.absdiff(moved, first)[shown]) if shown.any() else np.nan)
    return float(np.nanmean(values)) if values else np.nan


def _root_mean_square(values: Float[Array, "*m"]) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt((finite**2).mean())) if finite.size else np.nan


def _prepare_geoaim(frames: Sequence[Frame], index: int) -> Register:
    video = open_video([frame.grey for frame in frames])
    nothing = np.full((len(frames), 3, 3), np.nan), np.full(len(frames), np.nan)
    try:
        reference = choose_reference(video, time=frames[index].time, probes=frames)
    except RegistrationError:
        return lambda: nothing

    def register() -> tuple[Matrices, Float[Array, " T"]]:
        placed = [placement for _, placement in register_frames(frames, reference)]
        matrices = np.array([one.reference_from_frame for one in placed])
        return matrices, np.array([one.uncertainty for one in placed])

    return register


def _prepare_rival(rival: Rival, shrink: int, frames: Sequence[Frame], index: int) -> Register:
    """Give a rival frames reduced by an integer, on from its reference both ways."""
    scale = np.diag([shrink, shrink, 1.0])

    def register() -> tuple[Matrices, Float[Array, " T"]]:
        matrices = np.full((len(frames), 3, 3), np.nan)
        matrices[index] = np.eye(3)
        for way in (range(index + 1, len(frames)), range(index - 1, -1, -1)):
            find = rival(shrink_image(frames[index].grey, shrink))
            for number in way:
                matrix = find(shrink_image(frames[number].grey, shrink))
                if matrix is not None:
                    matrices[number] = scale @ matrix @ np.linalg.inv(scale)
        return matrices, np.full(len(frames), np.nan)

    return register


METHODS: dict[str, Prepare] = {
    "geoaim": _prepare_geoaim,
    "ORB 2000 + MAGSAC": partial(_prepare_rival, match_orb, 1),
    "KLT half + MAGSAC": partial(_prepare_rival, track_corners, 2),
    "ECC quarter": partial(_prepare_rival, maximise_ecc, 4),
}


def draw_own_video(rows: Sequence[dict[str, Any]]) -> Figure:
    """Draw error against time of the methods, with decoding alone as a line."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    decoding, *methods = rows
    points = np.array([[row["ms"], max(row["error, px"], SMALLEST_PX)] for row in methods])
    names = [row["method"] for row in methods]
    for (ms, error), name in zip(points, names, strict=True):
        ours = name == "geoaim"
        axes.plot(ms, error, "D" if ours else "o", color="#D55E00" if ours else "#0072B2")
    axes.axvline(decoding["ms"], color="0.4", linestyle="--", linewidth=1, label="decoding alone")
    axes.set(xlabel="ms of a processor for a frame", ylabel="error by closed ways, px")
    axes.margins(0.25)
    scale_axes(axes)
    axes.legend()
    figure.draw_without_rendering()  # so that the axes have their size
    label_points(axes, points, names)
    return figure


def describe_own_video(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Say in sentences what the rows show, and what they cannot."""
    own, *rivals = rows[1:]
    known = [row for row in rivals if np.isfinite(row["error, px"])]
    if not np.isfinite(own["error, px"]):
        yield "geoaim does not register this video: `geoaim register` says why."
    else:
        yield (
            f"geoaim registers {own['registered, %']:.0f} % of the frames, with errors of "
            f"{own['error, px']:.2g} px in {own['ms']:.2g} ms a frame (and "
            f"{own['preparation, ms']:.0f} ms once); it states {own['stated, px']:.2g} px."
        )
    for row in known:
        yield (
            f"{row['method']}: {row['registered, %']:.0f} %, {row['error, px']:.2g} px in "
            f"{row['ms']:.2g} ms."
        )
    yield (
        "Errors are by closed ways over three references: one that a frame has to all of them, "
        "as of waves or of traffic taken for ground, shows only as a difference in grey levels. "
        "Nothing here says where the map lies, or whether traffic is left in it."
    )
