"""Exposure of frames relative to the first: one gain for each frame."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.base.geometry import to_opencv
from geoaim.mapping.video.frames import Frame

GRID_POINTS = 120  # points along the longer side at which exposure is compared
MIN_POINTS = 50  # exposure is not compared at fewer points
RATIO_BINS = 350  # number of bins, 2 % each, centred on a ratio of 1
MODE_HALF_WIDTH = 0.05  # half the width of the mode, as a logarithm of the ratio


@dataclass(eq=False)
class Exposure:
    """Grey levels above black where frames first showed the points of a grid; filled in place."""

    spacing: int  # distance between points of the grid, pixels of the image
    level: Float32[Array, "h w"]  # grey levels, 0 where no frame has shown the point
    gain: float = 1.0  # gain of the last frame


def start_exposure(size: tuple[int, int]) -> Exposure:
    """Make an empty grid for an image of (height, width) pixels."""
    spacing = max(max(size) // GRID_POINTS, 1)
    return Exposure(spacing, np.zeros((size[0] // spacing, size[1] // spacing), np.float32))


def estimate_gain(exposure: Exposure, frame: Frame, image_from_frame: Float[Array, "3 3"]) -> float:
    """Estimate the factor that brings a frame to the exposure of the first one.

    It is the mode of the ratios of grey levels above black. One factor serves all colours: a real
    drone's step in exposure was 0.983, 0.984 and 0.986 in red, green and blue.
    """
    shrink = np.diag([1 / exposure.spacing, 1 / exposure.spacing, 1.0])
    matrix, size = to_opencv(shrink @ image_from_frame), exposure.level.shape[::-1]
    sampled = cv2.warpPerspective(frame.grey, matrix, size, flags=cv2.INTER_NEAREST)
    black = black_level(frame)
    usable = (sampled > black + 20) & (sampled < 225)
    grey = sampled.astype(np.float32) - np.float32(black)
    common = usable & (exposure.level > 0)
    if np.count_nonzero(common) >= MIN_POINTS:
        exposure.gain = _find_common_ratio(np.log(exposure.level[common] / grey[common]))
    first_shown = usable & (exposure.level == 0)
    np.copyto(exposure.level, grey * np.float32(exposure.gain), where=first_shown)
    return exposure.gain


def _find_common_ratio(logarithms: Float32[Array, "n"]) -> float:
    """Mode of ratios, which even a bus over most of the view does not change, unlike a median."""
    bins = np.clip(logarithms * 50 + RATIO_BINS / 2, 0, RATIO_BINS).astype(np.intp)
    centre = (float(np.bincount(bins).argmax()) - (RATIO_BINS - 1) / 2) / 50
    for _ in range(3):
        near = np.abs(logarithms - centre) < MODE_HALF_WIDTH
        centre = float(np.median(logarithms[near])) if near.any() else centre
    return float(np.exp(centre))


def apply_gain(
    pixels: UInt8[Array, "H W *c"], gain: float, neutral: float
) -> UInt8[Array, "H W *c"]:
    """Multiply the pixels' distance from a neutral value."""
    if 255 * abs(gain - 1) < 0.5:  # changes no pixel
        return pixels
    return np.asarray(cv2.addWeighted(pixels, gain, pixels, 0.0, neutral * (1 - gain)), np.uint8)


def black_level(frame: Frame) -> float:
    """Tell the grey level of black in `frame.grey`: 16 in video of limited range, else 0."""
    return 0.0 if frame.encoding is None or frame.encoding.full_range else 16.0
