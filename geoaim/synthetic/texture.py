"""What drawn ground is made of: natural noise, soft masks, and stamps of trees and vehicles."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
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


def lay(image: Float32[Array, "H W 3"], mask: Float[Array, "H W"], colour: Colour | Array) -> None:
    """Blend a colour, or a picture, into the image where the mask says."""
    image += mask[..., None] * (np.asarray(colour, np.float32) - image)


def polygon_mask(
    shape: tuple[int, int], polygons: Sequence[Float[Array, "n 2"]]
) -> Float32[Array, "H W"]:
    """Anti-aliased union of polygons given in pixels (corner origin)."""
    mask = np.zeros(shape, np.uint8)
    for polygon in polygons:
        fixed = np.rint((np.asarray(polygon) - 0.5) * 256).astype(np.int32)
        cv2.fillPoly(mask, [fixed], 255, cv2.LINE_AA, shift=8)
    return np.asarray(mask, np.float32) / 255


def draw_tree(
    radius: int, colour: Colour, light: tuple[float, float], generator: np.random.Generator
) -> UInt8[Array, "_ _ 4"]:
    """A crown from above: clumps of leaves, lit from one side, with a ragged rim.

    Args:
        radius: pixels.
        colour: of leaves in full light.
        light: direction towards the sun in the image, right and down, of length 1.
        generator: of the crown's shape.
    """
    side = 2 * int(radius * 1.2) + 1
    axis = np.linspace(-1.2, 1.2, side)
    x, y = axis[None, :], axis[:, None]
    height = np.full((side, side), -1.0)
    for rank in range(260):  # the crown is the upper surface of balls of leaves, large then small
        reach, turn = 0.85 * generator.uniform() ** 0.6, generator.uniform(0, 2 * np.pi)
        ball = generator.uniform(0.18, 0.30) if rank < 50 else generator.uniform(0.05, 0.13)
        apart = (x - reach * np.cos(turn)) ** 2 + (y - reach * np.sin(turn)) ** 2
        surface = 0.75 * np.sqrt(1 - reach**2) + np.sqrt((ball**2 - apart).clip(0))
        surface += 0.0 if rank < 50 else 0.16
        height = np.where((apart < ball**2) & (surface > height), surface, height)
    crown = height > -1
    leaves = natural_noise((side, side), 0.5, generator)
    height = np.where(crown, height, 0.2) + 0.012 * leaves
    smooth = cv2.GaussianBlur(height, (0, 0), max(radius / 40, 0.6))
    down, right = np.gradient(smooth, axis, axis)
    slope = -(right * light[0] + down * light[1]) / np.sqrt(1 + right**2 + down**2)
    hollow = smooth - cv2.GaussianBlur(height, (0, 0), radius / 6)
    shade = 0.66 + 0.30 * slope + 0.9 * hollow + 0.06 * leaves + 0.12 * (smooth - 0.6)
    rgba = np.empty((side, side, 4))
    rgba[..., :3] = shade.clip(0.15, 1.3)[..., None] * colour
    rgba[..., 3] = 255 * cv2.GaussianBlur(crown.astype(np.float32), (0, 0), 0.8)
    return np.asarray(rgba.clip(0, 255), np.uint8)


def draw_vehicle(
    length: float, width: float, colour: Colour, metres_per_pixel: float
) -> UInt8[Array, "_ _ 4"]:
    """A vehicle from above, heading right; longer than 6.5 m it is a lorry or a bus.

    Args:
        length: metres.
        width: metres.
        colour: of the paint.
        metres_per_pixel: of the sprite.
    """
    fine = 4
    margin = 3
    shape = (
        round(width / metres_per_pixel) + 2 * margin,
        round(length / metres_per_pixel) + 2 * margin,
    )
    scale = fine / metres_per_pixel
    canvas = np.zeros((shape[0] * fine, shape[1] * fine, 4), np.float32)

    def fill(points: list[tuple[float, float]], paint: Colour, alpha: float = 1.0) -> None:
        """A polygon in metres from the centre (forward, side) and its mirror image."""
        for sign in (1, -1):
            placed = [(x * scale, sign * y * scale) for x, y in points]
            centre = (canvas.shape[1] / 2, canvas.shape[0] / 2)
            mask = polygon_mask(canvas.shape[:2], [np.array(placed) + centre])
            lay(canvas, mask * alpha, np.array([*paint, 255.0]))

    paint = np.array(colour)
    light: Colour = tuple((paint * 0.9 + 26).clip(0, 250))
    dark: Colour = tuple(paint * 0.62)
    glass: Colour = (34, 40, 46)
    a, b = length / 2, width / 2
    nose = [(a, 0), (a, b * 0.5), (a - 0.16, b * 0.8), (a - 0.5, b * 0.96)]
    tail = [(-a + 0.35, b * 0.96), (-a + 0.08, b * 0.82), (-a, b * 0.5), (-a, 0)]
    fill([*nose, (0, b), *tail], dark)
    fill([(x * 0.985, y * 0.94) for x, y in [*nose, (0, b), *tail]], tuple(paint))
    if length > 6.5:
        fill([(a - 0.1, 0), (a - 0.12, b * 0.8), (a - 0.42, b * 0.86), (a - 0.45, 0)], glass)
        fill([(a - 0.7, 0), (a - 0.7, b * 0.9), (-a + 0.2, b * 0.9), (-a + 0.2, 0)], light)
        for x in np.arange(-a + 1.2, a - 1.5, 2.4):
            fill([(x, 0), (x, b * 0.5), (x + 0.9, b * 0.5), (x + 0.9, 0)], tuple(paint * 0.8))
    else:
        screen, rear = 0.16 * length, -0.30 * length
        fill(
            [(a - 0.75, 0), (a - 0.7, b * 0.2), (screen + 0.65, b * 0.75), (screen + 0.6, 0)], light
        )
        fill(
            [
                (screen + 0.62, 0),
                (screen + 0.42, b * 0.82),
                (rear - 0.35, b * 0.8),
                (rear - 0.48, 0),
            ],
            glass,
        )
        fill([(screen, 0), (screen - 0.08, b * 0.70), (rear + 0.1, b * 0.68), (rear, 0)], light)
        fill(
            [(screen - 0.3, 0), (screen - 0.35, b * 0.5), (rear + 0.5, b * 0.5), (rear + 0.45, 0)],
            tuple((paint * 0.96 + 14).clip(0, 252)),
        )
        fill([(screen + 0.3, b * 0.98), (screen + 0.42, b * 1.08), (screen + 0.22, b * 1.08)], dark)
    fill(
        [(a - 0.05, b * 0.5), (a - 0.18, b * 0.78), (a - 0.34, b * 0.84), (a - 0.2, b * 0.5)],
        (225, 228, 224),
        0.8,
    )
    fill(
        [(-a + 0.04, b * 0.45), (-a + 0.12, b * 0.8), (-a + 0.25, b * 0.84), (-a + 0.14, b * 0.45)],
        (150, 30, 28),
        0.85,
    )
    alpha = canvas[..., 3:] / 255
    small = cv2.resize(
        np.dstack([canvas[..., :3] * alpha, alpha]), shape[::-1], interpolation=cv2.INTER_AREA
    )
    small[..., :3] /= small[..., 3:].clip(1e-3)
    small[..., 3] *= 255
    return np.asarray(np.rint(small.clip(0, 255)), np.uint8)
