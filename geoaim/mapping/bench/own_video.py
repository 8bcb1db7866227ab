"""Registration of a video without ground truth: how consistent and how fast each setting is.

The patches of the reference are divided like a chessboard into two halves. Each half registers the
frames by itself; half of their distance at the image's corners is the standard error of both
together, if their errors are independent. A simple motion model scatters little and may be wrong
all the same, hence its distance from the homography counts too. Errors that shift a whole frame,
as compression sometimes does, are not measured. Only the first frames of the video are read.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.base.errors import RegistrationError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.progress import Progress
from geoaim.mapping.bench.charts import draw_fronts
from geoaim.mapping.bench.curves import mark_pareto_fronts
from geoaim.mapping.bench.report import Results, collect
from geoaim.mapping.bench.settings import Setting, prepare, register_with
from geoaim.mapping.registration.patches import PatchTemplate
from geoaim.mapping.registration.register import Reference
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import VideoSource, open_video

FRAMES, QUICK_FRAMES = 60, 20
PER_PATCH = ("points", "contrast", "energy", "extractor", "inverse")  # arrays of a template
BLOCKS = 6  # blocks of the chessboard along the width
SETTINGS = {
    "geoaim": Setting(),
    "a quarter of the patches": Setting(count=Setting.count // 4),
    "4 times the patches": Setting(count=4 * Setting.count),
    "patches of 9 px": Setting(side=9),
    "patches of 23 px": Setting(side=23),
    "half the width": Setting(reduction=2),
    "a quarter of the width": Setting(reduction=4),
    "translation": Setting(model="translation"),
    "similarity": Setting(model="similarity"),
    "homography": Setting(model="homography"),
}


def measure_own_video(source: VideoSource, quick: bool, progress: Progress) -> Results:
    """Measure how consistent and how fast each setting registers a video.

    Args:
        source: what `open_video` opens.
        quick: whether to read fewer frames.
        progress: called with what is measured, what is done and all there is.

    Returns:
        Tables and charts.

    Raises:
        VideoError: the video cannot be read.
        RegistrationError: it has one frame, or no setting registers two frames.
    """
    cv2.setNumThreads(1)
    video = open_video(source)
    frames = list(islice(video, QUICK_FRAMES if quick else FRAMES))
    if len(frames) < 2:
        raise RegistrationError(f"{video.source} has {len(frames)} frame; two or more are needed")
    rows = collect(measure_settings(frames), "settings", progress, len(SETTINGS))
    panels = {f"{len(frames)} frames of {video.width} x {video.height} px": rows}
    labels = ("ms of a processor a frame", "expected error at the corners, px")
    charts = {"fronts": draw_fronts(panels, cost="ms", error="expected error, px", labels=labels)}
    marked = mark_pareto_fronts(panels, "ms", "expected error, px")
    return Results(f"Registration of {video.source}, without truth", {"rows": marked}, charts)


def measure_settings(
    frames: Sequence[Frame], settings: Mapping[str, Setting] = SETTINGS
) -> Iterator[dict[str, Any]]:
    """Measure settings on the same frames, one of them the homography, which counts as unbiased.

    The squared error is the variance plus the squared bias. The variance comes from two halves of
    the patches. The squared bias is the squared distance from the homography minus the difference
    of both variances, and at least 0.
    """
    size, found, scatter = frames[0].grey.shape, {}, {}
    for name, setting in settings.items():
        reference = prepare(frames, setting)
        found[name] = register_with(frames, setting, reference)
        halves = [register_with(frames, setting, _halve(reference, part)) for part in (0, 1)]
        scatter[name] = _measure_distance(halves[0].matrices, halves[1].matrices, size) / 2
    for name, placed in found.items():
        far = _measure_distance(placed.matrices, found["homography"].matrices, size)
        explained = abs(scatter[name] ** 2 - scatter["homography"] ** 2)
        error = float(np.sqrt(scatter[name] ** 2 + max(far**2 - explained, 0)))
        valid = np.isfinite(placed.matrices[1:, 0, 0])
        stated = float(np.sqrt((placed.stated[1:][valid] ** 2).mean())) if valid.any() else np.nan
        yield {
            "method": name,
            "motion model": placed.reference.model,
            "ms": 1e3 * float(np.median(placed.seconds[1:])),
            "registered, %": 100 * float(valid.mean()),
            "scatter, px": scatter[name],
            "from the homography, px": far,
            "expected error, px": error,
            "stated, px": stated,
            "expected over stated": error / stated,
        }


def _measure_distance(
    one: Float[Array, "T 3 3"], other: Float[Array, "T 3 3"], size: tuple[int, ...]
) -> float:
    """Root mean square distance at the corners over the frames that both register."""
    corners = image_corners(size[0], size[1])
    distance = transform_points(one[1:], corners) - transform_points(other[1:], corners)
    squares = (distance**2).sum(-1).mean(-1)
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else np.nan


def _halve(reference: Reference, part: int) -> Reference:
    """Keep the patches on the white or the black squares of a chessboard."""
    fine = reference.keyframe.fine
    square = (fine.points * BLOCKS / fine.width).astype(int).sum(1) % 2
    keyframe = replace(reference.keyframe, fine=_keep_patches(fine, square == part))
    return replace(reference, keyframe=keyframe)


def _keep_patches(template: PatchTemplate, keep: Bool[Array, " M"]) -> PatchTemplate:
    count = len(keep)
    pixels = template.pixels.reshape(3, count, -1)[:, keep].reshape(3, -1)
    parts = {name: getattr(template, name)[keep] for name in PER_PATCH}
    return replace(template, pixels=pixels, **parts)
