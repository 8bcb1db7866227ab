"""Natural noise, masks of polygons, and blending."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8
from numpy import ndarray as Array

Colour = tuple[float, float, float]
NOISE_LEVELS = 1024.0  # steps per standard deviation to which noise is rounded
FRACTION_BITS = 8  # bits of a fraction of a pixel in polygons
SUPERSAMPLING = 4  # times the resolution at which polygons are filled
ROWS_FILLED = 256  # rows filled at a time
ROWS_BLENDED = 32  # rows blended at a time, so that they stay in the cache


def make_natural_noise(
    shape: tuple[int, int], slope: float, generator: np.random.Generator
) -> Float32[Array, "H W"]:
    """Make periodic noise whose amplitude is proportional to frequency to the power -slope.

    Args:
        shape: height and width.
        slope: 0 for white noise, about 1 for natural images (Field 1987), 2 for smooth hills.
        generator: source of randomness.

    Returns:
        Noise of mean 0 and variance 1.
    """
    white = generator.standard_normal(shape)
    down, right = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    radius = np.sqrt(down**2 + right**2)
    radius[0, 0] = np.inf
    shaped = np.fft.irfft2(np.fft.rfft2(white) * radius**-slope, s=shape)
    shaped -= shaped.mean()
    return np.asarray(np.rint(shaped * (NOISE_LEVELS / shaped.std())) / NOISE_LEVELS, np.float32)


def rasterize_polygons(
    shape: tuple[int, int], polygons: Sequence[Sequence[Float[Array, "_ 2"]]]
) -> UInt8[Array, "H W"]:
    """Compute how much of each pixel a union of polygons covers: 0 none, 255 all.

    `shape` is height and width. Polygons (outline and holes, in pixels from the corner) are filled
    at four times the resolution, as OpenCV's own anti-aliasing would widen them by 0.7 px.
    """
    mask = np.zeros(shape, np.uint8)
    if mask.size == 0 or not polygons:
        return mask
    fixed = [[_to_fixed_point(ring) for ring in rings] for rings in polygons]
    spans = [(r[0][:, 1].min() >> FRACTION_BITS, r[0][:, 1].max() >> FRACTION_BITS) for r in fixed]
    for top in range(0, shape[0], ROWS_FILLED):
        rows = min(ROWS_FILLED, shape[0] - top)
        band = np.zeros((SUPERSAMPLING * rows, SUPERSAMPLING * shape[1]), np.uint8)
        up = np.array([0, (SUPERSAMPLING * top) << FRACTION_BITS], np.int32)
        for rings, (first, last) in zip(fixed, spans, strict=True):
            if last >= SUPERSAMPLING * top - 1 and first <= SUPERSAMPLING * (top + rows):
                moved = [ring - up for ring in rings]
                cv2.fillPoly(band, moved, 255, cv2.LINE_8, shift=FRACTION_BITS)
        mask[top : top + rows] = cv2.resize(band, (shape[1], rows), interpolation=cv2.INTER_AREA)
    return mask


def to_share(mask: UInt8[Array, "*n"]) -> Float32[Array, "*n"]:
    """Convert a mask of 0 to 255 to shares of 0 to 1."""
    return mask.astype(np.float32) / np.float32(255)


def _to_fixed_point(ring: Float[Array, "_ 2"]) -> Int32[Array, "_ 2"]:
    """Convert a ring to the finer resolution, in OpenCV's fixed-point numbers."""
    return np.rint((np.asarray(ring) * SUPERSAMPLING - 0.5) * (1 << FRACTION_BITS)).astype(np.int32)


def blend(
    image: Float32[Array, "H W c"],
    mask: Float32[Array, "H W"],
    colour: tuple[float, ...] | Float[Array, "*_ c"],
) -> None:
    """Blend a colour or an image into an image.

    Args:
        image: changed in place.
        mask: opacity, 0 to 1.
        colour: a colour of C numbers, or an image (H, W, C).
    """
    paint = np.asarray(colour, np.float32)
    for top in range(0, len(image), ROWS_BLENDED):
        rows = slice(top, top + ROWS_BLENDED)
        change = (paint[rows] if paint.ndim == 3 else paint) - image[rows]
        change *= mask[rows, :, None]
        image[rows] += change


def darken(
    image: Float32[Array, "H W 3"], mask: Float32[Array, "H W"], share: float | Array
) -> None:
    """Darken an image.

    Args:
        image: changed in place.
        mask: how strongly each pixel is darkened, 0 to 1.
        share: share of the light that is taken, 0 to 1: a number, one for each channel, or an
            array that is broadcast to (H, W, 3).
    """
    image *= 1 - mask[..., None] * np.asarray(share, np.float32)
