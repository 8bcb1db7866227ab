"""Stacks of small registered frames: their median and noise, and which frames look alike."""

import cv2
import numpy as np
from jaxtyping import Bool, Int, UInt8
from numpy import ndarray as Array

Stack = UInt8[Array, "K h w 3"]  # small frames
Image = UInt8[Array, "h w 3"]
Masks = Bool[Array, "K h w"]
Pixels = Int[Array, "2 m"]  # rows and columns


def compute_median(stack: UInt8[Array, "K h w c"], seen: Masks) -> UInt8[Array, "h w c"]:
    """Median over the frames that see a pixel, by bisection: 8 counts instead of a sort.

    `stack` becomes 0 in place where a frame does not see a pixel.
    """
    kind = np.uint8 if len(stack) < 256 else np.uint16
    half = np.maximum(seen.sum(0, dtype=np.uint16), 1)[..., None] / np.float32(2)
    stack[~seen] = 0  # never counts as bright
    low = np.zeros(stack.shape[1:], np.uint8)
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        middle = low | np.uint8(bit)
        count = np.zeros(low.shape, kind)
        for frame in stack:
            count += frame >= middle
        low = np.where(count >= half, middle, low)
    return low


def estimate_noise(stack: Stack, seen: Masks, background: Image) -> float:
    """Robust standard deviation of frames about the background: the median over every fourth one.

    Args:
        stack: (K, h, w, 3) frames.
        seen: (K, h, w) whether a frame shows a pixel.
        background: (h, w, 3) the background.

    Returns:
        Grey levels; 0 where no frame shows anything.
    """
    medians = [
        np.median(measure_difference(frame, background)[::4, ::4][visible[::4, ::4]])
        for frame, visible in zip(stack[::4], seen[::4], strict=True)
        if visible[::4, ::4].any()
    ]
    return 1.4826 * float(np.median(medians)) if medians else 0.0


def measure_difference(one: Image, other: Image) -> UInt8[Array, "h w"]:
    """Largest absolute difference of the three channels."""
    first, second, third = cv2.split(cv2.absdiff(one, other))
    return np.asarray(cv2.max(cv2.max(first, second), third), np.uint8)


def find_pixels(mask: UInt8[Array, "h w"]) -> Pixels:
    """Rows and columns of the pixels that are set; OpenCV takes a third of NumPy's time."""
    points = cv2.findNonZero(mask)
    return np.empty((2, 0), np.int32) if points is None else points.reshape(-1, 2)[:, ::-1].T


def find_alike(
    stack: Stack, pixels: Pixels, colours: UInt8[Array, "m 3"], threshold: float
) -> Bool[Array, "K m"]:
    """Find which frames have nearly the given colours.

    Args:
        stack: (K, h, w, 3) frames.
        pixels: (2, m) rows and columns.
        colours: (m, 3) their colours.
        threshold: largest difference of a channel, grey levels.

    Returns:
        (K, m) whether a frame looks alike at a pixel.
    """
    colour = colours.astype(np.int16)
    return np.stack([np.abs(frame[tuple(pixels)] - colour).max(-1) <= threshold for frame in stack])


def average_at(
    stack: Stack, pixels: Pixels, selected: Bool[Array, "K m"], default: UInt8[Array, "m 3"]
) -> UInt8[Array, "m 3"]:
    """Average the selected frames at some pixels.

    Args:
        stack: (K, h, w, 3) frames.
        pixels: (2, m) rows and columns.
        selected: (K, m) whether a frame counts.
        default: (m, 3) colours where none does.

    Returns:
        (m, 3) colours.
    """
    total = np.zeros(default.shape, np.float32)
    for frame, chosen in zip(stack, selected, strict=True):
        total += frame[tuple(pixels)] * chosen[:, None]
    count = selected.sum(0)[:, None]
    return np.where(count > 0, np.rint(total / np.maximum(count, 1)), default).astype(np.uint8)


def average_stack(stack: Stack, selected: Masks, default: Image) -> Image:
    """Average the selected frames at every pixel.

    Args:
        stack: (K, h, w, 3) frames.
        selected: (K, h, w) whether a frame counts.
        default: (h, w, 3) colours where none does.

    Returns:
        (h, w, 3) colours.
    """
    total = np.zeros(default.shape, np.float32)
    for frame, mask in zip(stack, selected, strict=True):
        cv2.accumulate(frame, total, mask.view(np.uint8))
    count = selected.sum(0)[..., None]
    mean = np.rint(total / np.maximum(count, 1)).astype(np.uint8)
    return np.where(count > 0, mean, default)
