"""What drawn pictures are made of: natural noise, soft masks, blending."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

Colour = tuple[float, float, float]


def natural_noise(
    shape: tuple[int, int], slope: float, generator: np.random.Generator
) -> Float32[Array, "H W"]:
    """Noise of mean 0 and variance 1 whose amplitude falls as frequency to the power -slope.

    Pictures of nature have a slope of about 1 (Field 1987); 0 is white, 2 is smooth hills.
    """
    rows = cv2.getOptimalDFTSize(shape[0])
    columns = cv2.getOptimalDFTSize(shape[1])
    white = generator.standard_normal((rows, columns), dtype=np.float32)
    radius = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)[None, :])
    radius[0, 0] = np.inf
    shaped = np.fft.irfft2(np.fft.rfft2(white) * radius**-slope, s=(rows, columns))
    shaped = shaped[: shape[0], : shape[1]]
    return np.asarray((shaped - shaped.mean()) / shaped.std(), np.float32)


def soft(distance: Float[Array, "H W"], edge: float) -> Float[Array, "H W"]:
    """1 where a signed distance is negative, 0 where positive, blended over `edge` around 0."""
    return np.asarray((0.5 - distance / edge).clip(0, 1), np.float32)


def lay(
    image: Float32[Array, "H W c"], mask: Float[Array, "H W"], colour: tuple[float, ...] | Array
) -> None:
    """Blend a colour, or a picture, into the image where the mask says."""
    image += mask[..., None] * (np.asarray(colour, np.float32) - image)


def darken(image: Float32[Array, "H W 3"], mask: Float[Array, "H W"], share: float | Array) -> None:
    """Take a share of the light where the mask says."""
    image *= 1 - mask[..., None] * np.asarray(share, np.float32)


def polygon_mask(
    shape: tuple[int, int], polygons: Sequence[Float[Array, "_ 2"]]
) -> Float32[Array, "H W"]:
    """Anti-aliased union of polygons given in pixels (corner origin)."""
    mask = np.zeros(shape, np.uint8)
    for polygon in polygons:
        fixed = np.rint((np.asarray(polygon) - 0.5) * 256).astype(np.int32)
        cv2.fillPoly(mask, [fixed], 255, cv2.LINE_AA, shift=8)
    return np.asarray(mask, np.float32) / 255
