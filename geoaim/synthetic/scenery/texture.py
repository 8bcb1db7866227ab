"""What drawn pictures are made of: natural noise, masks of polygons, blending."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8
from numpy import ndarray as Array

Colour = tuple[float, float, float]
LEVELS = 1024.0  # parts of its deviation that noise is rounded to
FIXED = 8  # bits of a pixel's fraction in polygons
FINER = 4  # times the resolution at which polygons are filled
COVER = 256  # rows that are filled at a time
BAND = 32  # rows that are blended at a time, so that they stay in the cache


def make_natural_noise(
    shape: tuple[int, int], slope: float, generator: np.random.Generator
) -> Float32[Array, "H W"]:
    """Noise of mean 0 and variance 1 whose amplitude falls as frequency to the power -slope.

    Pictures of nature have a slope of about 1 (Field 1987); 0 is white, 2 is smooth hills. The
    field goes on at its other side, as on a torus.
    """
    white = generator.standard_normal(shape)
    down, right = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    radius = np.sqrt(down**2 + right**2)
    radius[0, 0] = np.inf
    shaped = np.fft.irfft2(np.fft.rfft2(white) * radius**-slope, s=shape)
    shaped -= shaped.mean()
    return np.asarray(np.rint(shaped * (LEVELS / shaped.std())) / LEVELS, np.float32)


def rasterize_polygons(
    shape: tuple[int, int], polygons: Sequence[Sequence[Float[Array, "_ 2"]]]
) -> UInt8[Array, "H W"]:
    """The share of each pixel that a union of polygons covers, 0 to 255.

    Polygons are in pixels (corner origin), each its outline and its holes. They are filled at
    four times the resolution, some rows at a time: OpenCV's own anti-aliasing would widen each by
    0.7 px. What is left is an eighth of a pixel on each side.
    """
    mask = np.zeros(shape, np.uint8)
    if mask.size == 0 or not polygons:
        return mask
    fixed = [[_to_fixed_point(ring) for ring in rings] for rings in polygons]
    spans = [(r[0][:, 1].min() >> FIXED, r[0][:, 1].max() >> FIXED) for r in fixed]
    for top in range(0, shape[0], COVER):
        rows = min(COVER, shape[0] - top)
        band = np.zeros((FINER * rows, FINER * shape[1]), np.uint8)
        up = np.array([0, (FINER * top) << FIXED], np.int32)
        for rings, (first, last) in zip(fixed, spans, strict=True):
            if last >= FINER * top - 1 and first <= FINER * (top + rows):
                cv2.fillPoly(band, [ring - up for ring in rings], 255, cv2.LINE_8, shift=FIXED)
        small = cv2.resize(band, (shape[1], rows), interpolation=cv2.INTER_AREA)
        mask[top : top + rows] = small
    return mask


def _to_fixed_point(ring: Float[Array, "_ 2"]) -> Int32[Array, "_ 2"]:
    """A ring at the finer resolution, in OpenCV's fixed-point numbers."""
    return np.rint((np.asarray(ring) * FINER - 0.5) * (1 << FIXED)).astype(np.int32)


def blend(
    image: Float32[Array, "H W c"],
    mask: Float32[Array, "H W"],
    colour: tuple[float, ...] | Float[Array, "*_ c"],
) -> None:
    """Blend a colour, or a picture, into the image where the mask says."""
    paint = np.asarray(colour, np.float32)
    for top in range(0, len(image), BAND):
        rows = slice(top, top + BAND)
        change = (paint[rows] if paint.ndim == 3 else paint) - image[rows]
        change *= mask[rows, :, None]
        image[rows] += change


def darken(
    image: Float32[Array, "H W 3"], mask: Float32[Array, "H W"], share: float | Array
) -> None:
    """Take a share of the light where the mask says."""
    image *= 1 - mask[..., None] * np.asarray(share, np.float32)
