"""Settings of the registration at several values: patches, image width, motion model.

Sizes are no options of the library, since no scene needs others than the defaults: here the
constants of `patches` are replaced while a video is registered.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any
from unittest.mock import patch

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from benchmarks.hover_videos import HoverVideo, film_ground
from benchmarks.results import Row, collect
from benchmarks.synthetic import Hover, draw_place, make_place, reference_from_frames
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.progress import Progress
from geoaim.mapping.registration import patches
from geoaim.mapping.registration.motion_models import Model
from geoaim.mapping.registration.register import Reference, choose_reference, register_frames
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import open_video

HOVER = Hover(count=12, drift=18.0)
# Tilt (px at the corners), yaw and zoom (of those of HOVER), noise (grey levels), seed.
CASES = tuple(product((0.0, 0.1, 0.4, 1.0), (0.0, 0.2, 1.0), (1.0, 4.0), (3, 4)))
PARAMETERS: dict[Model, int] = {"translation": 2, "similarity": 4, "affine": 6, "homography": 8}


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


SETTINGS: dict[str, dict[float, Setting]] = {
    "patches": {n: Setting(count=n) for n in (42, 85, 170, 340, 680, 1360)},
    "patch side, px": {side: Setting(side=side) for side in (7, 9, 13, 17, 23)},
    "image width, share": {1 / n: Setting(reduction=n) for n in (8, 4, 2, 1)},
    "motion parameters": {n: Setting(model=model) for model, n in PARAMETERS.items()},
}


def measure_error(placed: Placements, video: HoverVideo) -> float:
    """Measure the corners' mean error after the first frame, px; infinite if one is rejected."""
    corners = image_corners(video.clip.height, video.clip.width)
    truth = transform_points(reference_from_frames(video.clip), corners)
    error = np.linalg.norm(transform_points(placed.matrices, corners) - truth, axis=-1)[1:]
    return float(error.mean()) if np.isfinite(error).all() else np.inf


def measure_sizes(videos: Sequence[HoverVideo], progress: Progress) -> list[Row]:
    """Measure error and time at several values of each setting, as means over videos.

    Args:
        videos: uncompressed hover videos with exact truth.
        progress: called with the name of the setting, the values done and the values in all.

    Returns:
        Rows as `summarise_sizes` takes them.
    """
    frames = [list(open_video(list(video))) for video in videos]
    rows: list[Row] = []
    for name, sizes in SETTINGS.items():
        settings = {**sizes, **({0.0: Setting()} if Setting() not in sizes.values() else {})}
        rows += collect(
            _measure_setting(name, settings, videos, frames), name, progress, len(settings)
        )
    return rows


def _measure_setting(
    name: str,
    settings: dict[float, Setting],
    videos: Sequence[HoverVideo],
    frames: Sequence[Sequence[Frame]],
) -> Iterator[dict[str, Any]]:
    """Measure the sizes of one setting; the motion model's default is chosen by the data."""
    for size, setting in settings.items():
        placed = [register_with(own, setting) for own in frames]
        error = np.mean([measure_error(*pair) for pair in zip(placed, videos, strict=True)])
        ms = 1e3 * float(np.mean([np.median(one.seconds[1:]) for one in placed]))
        size = size or float(np.mean([PARAMETERS[one.reference.model] for one in placed]))
        yield {
            "setting": name,
            "size": size,
            "error": float(error),
            "ms": ms,
            "cost": size if name == "motion parameters" else ms,
            "default": setting == Setting(),
            "automatic": setting == Setting() and name == "motion parameters",
        }


def measure_models(quick: bool) -> Iterator[dict[str, Any]]:
    """Measure each motion model and the automatic choice on videos of cameras that move unlike."""
    for tilt, turn, noise, seed in CASES[:: 9 if quick else 1]:
        ground = _draw_ground(seed)
        hover = replace(HOVER, perspective=tilt, noise=noise)
        hover = replace(hover, yaw=turn * HOVER.yaw, zoom=turn * HOVER.zoom)
        video = film_ground(ground, hover, seed)
        frames = list(open_video(list(video)))
        placed = {model: register_with(frames, Setting(model=model)) for model in PARAMETERS}
        chosen = register_with(frames, Setting())
        yield {
            "case": f"tilt {tilt:g} px, turn x {turn:g}, noise {noise:g}, seed {seed}",
            "models": list(PARAMETERS),
            "errors": [measure_error(one, video) for one in placed.values()],
            "sizes": list(PARAMETERS.values()),
            "error": measure_error(chosen, video),
            "size": PARAMETERS[chosen.reference.model],
        }


@cache
def _draw_ground(seed: int) -> UInt8[Array, "H W 3"]:
    return draw_place(make_place(seed, kind="junction"), resolution=0.1)


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
