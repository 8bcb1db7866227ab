"""Register a video with other patches, image widths and motion models than the library's.

Sizes are no options of the library, since no scene needs others than the defaults: here the
constants of `patches` are replaced while a video is registered.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.mapping.registration import patches
from geoaim.mapping.registration.motion_models import Model
from geoaim.mapping.registration.register import Reference, choose_reference, register_frames
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import open_video


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


def prepare(frames: Sequence[Frame], setting: Setting) -> Reference:
    """Prepare the reference, the first frame, for a setting."""
    with patch.multiple(patches, PATCH_COUNT=setting.count, PATCH_SIDE_PX=setting.side):
        small = [_shrink(frame, setting.reduction) for frame in frames]
        video = open_video([frame.grey for frame in small])
        return choose_reference(video, model=setting.model, time=small[0].time, probes=small)


def register_with(
    frames: Sequence[Frame], setting: Setting, reference: Reference | None = None
) -> Placements:
    """Register frames with a setting.

    Args:
        frames: frames in order of time.
        setting: the setting.
        reference: prepared for it; None prepares it.

    Returns:
        The registrations, in pixels of the full image.
    """
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
