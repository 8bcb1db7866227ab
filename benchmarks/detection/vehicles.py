"""Vehicles drawn from above in two and a half dimensions: what stands higher leans further."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

Colour = tuple[float, float, float]
SUBPIXEL = 4  # bits of fractions of a pixel that OpenCV draws polygons with
BODY_HEIGHT, BASE_HEIGHT = 0.9, 0.3  # metres, of bonnet and sill above the ground


@dataclass(frozen=True)
class Vehicle:
    """A vehicle in the plane, in metres, right and down; the heading is clockwise from right."""

    x: float
    y: float
    heading: float
    length: float
    width: float
    height: float
    kind: str


@dataclass(frozen=True)
class Canvas:
    """A picture that is drawn on, and how metres become pixels."""

    image: UInt8[Array, "H W 3"]
    scale: float  # pixels a metre
    lean: tuple[float, float]  # metres right and down by which a metre of height leans
    sun: tuple[float, float]  # metres right and down of the shadow of a metre of height

    def fill(self, points: Float[Array, "N 2"], colour: Colour, height: float = 0.0) -> None:
        """Fill a polygon that lies at a height, all in metres."""
        cv2.fillPoly(self.image, [self.convert(points, height)], colour, cv2.LINE_AA, SUBPIXEL)

    def fill_hull(self, points: Float[Array, "N 2"], colour: Colour) -> None:
        """Fill the convex hull of points in metres, at the ground."""
        self.fill(cv2.convexHull(np.asarray(points, np.float32))[:, 0], colour)

    def convert(self, points: Float[Array, "N 2"], height: float = 0.0) -> Array:
        """Convert points in metres at a height to what OpenCV draws."""
        moved = (np.asarray(points) + np.array(self.lean) * height) * self.scale - 0.5
        return np.round(moved * 2**SUBPIXEL).astype(np.int32)


def make_vehicle(x: float, y: float, heading: float, generator: np.random.Generator) -> Vehicle:
    """Make a vehicle of a usual kind and size."""
    g = generator
    kinds = ["sedan", "hatch", "estate", "pickup", "van", "truck", "bus", "long"]
    kind = str(g.choice(kinds, p=[0.3, 0.2, 0.25, 0.04, 0.09, 0.06, 0.04, 0.02]))
    length, width, height = {
        "sedan": (g.normal(4.65, 0.25), g.normal(1.82, 0.05), 1.45),
        "hatch": (g.normal(3.95, 0.25), g.normal(1.74, 0.06), 1.5),
        "estate": (g.normal(4.6, 0.25), g.normal(1.86, 0.06), 1.65),
        "pickup": (g.normal(5.3, 0.2), g.normal(1.9, 0.06), 1.8),
        "van": (g.uniform(4.7, 7.2), g.uniform(1.9, 2.15), g.uniform(1.9, 2.7)),
        "truck": (g.uniform(5.5, 10.5), g.uniform(2.1, 2.55), g.uniform(2.6, 3.8)),
        "bus": (g.uniform(7.5, 13), g.uniform(2.4, 2.6), g.uniform(2.8, 3.3)),
        "long": (g.uniform(13, 18.5), 2.55, g.uniform(3.0, 4.0)),
    }[kind]
    return Vehicle(x, y, heading, float(length), float(width), float(height), kind)


def get_corners(
    x: float, y: float, heading: float, length: float, width: float
) -> Float[Array, "4 2"]:
    """Get the corners of an oriented rectangle."""
    c, s = np.cos(heading), np.sin(heading)
    q = np.array([[length, width], [-length, width], [-length, -width], [length, -width]]) / 2
    return q @ np.array([[c, s], [-s, c]]) + [x, y]


def draw_vehicle(canvas: Canvas, vehicle: Vehicle, generator: np.random.Generator) -> None:
    """Draw a vehicle, without its shadow."""
    pen = _Pen(canvas, vehicle, generator)
    _DRAWINGS[vehicle.kind](pen, generator)


def pick_paint(generator: np.random.Generator) -> Colour:
    """Pick a paint: white, grey, silver, black, or a colour."""
    g = generator
    if g.uniform() < 0.75:
        grey = g.choice([g.uniform(8, 50), g.uniform(70, 150), g.uniform(150, 205), 235])
        return _clip(grey + g.normal(0, 5, 3) + g.normal(0, 8))
    hue = g.choice([g.integers(180), g.integers(100, 125), g.integers(-8, 8) % 180])
    hsv = np.array([[[hue, g.integers(60, 220), g.integers(35, 215)]]], np.uint8)
    return _clip(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0])


def _clip(colour: Array | Colour) -> Colour:
    r, g, b = np.clip(np.asarray(colour, float), 0, 255)
    return float(r), float(g), float(b)


class _Pen:
    """Draws in a vehicle's own axes: forward and right, shares of half its length and width."""

    def __init__(self, canvas: Canvas, vehicle: Vehicle, generator: np.random.Generator) -> None:
        self.canvas, self.vehicle, self.paint = canvas, vehicle, pick_paint(generator)
        bright = generator.uniform() < 0.2  # glass that mirrors the sky
        self.glass = _clip(
            generator.uniform(90, 190) * np.array([0.9, 1, 1.08])
            if bright
            else generator.uniform(8, 60) * np.array([0.9, 1, 1.1])
        )
        self.light = generator.uniform(0.85, 1.2)

    def place(self, shares: Sequence[tuple[float, float]]) -> Float[Array, "N 2"]:
        v = self.vehicle
        q = np.array(shares) * [v.length / 2, v.width / 2]
        c, s = np.cos(v.heading), np.sin(v.heading)
        return q @ np.array([[c, s], [-s, c]]) + [v.x, v.y]

    def fill(self, shares: list[tuple[float, float]], colour: Colour, height: float) -> None:
        self.canvas.fill(self.place(shares), colour, height)

    def box(self, rear: float, front: float, half: float, colour: Colour, height: float) -> None:
        self.fill([(rear, -half), (front, -half), (front, half), (rear, half)], colour, height)

    def block(
        self, outline: Sequence[tuple[float, float]], heights: tuple[float, float], colour: Colour
    ) -> None:
        """Fill what stands between two heights: its sides, darker, then its top."""
        points, lean = self.place(outline), np.array(self.canvas.lean)
        sides = np.concatenate([points + lean * h for h in heights])
        self.canvas.fill_hull(sides, _clip(np.array(colour) * 0.6))
        self.canvas.fill(points, colour, heights[1])

    def tone(self, factor: float) -> Colour:
        return _clip(np.array(self.paint) * factor)


def _outline(nose: float, tail: float) -> list[tuple[float, float]]:
    """Get a rounded outline that is narrower at its ends, from the rear on the right side."""
    side = [(-1.0, 0.55 * tail), (-0.94, 0.86 * tail), (-0.75, 1.0), (0.6, 1.0)]
    side += [(0.88, 0.9 * nose), (0.97, 0.7 * nose), (1.0, 0.4 * nose)]
    return [(x, y) for x, y in side] + [(x, -y) for x, y in reversed(side)]


def _draw_car(pen: _Pen, generator: np.random.Generator) -> None:
    g, kind, top = generator, pen.vehicle.kind, pen.vehicle.height
    outline = _outline(g.uniform(0.82, 1), g.uniform(0.88, 1))
    pen.block(outline, (BASE_HEIGHT, BODY_HEIGHT), pen.paint)
    pen.fill([(0.3, -0.8), (0.93, -0.6), (0.93, 0.6), (0.3, 0.8)], pen.tone(pen.light), BODY_HEIGHT)
    rear_glass, rear_roof = {
        "sedan": (g.uniform(-0.72, -0.6), g.uniform(-0.5, -0.35)),
        "hatch": (g.uniform(-0.95, -0.85), g.uniform(-0.75, -0.62)),
        "estate": (g.uniform(-0.96, -0.9), g.uniform(-0.86, -0.78)),
        "pickup": (-0.22, -0.15),
    }[kind]
    front_glass = g.uniform(0.3, 0.48)
    front_roof = front_glass - g.uniform(0.22, 0.34)
    low, high = g.uniform(0.84, 0.92), g.uniform(0.66, 0.76)
    base = [(rear_glass, -low * 0.92), (front_glass, -low * 0.9)]
    base += [(x, -y) for x, y in reversed(base)]
    roof = [(rear_roof, -high), (front_roof, -high), (front_roof, high), (rear_roof, high)]
    points, lean = pen.place(base + roof), np.array(pen.canvas.lean)
    heights = np.array([BODY_HEIGHT] * 4 + [top] * 4)[:, None]
    pen.canvas.fill_hull(points + lean * heights, pen.glass)
    if g.uniform() < 0.6:  # pillars
        for k in range(4):
            ends = points[[k, k + 4]] + lean * heights[[k, k + 4]]
            line = pen.canvas.convert(ends)
            tone = pen.tone(0.8)
            cv2.line(pen.canvas.image, line[0], line[1], tone, 1, cv2.LINE_AA, SUBPIXEL)
    black_roof = g.uniform() < 0.08
    pen.fill(roof, (25, 26, 28) if black_roof else pen.tone(g.uniform(0.9, 1.15)), top)
    if g.uniform() < 0.2:  # glass in the roof, bars, or a box
        pen.box(rear_roof + 0.1, front_roof - 0.06, 0.45, pen.glass, top)
    elif g.uniform() < 0.1:
        pen.box(rear_roof, front_roof, 0.4, (30, 30, 30), top + 0.2)
    if kind == "pickup":
        pen.box(-0.95, -0.25, 0.8, pen.tone(0.45) if g.uniform() < 0.7 else (30, 30, 32), 0.85)
    _draw_lamps(pen, generator)


def _draw_lamps(pen: _Pen, generator: np.random.Generator) -> None:
    for side in (-1, 1):
        if generator.uniform() < 0.6:
            lamp = [(0.88, side * 0.62), (0.96, side * 0.5), (0.96, side * 0.8), (0.88, side * 0.9)]
            pen.fill(lamp, (215, 218, 215), BODY_HEIGHT)
        if generator.uniform() < 0.6:
            lamp = [(-0.97, side * 0.55), (-0.9, side * 0.55), (-0.9, side * 0.9)]
            pen.fill([*lamp, (-0.97, side * 0.9)], (150, 30, 28), BODY_HEIGHT)


def _draw_van(pen: _Pen, generator: np.random.Generator) -> None:
    g, top = generator, pen.vehicle.height
    if g.uniform() < 0.5:
        pen.paint = _clip(g.uniform(215, 250) + g.normal(0, 4, 3))
    pen.block(_outline(0.92, 1), (BASE_HEIGHT, 1.0), pen.paint)
    front = g.uniform(0.5, 0.78)
    body = [(-0.97, -0.94), (front, -0.9), (front, 0.9), (-0.97, 0.94)]
    pen.block(body, (1.0, top), pen.paint)
    lean = np.array(pen.canvas.lean)
    glass = pen.place([(front + 0.16, -0.86), (front + 0.16, 0.86), (front, 0.84), (front, -0.84)])
    slope = np.array([1.0, 1.0, top, top])[:, None] * lean
    pen.canvas.fill(glass + slope, pen.glass)
    for at in np.arange(-0.8, front - 0.2, g.uniform(0.2, 0.5)) if g.uniform() < 0.4 else []:
        pen.box(at, at + 0.05, 0.8, pen.tone(0.85), top)
    if g.uniform() < 0.2:
        pen.box(-0.5, -0.1, 0.5, pen.tone(0.7), top)
    _draw_lamps(pen, generator)


def _draw_cab(pen: _Pen, generator: np.random.Generator, rear: float, top: float) -> None:
    pen.block([(rear, -0.95), (0.99, -0.93), (0.99, 0.93), (rear, 0.95)], (0.4, top), pen.paint)
    pen.box(0.99 - 0.45 / pen.vehicle.length, 0.99, 0.84, pen.glass, top * 0.92)
    if generator.uniform() < 0.4:
        pen.box(rear, rear + 0.08, 0.7, pen.tone(0.75), top)


def _draw_truck(pen: _Pen, generator: np.random.Generator) -> None:
    g, top = generator, pen.vehicle.height
    front = 1 - g.uniform(3.2, 4.6) / pen.vehicle.length
    pen.block([(-1, -0.9), (0.95, -0.9), (0.95, 0.9), (-1, 0.9)], (0.5, 0.9), (38, 38, 40))
    bed = [(-0.99, -1), (front, -1), (front, 1), (-0.99, 1)]
    loaded = g.uniform()
    if loaded < 0.55:  # a box
        colour = pick_paint(g) if g.uniform() < 0.4 else _clip(g.uniform(190, 250, 1) * np.ones(3))
        pen.block(bed, (1.0, top), colour)
        for at in np.arange(-0.95, front, g.uniform(0.1, 0.4)) if g.uniform() < 0.5 else []:
            pen.box(at, at + 0.03, 0.95, _clip(np.array(colour) * 0.88), top)
    elif loaded < 0.85:  # an open bed with a load
        pen.block(bed, (1.0, 1.7), pick_paint(g))
        pen.box(
            -0.95, front - 0.04, 0.88, _clip(g.uniform(40, 130) * np.array([1, 0.9, 0.75])), 1.3
        )
        for _ in range(g.integers(0, 6)):
            at = g.uniform(-0.9, front - 0.2)
            colour = _clip(g.uniform(40, 230, 3))
            pen.box(at, at + g.uniform(0.08, 0.3), g.uniform(0.3, 0.85), colour, 1.6)
    else:  # a tank or a mixer
        colour = pick_paint(g)
        for half, factor in ((0.9, 0.6), (0.65, 0.9), (0.35, 1.15)):
            pen.box(-0.9, front - 0.05, half, _clip(np.array(colour) * factor), 2.6)
    _draw_cab(pen, generator, front + 0.06, min(top, g.uniform(2.1, 3.0)))


def _draw_bus(pen: _Pen, generator: np.random.Generator) -> None:
    g, top = generator, pen.vehicle.height
    if g.uniform() < 0.4:
        pen.paint = _clip(g.uniform(190, 250) + g.normal(0, 5, 3))
    outline = [(-0.99, -0.97), (0.97, -0.97), (1, -0.7), (1, 0.7), (0.97, 0.97), (-0.99, 0.97)]
    pen.block(outline, (0.35, top), pen.paint)
    v, lean = pen.vehicle, np.array(pen.canvas.lean)
    for side in (-1, 1):  # windows, seen on the side that leans into view
        ends = pen.place([(-0.92, side * 0.99), (0.92, side * 0.99)])
        strip = np.concatenate([ends + lean * 1.3, (ends + lean * 2.4)[::-1]])
        if np.dot(ends.mean(0) - [v.x, v.y], lean) < 0:
            pen.canvas.fill(strip, pen.glass)
    roof = pen.tone(g.uniform(0.85, 1.1)) if g.uniform() < 0.6 else pick_paint(g)
    pen.box(-0.96, 0.95, 0.86, roof, top)
    pen.box(0.96, 1.0, 0.85, pen.glass, top * 0.85)
    for _ in range(g.integers(1, 6)):
        at, half = g.uniform(-0.9, 0.7), g.uniform(0.2, 0.7)
        colour = _clip(np.array(roof) * g.uniform(0.5, 1.1) if g.uniform() < 0.6 else (70, 72, 75))
        pen.box(at, at + g.uniform(0.05, 0.3), half, colour, top + 0.15)


def _draw_long(pen: _Pen, generator: np.random.Generator) -> None:
    if generator.uniform() < 0.4:  # an articulated bus
        _draw_bus(pen, generator)
        pen.box(-0.12, -0.04, 0.9, (35, 36, 38), pen.vehicle.height)
    else:
        _draw_truck(pen, generator)


_DRAWINGS: dict[str, Callable[[_Pen, np.random.Generator], None]] = {
    **dict.fromkeys(("sedan", "hatch", "estate", "pickup"), _draw_car),
    "van": _draw_van,
    "truck": _draw_truck,
    "bus": _draw_bus,
    "long": _draw_long,
}
