"""Arithmetic whose result is the same on every machine.

Sums, products, quotients and roots of IEEE numbers are; sines, powers and all that a processor may
fuse or reorder (OpenCV's float warps and blurs among it) differ in the last bits. So made scenes
use the former, OpenCV's integer functions, and round what comes of the latter.
"""

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8, UInt64
from numpy import ndarray as Array

FINEST = 2.0**20  # parts of a metre (a second, a grey level) that are told apart
BITS = 8  # of the fraction of a pixel in a warp
LANE = 21  # bits for each of three channels in one word
ROWS = 16  # that are warped at a time, so that they stay in the cache


def round_reproducibly(values: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Round to about a millionth, so that errors in the last bits cannot grow.

    >>> round_reproducibly(np.array([0.1 + 0.2])) == round_reproducibly(np.array([0.3]))
    array([ True])
    """
    return np.rint(np.asarray(values) * FINEST) / FINEST


def blur(image: UInt8[Array, "H W *c"], sigma: float) -> UInt8[Array, "H W *c"]:
    """Gaussian blur; of bytes OpenCV computes it in integers."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma)) if sigma > 0 else image


def resize(image: UInt8[Array, "H W *c"], size: tuple[int, int]) -> UInt8[Array, "_ _ *c"]:
    """To a width and height, finer details blurred away first; OpenCV's area mean is inexact."""
    shrink = image.shape[1] / size[0]
    if shrink > 1:
        smooth = blur(image, 0.5 * np.sqrt(shrink**2 - 1))
        return np.asarray(cv2.resize(smooth, size, interpolation=cv2.INTER_LINEAR_EXACT))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LANCZOS4))


def premultiply(sprite: UInt8[Array, "h w 4"]) -> UInt8[Array, "_ _ 4"]:
    """Colours times alpha, with a clear rim, so that it can be resampled."""
    whole = sprite.astype(np.uint16)
    whole[..., :3] = (whole[..., :3] * whole[..., 3:] + 127) // 255
    return np.pad(whole.astype(np.uint8), ((1, 1), (1, 1), (0, 0)))


def pack(image: UInt8[Array, "H W _"]) -> UInt64[Array, "H W"]:
    """Up to three channels in one word each pixel, for `warp`."""
    words = np.zeros(image.shape[:2], np.uint64)
    for channel in range(image.shape[2]):
        words |= image[..., channel].astype(np.uint64) << np.uint64(LANE * channel)
    return words


def warp(
    words: UInt64[Array, "h w"], source_from_image: Float[Array, "3 3"], height: int, width: int
) -> UInt8[Array, "H W 3"]:
    """Resample a packed image, linearly; outside of it its rim goes on.

    Places are rounded to 1/256 px. Both matrices' pixels have their origin at the corner.

    Args:
        words: from `pack`.
        source_from_image: pixels of the result to pixels of the source.
        height: rows of the result.
        width: its columns.
    """
    image = np.empty((height, width, 3), np.uint8)
    flat = words.ravel()
    for top in range(0, height, ROWS):
        rows = np.arange(top, min(top + ROWS, height))
        u, v = _map_pixels(source_from_image, rows, width)
        image[rows[0] : rows[-1] + 1] = _sample(flat, words.shape, u, v)
    return image


def _map_pixels(
    matrix: Float[Array, "3 3"], rows: Int[Array, "h"], width: int
) -> tuple[Int[Array, "h W"], Int[Array, "h W"]]:
    """Where pixels lie in the source, in parts of a pixel from the middle of its first one."""
    x, y = np.arange(width) + 0.5, (rows + 0.5)[:, None]
    (a, b, c), (d, e, f), (g, h, i) = matrix * [[1 << BITS], [1 << BITS], [1]]
    half = 1 << (BITS - 1)
    depth = 1 / (g * x + h * y + i)
    u = np.rint((a * x + b * y + c) * depth - half)
    v = np.rint((d * x + e * y + f) * depth - half)
    return u.astype(np.int64), v.astype(np.int64)


def _sample(
    flat: UInt64[Array, "_"], shape: tuple[int, ...], u: Int[Array, "h W"], v: Int[Array, "h W"]
) -> UInt8[Array, "h W 3"]:
    """Linear interpolation of three channels at once, each in its part of a word."""
    one = 1 << BITS
    u = np.minimum(np.maximum(u, 0), (shape[1] - 1) * one - 1)
    v = np.minimum(np.maximum(v, 0), (shape[0] - 1) * one - 1)
    at = (v >> BITS) * shape[1] + (u >> BITS)
    right, down = (u & (one - 1)).astype(np.uint64), (v & (one - 1)).astype(np.uint64)
    left, up = np.uint64(one) - right, np.uint64(one) - down
    top = flat.take(at) * left + flat.take(at + 1) * right
    low = flat.take(at + shape[1]) * left + flat.take(at + shape[1] + 1) * right
    short = np.uint64(sum(0x1FFF << (LANE * channel) for channel in range(3)))
    three, round_up = np.uint64(3), np.uint64(sum(1 << (LANE * k + 12) for k in range(3)))
    both = ((top >> three) & short) * up + ((low >> three) & short) * down + round_up
    parts = [(both >> np.uint64(LANE * channel + 13)).astype(np.uint8) for channel in range(3)]
    return np.stack(parts, axis=-1)
