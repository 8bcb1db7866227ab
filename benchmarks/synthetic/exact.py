"""Image arithmetic whose result is the same on every machine.

IEEE sums, products, quotients and roots are reproducible. Sines, powers and everything that a
processor may fuse or reorder (such as OpenCV's floating-point warps and blurs) differ in the last
bits. Synthetic places therefore use the former and OpenCV's integer functions, and round the rest.
"""

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8, UInt64
from numpy import ndarray as Array

ROUNDING_STEPS = 2.0**20  # steps per unit
FRACTION_BITS = 8  # bits of a fraction of a pixel in a warp
CHANNEL_BITS = 21  # bits of each of three channels in one word
ROWS = 16  # warped at a time, so that they stay in the cache


def round_reproducibly(values: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Round to about a millionth, so that errors in the last bits cannot grow.

    >>> round_reproducibly(np.array([0.1 + 0.2])) == round_reproducibly(np.array([0.3]))
    array([ True])
    """
    return np.rint(np.asarray(values) * ROUNDING_STEPS) / ROUNDING_STEPS


def blur(image: UInt8[Array, "H W *c"], sigma: float) -> UInt8[Array, "H W *c"]:
    """Blur by a Gaussian of `sigma` pixels; 0 or less returns the image itself.

    OpenCV's integer arithmetic for uint8 is the same on all machines.
    """
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma)) if sigma > 0 else image


def resize(image: UInt8[Array, "H W *c"], size: tuple[int, int]) -> UInt8[Array, "_ _ *c"]:
    """Resize to (height, width), blurred first if smaller: OpenCV's area mean is inexact."""
    shrink = image.shape[1] / size[1]
    if shrink > 1:
        smooth = blur(image, 0.5 * np.sqrt(shrink**2 - 1))
        return np.asarray(cv2.resize(smooth, size[::-1], interpolation=cv2.INTER_LINEAR_EXACT))
    return np.asarray(cv2.resize(image, size[::-1], interpolation=cv2.INTER_LANCZOS4))


def premultiply(sprite: UInt8[Array, "h w 4"]) -> UInt8[Array, "_ _ 4"]:
    """Premultiply RGBA colours by alpha and add a transparent rim of a pixel, for resampling."""
    whole = sprite.astype(np.uint16)
    whole[..., :3] = (whole[..., :3] * whole[..., 3:] + 127) // 255
    return np.pad(whole.astype(np.uint8), ((1, 1), (1, 1), (0, 0)))


def pack(image: UInt8[Array, "H W _"]) -> UInt64[Array, "H W"]:
    """Pack up to three channels into one word per pixel, for `warp`."""
    words = np.zeros(image.shape[:2], np.uint64)
    for channel in range(image.shape[2]):
        words |= image[..., channel].astype(np.uint64) << np.uint64(CHANNEL_BITS * channel)
    return words


def warp(
    words: UInt64[Array, "h w"], source_from_image: Float[Array, "3 3"], height: int, width: int
) -> UInt8[Array, "H W 3"]:
    """Resample a packed image linearly; beyond its border the border pixels continue.

    Positions are rounded to 1/256 px; pixels have their origin at the corner.

    Args:
        words: words made by `pack`.
        source_from_image: pixels of the result to pixels of the source.
        height: rows of the result.
        width: columns of the result.

    Returns:
        Three channels; those that were not packed are 0.
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
    """Map pixels to the source, in 1/256 px from the centre of its first pixel."""
    x, y = np.arange(width) + 0.5, (rows + 0.5)[:, None]
    (a, b, c), (d, e, f), (g, h, i) = matrix * [[1 << FRACTION_BITS], [1 << FRACTION_BITS], [1]]
    half = 1 << (FRACTION_BITS - 1)
    depth = 1 / (g * x + h * y + i)
    u = np.rint((a * x + b * y + c) * depth - half)
    v = np.rint((d * x + e * y + f) * depth - half)
    return u.astype(np.int64), v.astype(np.int64)


def _sample(
    flat: UInt64[Array, "_"], shape: tuple[int, ...], u: Int[Array, "h W"], v: Int[Array, "h W"]
) -> UInt8[Array, "h W 3"]:
    """Interpolate three channels at once, each in its part of a word."""
    one = 1 << FRACTION_BITS
    u = np.minimum(np.maximum(u, 0), (shape[1] - 1) * one - 1)
    v = np.minimum(np.maximum(v, 0), (shape[0] - 1) * one - 1)
    at = (v >> FRACTION_BITS) * shape[1] + (u >> FRACTION_BITS)
    right, down = (u & (one - 1)).astype(np.uint64), (v & (one - 1)).astype(np.uint64)
    left, up = np.uint64(one) - right, np.uint64(one) - down
    top = flat.take(at) * left + flat.take(at + 1) * right
    low = flat.take(at + shape[1]) * left + flat.take(at + shape[1] + 1) * right
    short = np.uint64(sum(0x1FFF << (CHANNEL_BITS * channel) for channel in range(3)))
    three, round_up = np.uint64(3), np.uint64(sum(1 << (CHANNEL_BITS * k + 12) for k in range(3)))
    both = ((top >> three) & short) * up + ((low >> three) & short) * down + round_up
    shifts = [np.uint64(CHANNEL_BITS * channel + 13) for channel in range(3)]
    return np.stack([(both >> shift).astype(np.uint8) for shift in shifts], axis=-1)
