"""Sprites seen from above: crowns of trees, vehicles, pedestrians and cyclists."""

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from benchmarks.synthetic.exact import blur
from benchmarks.synthetic.scenery.texture import Colour, blend, rasterize_polygons, to_share

SUPERSAMPLING = 4  # times the resolution at which vehicles and pedestrians are drawn
MARGIN = 3  # px, transparent rim around them
GLASS: Colour = (34, 40, 46)
LAMP: Colour = (222, 225, 222)
TAIL_LAMP: Colour = (146, 34, 32)
HAIR: Colour = (58.8, 52.8, 45.6)
LARGE, SMALL = 50, 170  # balls of leaves of a crown
LORRY_LENGTH_M, BUS_LENGTH_M = 6.5, 11.0  # longer vehicles are lorries, and buses
HEIGHTS = 16384.0  # parts of a radius that the height of a crown is rounded to, to be blurred
Outline = list[tuple[float, float]]  # metres forward of the middle and to the side; mirrored


def draw_tree(
    radius: int,
    colour: Colour,
    light: tuple[float, float],
    grain: Float32[Array, "_ _"],
    generator: np.random.Generator,
) -> UInt8[Array, "_ _ 4"]:
    """Draw a crown from above: clumps of leaves, lit from one side, with a ragged rim.

    Args:
        radius: pixels.
        colour: RGB of leaves in full light, 0 to 255.
        light: direction towards the sun in the image, right and down, of length 1.
        grain: noise of variance 1; each side is longer than 2.4 x radius, pixels.
        generator: source of the crown's shape.

    Returns:
        RGBA, 0 to 255: a square with a side of 2.4 radii, the crown in its middle and the rest
        transparent.
    """
    side = 2 * int(radius * 1.2) + 1
    axis = np.linspace(-1.2, 1.2, side)
    height = _make_crown(axis, generator)
    crown = height > -1
    leaves = grain[:side, :side]
    height = np.where(crown, height, 0.2) + 0.012 * leaves
    smooth = _smooth(height, max(radius / 40, 0.6))
    down, right = np.gradient(smooth, axis, axis)
    slope = -(right * light[0] + down * light[1]) / np.sqrt(1 + right**2 + down**2)
    hollow = smooth - _smooth(height, radius / 6)
    shade = 0.66 + 0.30 * slope + 0.9 * hollow + 0.06 * leaves + 0.12 * (smooth - 0.6)
    rgba = np.empty((side, side, 4))
    rgba[..., :3] = np.minimum(np.maximum(shade, 0.15), 1.3)[..., None] * colour
    rgba[..., 3] = blur(np.where(crown, 255, 0).astype(np.uint8), 0.8)
    return np.rint(np.minimum(np.maximum(rgba, 0), 255)).astype(np.uint8)


def _make_crown(axis: Float[Array, "n"], generator: np.random.Generator) -> Float[Array, "n n"]:
    """Compute the upper surface of balls of leaves, large then small; -1 outside."""
    count = LARGE + min(SMALL, len(axis))
    reach = 0.85 * generator.uniform(size=count) ** 0.6
    turn = generator.uniform(0, 2 * np.pi, count)
    large = np.arange(count) < LARGE
    balls = generator.uniform(np.where(large, 0.18, 0.05), np.where(large, 0.30, 0.13))
    middles = np.stack([reach * np.cos(turn), reach * np.sin(turn)])
    spans = np.searchsorted(axis, [middles - balls, middles + balls])  # (2, 2, count)
    bases = 0.75 * np.sqrt(1 - reach**2) + np.where(large, 0.0, 0.16)
    height = np.full((len(axis), len(axis)), -1.0)
    for k in range(count):
        left, right, top, bottom = spans[0, 0, k], spans[1, 0, k], spans[0, 1, k], spans[1, 1, k]
        across, down = axis[left:right] - middles[0, k], axis[top:bottom, None] - middles[1, k]
        room = balls[k] ** 2 - across * across - down * down
        part = height[top:bottom, left:right]
        surface = bases[k] + np.sqrt(np.maximum(room, 0))
        np.copyto(part, surface, where=(room > 0) & (surface > part))
    return height


def _smooth(height: Float[Array, "n n"], sigma: float) -> Float[Array, "n n"]:
    """Blur heights of -1 to 2 in integers."""
    whole = np.rint((height + 1) * HEIGHTS).astype(np.uint16)
    return np.asarray(cv2.GaussianBlur(whole, (0, 0), sigma), np.float64) / HEIGHTS - 1


def draw_vehicle(
    length: float, width: float, colour: Colour, resolution: float
) -> UInt8[Array, "_ _ 4"]:
    """Draw a vehicle from above, heading right: a lorry above 6.5 m of length, a bus above 11 m.

    Args:
        length: metres.
        width: metres.
        colour: RGB of the paint, 0 to 255.
        resolution: metres per pixel.

    Returns:
        RGBA, centred, with a transparent rim of `MARGIN` pixels.
    """
    a, b = length / 2, width / 2
    parts = _outline_car(a, b, colour) if length <= LORRY_LENGTH_M else _outline_lorry(a, b, colour)
    parts = _outline_bus(a, b, colour) if length > BUS_LENGTH_M else parts
    return _draw_outlines((length, width), [*_outline_body(a, b, colour), *parts], resolution)


def draw_pedestrian(
    colour: Colour, resolution: float, *, cycle: bool = False
) -> UInt8[Array, "_ _ 4"]:
    """Draw a pedestrian or a cyclist from above, heading right.

    Args:
        colour: RGB of the clothes, 0 to 255.
        resolution: metres per pixel.
        cycle: whether to draw a cycle below.

    Returns:
        RGBA, centred, with a transparent rim of `MARGIN` pixels.
    """
    shoulders = [(0.14, 0), (0.12, 0.2), (0.02, 0.27), (-0.1, 0.24), (-0.14, 0)]
    hair = [(0.11, 0), (0.07, 0.09), (-0.04, 0.1), (-0.1, 0)]
    parts: list[tuple[Outline, Colour]] = [(shoulders, colour), (hair, HAIR)]
    if cycle:
        wheels: Outline = [(0.9, 0), (0.88, 0.04), (-0.88, 0.04), (-0.9, 0)]
        bars: Outline = [(0.45, 0), (0.42, 0.28), (0.36, 0.28), (0.38, 0)]
        parts = [(wheels, GLASS), (bars, _mix(GLASS, 1.6)), *parts]
    size = (1.8, 0.65) if cycle else (0.5, 0.6)
    return _draw_outlines(size, parts, resolution)


def _draw_outlines(
    size: tuple[float, float], parts: list[tuple[Outline, Colour]], resolution: float
) -> UInt8[Array, "_ _ 4"]:
    """Draw mirrored outlines one over the other, and reduce them."""
    shape = [round(side / resolution) + 2 * MARGIN for side in size[::-1]]
    canvas = np.zeros((shape[0] * SUPERSAMPLING, shape[1] * SUPERSAMPLING, 4), np.float32)
    middle = np.array(canvas.shape[1::-1]) / 2
    for outline, paint in parts:
        for side in (1, -1):
            corners = np.array(outline) * [1, side] * SUPERSAMPLING / resolution + middle
            mask = rasterize_polygons((canvas.shape[0], canvas.shape[1]), [[corners]])
            blend(canvas, to_share(mask), (*paint, 255.0))
    canvas[..., :3] *= canvas[..., 3:] / 255
    cells = canvas.reshape(shape[0], SUPERSAMPLING, shape[1], SUPERSAMPLING, 4)
    small = cells.mean(axis=(1, 3), dtype=np.float64)
    small[..., :3] /= np.maximum(small[..., 3:] / 255, 1e-3)
    return np.rint(np.minimum(np.maximum(small, 0), 255)).astype(np.uint8)


def _mix(colour: Colour, factor: float, light: float = 0.0) -> Colour:
    red, green, blue = (min(channel * factor + light, 250.0) for channel in colour)
    return red, green, blue


def _outline_body(a: float, b: float, colour: Colour) -> list[tuple[Outline, Colour]]:
    outline = [(a, 0), (a, b * 0.5), (a - 0.16, b * 0.8), (a - 0.5, b * 0.96), (0, b)]
    outline += [(-a + 0.35, b * 0.96), (-a + 0.08, b * 0.82), (-a, b * 0.5), (-a, 0)]
    front = [(a - 0.05, 0.5 * b), (a - 0.18, 0.78 * b), (a - 0.34, 0.84 * b), (a - 0.2, 0.5 * b)]
    rear = [(0.04 - a, 0.45 * b), (0.12 - a, 0.8 * b), (0.25 - a, 0.84 * b), (0.14 - a, 0.45 * b)]
    inner = [(x * 0.985, y * 0.94) for x, y in outline]
    return [(outline, _mix(colour, 0.62)), (inner, colour), (front, LAMP), (rear, TAIL_LAMP)]


def _outline_car(a: float, b: float, colour: Colour) -> list[tuple[Outline, Colour]]:
    screen, rear = 0.32 * a, -0.6 * a
    bonnet = [(a - 0.75, 0), (a - 0.7, b * 0.2), (screen + 0.65, b * 0.75), (screen + 0.6, 0)]
    glass = [(screen + 0.62, 0), (screen + 0.42, b * 0.82), (rear - 0.35, b * 0.8)]
    glass.append((rear - 0.48, 0))
    roof = [(screen, 0), (screen - 0.08, b * 0.7), (rear + 0.1, b * 0.68), (rear, 0)]
    top = [(screen - 0.3, 0), (screen - 0.35, b * 0.5), (rear + 0.5, b * 0.5), (rear + 0.45, 0)]
    mirror = [(screen + 0.3, b * 0.98), (screen + 0.42, b * 1.08), (screen + 0.22, b * 1.08)]
    light = _mix(colour, 0.9, 26)
    paints = [light, GLASS, light, _mix(colour, 0.96, 14), _mix(colour, 0.62)]
    return list(zip([bonnet, glass, roof, top, mirror], paints, strict=True))


def _outline_bus(a: float, b: float, colour: Colour) -> list[tuple[Outline, Colour]]:
    screen = [(a - 0.1, 0), (a - 0.12, b * 0.8), (a - 0.42, b * 0.86), (a - 0.45, 0)]
    roof = [(a - 0.7, 0), (a - 0.7, b * 0.9), (-a + 0.2, b * 0.9), (-a + 0.2, 0)]
    hatches = [
        [(x, 0.0), (x, b * 0.5), (x + 0.9, b * 0.5), (x + 0.9, 0.0)]
        for x in np.arange(1.2 - a, a - 1.5, 2.4).tolist()
    ]
    shut = _mix(colour, 0.8)
    return [(screen, GLASS), (roof, _mix(colour, 0.9, 26)), *[(hatch, shut) for hatch in hatches]]


def _outline_lorry(a: float, b: float, colour: Colour) -> list[tuple[Outline, Colour]]:
    """Outline a cab and a box behind it."""
    screen: Outline = [(a - 0.1, 0), (a - 0.12, b * 0.8), (a - 0.4, b * 0.86), (a - 0.42, 0)]
    cab: Outline = [(a - 0.5, 0), (a - 0.5, b * 0.9), (a - 1.7, b * 0.9), (a - 1.7, 0)]
    gap: Outline = [(a - 1.7, 0), (a - 1.7, b * 0.8), (a - 2.0, b * 0.8), (a - 2.0, 0)]
    box: Outline = [(a - 2.0, 0), (a - 2.0, b), (-a, b), (-a, 0)]
    top: Outline = [(a - 2.1, 0), (a - 2.1, b * 0.94), (0.1 - a, b * 0.94), (0.1 - a, 0)]
    pale: Colour = (206, 206, 202)
    paints = [GLASS, _mix(colour, 0.9, 26), GLASS, _mix(pale, 0.8), pale]
    return list(zip([screen, cab, gap, box, top], paints, strict=True))
