"""Find the standing vehicles that detections miss: they look as in the frames that have their box.

Where a vehicle stands for most of the time and some of its boxes are missing, the frames without
them can outnumber those that show the ground: what is left outside of boxes would be the vehicle.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.mapping.background.traffic_removal import MIN_THRESHOLD, Masks, Stack
from geoaim.mapping.video.detections import grow_boxes

MAX_SAMPLES = 6  # pixels across a box that are compared
MIN_ALIKE = 0.8  # share of a box's pixels that look the same, where the same vehicle stands
MIN_UNCOVERED = 0.5  # share of a box that boxes leave in a frame that lacks it


def find_missed_vehicles(stack: Stack, seen: Masks, boxes: Sequence[Float[Array, "_ 4"]]) -> Masks:
    """Find, in each of K small frames, what other frames that look the same there have boxes of.

    A box (left, top, right, bottom; pixels of the small frames) counts where most of the frames
    that look the same have it, so that a false box on the ground hides nothing but itself. `seen`
    is what frames show of the image outside of boxes.
    """
    missed = np.zeros_like(seen)
    limit = np.tile(seen.shape[:0:-1], 2)
    for frame, own in zip(stack, boxes, strict=True):
        grown = grow_boxes(own)
        for box, wide in zip(own.clip(0, limit), grown.clip(0, limit), strict=True):
            left, top, right, bottom = np.rint(box).astype(int).tolist()
            step = max(min(right - left, bottom - top) // MAX_SAMPLES, 1)
            part = np.s_[top:bottom:step, left:right:step]
            if not frame[part].size:
                continue
            lacking = seen[:, *part].mean(axis=(1, 2)) > MIN_UNCOVERED
            without = np.flatnonzero(lacking)
            same = without[_look_alike(stack[:, *part][lacking], frame[part])]
            if not len(same):
                continue
            having = stack[:, *part][~lacking]
            if np.count_nonzero(_look_alike(having, frame[part])) > len(same):
                left, top, right, bottom = np.rint(wide).astype(int).tolist()
                missed[same, top:bottom, left:right] = True
    return missed


def _look_alike(frames: UInt8[Array, "k h w 3"], frame: UInt8[Array, "h w 3"]) -> Bool[Array, " k"]:
    off = np.abs(frames.astype(np.int16) - frame).max(axis=-1)
    return np.asarray((off <= MIN_THRESHOLD).mean(axis=(1, 2)) > MIN_ALIKE)
