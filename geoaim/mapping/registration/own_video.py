"""Registration of a video without ground truth: how consistent and how fast each setting is.

The patches of the reference are divided like a chessboard into two halves. Each half registers the
frames by itself; half of their distance at the image's corners is the standard error of both
together, if their errors are independent. A simple motion model scatters little and may be wrong
all the same, hence its distance from the homography counts too. Errors that shift a whole frame,
as compression sometimes does, are not measured. Only the first frames of the video are read.

Sizes are no options of the library, since no scene needs others than the defaults: here the
constants of `patches` are replaced while a video is registered.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.base.errors import RegistrationError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.progress import Progress
from geoaim.mapping.registration import patches
from geoaim.mapping.registration.motion_models import Model
from geoaim.mapping.registration.register import Reference, choose_reference, register_frames
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import VideoSource, open_video

FRAMES, QUICK_FRAMES = 60, 20
PER_PATCH = ("points", "contrast", "energy", "extractor", "inverse")  # arrays of a template
BLOCKS = 6  # blocks of the chessboard along the width


@dataclass(frozen=True)
class Setting:
    """A setting of the registration; the defaults are the library's."""

    count: int = patches.PATCH_COUNT  # target number of patches
    side: int = patches.PATCH_SIDE_PX  # side of a patch, pixels
    reduction: int = 1  # integer factor by which the frame is shrunk
    model: Model | None = None  # the motion model; None chooses it by the data


@dataclass(frozen=True, eq=False)
class Placements:
    """Frames registered with a setting."""

    matrices: Float[Array, "T 3 3"]  # (T, 3, 3) reference_from_frame, pixels; NaN where rejected
    seconds: Float[Array, " T"]  # (T,) processor time of each frame
    stated: Float[Array, " T"]  # (T,) uncertainty over the image, pixels
    reference: Reference  # the frame that they are registered to


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


def measure_own_video(source: VideoSource, quick: bool, progress: Progress) -> list[dict[str, Any]]:
    """Measure how consistent and how fast each setting registers a video.

    Args:
        source: what `open_video` opens.
        quick: whether to read fewer frames.
        progress: called with what is measured, what is done and all there is.

    Returns:
        A row for each setting.

    Raises:
        VideoError: the video cannot be read.
        RegistrationError: it has one frame, or no setting registers two frames.
    """
    cv2.setNumThreads(1)
    video = open_video(source)
    frames = list(islice(video, QUICK_FRAMES if quick else FRAMES))
    if len(frames) < 2:
        raise RegistrationError(f"{video.source} has {len(frames)} frame; two or more are needed")
    rows: list[dict[str, Any]] = []
    progress("settings", 0, len(SETTINGS))
    for row in measure_settings(frames):
        rows.append(row)
        progress("settings", len(rows), len(SETTINGS))
    return rows


def measure_settings(
    frames: Sequence[Frame], settings: Mapping[str, Setting] = SETTINGS
) -> Iterator[dict[str, Any]]:
    """Measure settings on the same frames, one of them the homography, which counts as unbiased."""
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


def _keep_patches(
    template: patches.PatchTemplate, keep: Bool[Array, " M"]
) -> patches.PatchTemplate:
    count = len(keep)
    pixels = template.pixels.reshape(3, count, -1)[:, keep].reshape(3, -1)
    parts = {name: getattr(template, name)[keep] for name in PER_PATCH}
    return replace(template, pixels=pixels, **parts)


def prepare(frames: Sequence[Frame], setting: Setting) -> Reference:
    """Prepare the reference, the first frame, for a setting."""
    with patch.multiple(patches, PATCH_COUNT=setting.count, PATCH_SIDE_PX=setting.side):
        small = [_shrink(frame, setting.reduction) for frame in frames]
        video = open_video([frame.grey for frame in small])
        return choose_reference(video, model=setting.model, time=small[0].time, probes=small)


def register_with(
    frames: Sequence[Frame], setting: Setting, reference: Reference | None = None
) -> Placements:
    """Register frames with a setting."""
    reference = reference or prepare(frames, setting)
    matrices, seconds, stated = [], [], []
    scale = np.diag([setting.reduction, setting.reduction, 1.0])
    with patch.multiple(patches, PATCH_COUNT=setting.count, PATCH_SIDE_PX=setting.side):
        small = (_shrink(frame, setting.reduction) for frame in frames)
        start = time.process_time()
        for _, placed in register_frames(small, reference):
            seconds.append(time.process_time() - start)
            matrices.append(scale @ placed.reference_from_frame @ np.linalg.inv(scale))
            stated.append(placed.uncertainty * setting.reduction)
            start = time.process_time()
    return Placements(np.array(matrices), np.array(seconds), np.array(stated), reference)


def _shrink(frame: Frame, reduction: int) -> Frame:
    return Frame(frame.index, frame.time, None, patches.shrink_image(frame.grey, reduction))
