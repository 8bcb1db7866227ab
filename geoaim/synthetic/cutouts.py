"""What is seen from above and cut out: crowns of trees, cars, lorries."""

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.synthetic.texture import Colour, lay, natural_noise, polygon_mask

FINER = 4  # vehicles are drawn at this many times their resolution
MARGIN = 3  # px of air around a vehicle
GLASS: Colour = (34, 40, 46)
LAMP: Colour = (222, 225, 222)
TAIL_LAMP: Colour = (146, 34, 32)
Outline = list[tuple[float, float]]  # metres forward of the middle and to the side; mirrored


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
    """A vehicle from above, heading right, centred; longer than 6.5 m it is a bus.

    Args:
        length: metres.
        width: metres.
        colour: of the paint.
        metres_per_pixel: of the sprite.
    """
    shape = [round(side / metres_per_pixel) + 2 * MARGIN for side in (width, length)]
    canvas = np.zeros((shape[0] * FINER, shape[1] * FINER, 4), np.float32)
    middle = np.array(canvas.shape[1::-1]) / 2
    parts = (
        _bus(length / 2, width / 2, colour) if length > 6.5 else _car(length / 2, width / 2, colour)
    )
    for outline, paint in [*_body(length / 2, width / 2, colour), *parts]:
        for side in (1, -1):
            corners = np.array(outline) * [1, side] * FINER / metres_per_pixel + middle
            lay(canvas, polygon_mask(canvas.shape[:2], [corners]), (*paint, 255.0))
    canvas[..., :3] *= canvas[..., 3:] / 255
    small = np.asarray(cv2.resize(canvas, shape[::-1], interpolation=cv2.INTER_AREA), np.float32)
    small[..., :3] /= (small[..., 3:] / 255).clip(1e-3)
    return np.asarray(np.rint(small.clip(0, 255)), np.uint8)


def _mixed(colour: Colour, factor: float, light: float = 0.0) -> Colour:
    red, green, blue = (min(channel * factor + light, 250.0) for channel in colour)
    return red, green, blue


def _body(a: float, b: float, colour: Colour) -> list[tuple[Outline, Colour]]:
    outline = [(a, 0), (a, b * 0.5), (a - 0.16, b * 0.8), (a - 0.5, b * 0.96), (0, b)]
    outline += [(-a + 0.35, b * 0.96), (-a + 0.08, b * 0.82), (-a, b * 0.5), (-a, 0)]
    front = [(a - 0.05, 0.5 * b), (a - 0.18, 0.78 * b), (a - 0.34, 0.84 * b), (a - 0.2, 0.5 * b)]
    rear = [(0.04 - a, 0.45 * b), (0.12 - a, 0.8 * b), (0.25 - a, 0.84 * b), (0.14 - a, 0.45 * b)]
    inner = [(x * 0.985, y * 0.94) for x, y in outline]
    return [(outline, _mixed(colour, 0.62)), (inner, colour), (front, LAMP), (rear, TAIL_LAMP)]


def _car(a: float, b: float, colour: Colour) -> list[tuple[Outline, Colour]]:
    screen, rear = 0.32 * a, -0.6 * a
    bonnet = [(a - 0.75, 0), (a - 0.7, b * 0.2), (screen + 0.65, b * 0.75), (screen + 0.6, 0)]
    glass = [
        (screen + 0.62, 0),
        (screen + 0.42, b * 0.82),
        (rear - 0.35, b * 0.8),
        (rear - 0.48, 0),
    ]
    roof = [(screen, 0), (screen - 0.08, b * 0.7), (rear + 0.1, b * 0.68), (rear, 0)]
    top = [(screen - 0.3, 0), (screen - 0.35, b * 0.5), (rear + 0.5, b * 0.5), (rear + 0.45, 0)]
    mirror = [(screen + 0.3, b * 0.98), (screen + 0.42, b * 1.08), (screen + 0.22, b * 1.08)]
    light = _mixed(colour, 0.9, 26)
    paints = [light, GLASS, light, _mixed(colour, 0.96, 14), _mixed(colour, 0.62)]
    return list(zip([bonnet, glass, roof, top, mirror], paints, strict=True))


def _bus(a: float, b: float, colour: Colour) -> list[tuple[Outline, Colour]]:
    screen = [(a - 0.1, 0), (a - 0.12, b * 0.8), (a - 0.42, b * 0.86), (a - 0.45, 0)]
    roof = [(a - 0.7, 0), (a - 0.7, b * 0.9), (-a + 0.2, b * 0.9), (-a + 0.2, 0)]
    hatches = [
        [(x, 0.0), (x, b * 0.5), (x + 0.9, b * 0.5), (x + 0.9, 0.0)]
        for x in np.arange(1.2 - a, a - 1.5, 2.4).tolist()
    ]
    shut = _mixed(colour, 0.8)
    return [(screen, GLASS), (roof, _mixed(colour, 0.9, 26)), *[(hatch, shut) for hatch in hatches]]
