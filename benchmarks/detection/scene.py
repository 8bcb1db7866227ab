"""A scene that is being drawn: its picture, its shadows, its vehicles, and its colours."""

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from benchmarks.detection.vehicles import Canvas, Colour, Vehicle, get_corners

SUPERSAMPLING = 2  # a scene is drawn finer and reduced, as cameras do


GROUNDS: list[tuple[Colour, float]] = [  # colours, and how much they vary from spot to spot
    ((88, 88, 90), 7), ((120, 119, 117), 8), ((60, 61, 64), 6), ((150, 146, 140), 9),
    ((176, 172, 165), 8), ((84, 98, 58), 22), ((60, 78, 44), 24), ((110, 112, 66), 22),
    ((128, 108, 84), 16), ((158, 140, 112), 14), ((150, 96, 78), 10), ((225, 228, 232), 9),
    ((205, 200, 190), 8), ((48, 62, 66), 5), ((98, 86, 74), 18),
]  # fmt: skip


ROADS: list[Colour] = [
    (88, 88, 90),
    (108, 107, 106),
    (66, 67, 70),
    (128, 126, 123),
    (146, 144, 140),
]


class Scene:
    """A square piece of a town that is being drawn; metres, right and down from its corner."""

    def __init__(self, pixels: int, resolution: float, generator: np.random.Generator) -> None:
        g = self.generator = generator
        side = pixels * SUPERSAMPLING
        self.pixels, self.resolution, self.side = pixels, resolution, pixels * resolution
        scale = SUPERSAMPLING / resolution
        tilt = g.choice([0.05, 0.2, 0.45], p=[0.35, 0.4, 0.25]) * g.uniform(0.2, 1)
        way, sun_way = g.uniform(0, 2 * np.pi, 2)
        reach = 1 / np.tan(g.uniform(0.35, 1.25))
        self.shade = g.uniform(0.3, 0.7) if g.uniform() < 0.65 else g.uniform(0, 0.15)
        self.canvas = Canvas(
            np.zeros((side, side, 3), np.uint8),
            scale,
            (tilt * np.cos(way), tilt * np.sin(way)),
            (reach * np.cos(sun_way), reach * np.sin(sun_way)),
        )
        self.grid = g.uniform(0, np.pi)  # the way that streets and walls follow
        self.vehicles: list[Vehicle] = []
        self.low_shadow = np.zeros((side, side), np.uint8)  # of vehicles and clutter
        self.high_shadow = np.zeros((side, side), np.uint8)  # of buildings and trees
        self.cover = np.zeros((side, side), np.uint8)  # what stands above vehicles

    def pick_place(self, margin: float = 0.0) -> Float[Array, "2"]:
        """Pick a place in the scene, or within a margin around it."""
        return self.generator.uniform(-margin, self.side + margin, 2)

    def pick_angle(self) -> float:
        """Pick an angle: mostly along or across the streets."""
        g = self.generator
        return float(
            self.grid + g.integers(4) * np.pi / 2 if g.uniform() < 0.75 else g.uniform(0, 7)
        )

    def cast(self, shadow: Array, points: Float[Array, "N 2"], height: float) -> None:
        """Cast the shadow of an upright prism on the ground."""
        swept = np.concatenate([points, points + np.array(self.canvas.sun) * height])
        hull = cv2.convexHull(swept.astype(np.float32))[:, 0]
        cv2.fillPoly(shadow, [self.canvas.convert(hull)], 255, cv2.LINE_AA, 4)

    def darken(self, shadow: UInt8[Array, "H W"], blur: float) -> None:
        """Darken the picture where a shadow lies."""
        if not self.shade or not shadow.any():
            return
        soft = cv2.GaussianBlur(shadow, (0, 0), blur)
        for channel, tint in enumerate((1.0, 0.97, 0.9)):  # shadows are bluish
            factor = np.clip(255 - np.arange(256) * self.shade * tint, 0, 255).astype(np.uint8)
            part = self.canvas.image[..., channel]
            self.canvas.image[..., channel] = cv2.multiply(part, factor[soft], scale=1 / 255)


_noise: list[UInt8[Array, "N N"]] = []


def get_noise(size: int, generator: np.random.Generator) -> Float32[Array, "N N"]:
    """Cut a piece of fractal noise of variance 1."""
    if not _noise:
        own = np.random.default_rng(0)
        for weights in (
            (1, 0.7, 0.5, 0.35, 0.2, 0.1),
            (0.3, 0.5, 0.8, 1, 0.7, 0.3),
            (0.1, 0.2, 0.3, 0.6, 1, 1),
        ):
            total = np.zeros((1400, 1400), np.float32)
            for k, weight in enumerate(weights):
                n = 2 ** (k + 4) + 8
                part = own.normal(size=(n, n)).astype(np.float32)
                total += weight * cv2.resize(part, (1400, 1400), interpolation=cv2.INTER_CUBIC)
            _noise.append(np.clip(128 + 40 * total / total.std(), 0, 255).astype(np.uint8))
    field = _noise[generator.integers(len(_noise))]
    top, left = generator.integers(0, 1400 - size, 2)
    return (field[top : top + size, left : left + size].astype(np.float32) - 128) / 40


def vary_colour(colour: Colour, generator: np.random.Generator, by: float = 12) -> Colour:
    """Vary a colour in brightness and hue."""
    r, g, b = np.clip(
        np.array(colour) * generator.uniform(0.8, 1.2) + generator.normal(0, by / 2, 3), 0, 255
    )
    return float(r), float(g), float(b)


def pick_colour(g: np.random.Generator) -> Colour:
    """Pick any colour, mostly grey."""
    grey = g.uniform(20, 245)
    spread = g.choice([4, 12, 60], p=[0.5, 0.3, 0.2])
    r, green, b = np.clip(grey + g.normal(0, spread, 3), 0, 255)
    return float(r), float(green), float(b)


def draw_ribs(
    scene: Scene, box: tuple[float, float, float, float, float], high: float, tone: Colour
) -> None:
    """Draw parallel bars over a rectangle at a height."""
    g, (x, y, heading, long, wide) = scene.generator, box
    step, thick = g.uniform(0.3, 1.2), g.uniform(0.1, 0.3)
    way = np.array([np.cos(heading), np.sin(heading)])
    for at in np.arange(-long / 2 + step / 2, long / 2, step):
        cx, cy = np.array([x, y]) + at * way
        scene.canvas.fill(get_corners(cx, cy, heading, thick, wide), tone, high)
