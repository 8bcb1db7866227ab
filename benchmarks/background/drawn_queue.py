"""Clips of a drawn road on which queues stand and drive off."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int, UInt8
from numpy import ndarray as Array

from benchmarks.background.queue_clips import QueueClip

HEIGHT, WIDTH = 540, 960
LANE_PX = 34.0
QUEUE_LANES = (1, 2, 4)  # three of the six drawn lanes
PAINTS = np.array(
    [[35, 35, 38], [90, 92, 95], [225, 225, 222], [150, 152, 155], [140, 25, 30], [30, 50, 110]]
)


def draw_queue(*, standing: float, seed: int, count: int = 32) -> QueueClip:
    """Draw a road with its queue: asphalt, markings, verges, cars with windows and shadows.

    Args:
        standing: share of the time that the queues stand; their cars start one after another.
        seed: random seed, also of the road's direction.
        count: number of frames.

    Returns:
        The clip. Queues stand in three lanes of six.
    """
    generator = np.random.default_rng([seed, 2])
    angle = generator.uniform(0, np.pi)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    road, cars = _draw_road(generator, axes), _list_cars(generator, standing)
    shadow = generator.uniform(-9, 9, 2)
    frames, covers = [], []
    for t in (np.arange(count) + 0.5) / count:
        frame, cover = road.copy(), np.zeros((HEIGHT, WIDTH), np.uint8)
        for car in cars:
            looping = (car.x + 5200 * t + 700) % 1500 - 750
            x = looping if np.isinf(car.release) else car.x + 3500 * max(t - car.release, 0)
            _draw_car(frame, cover, replace(car, x=x), axes, shadow)
        covers.append(cover)
        soft = cv2.GaussianBlur(frame, (0, 0), 0.6)
        noisy = soft + generator.normal(0, 2.5, soft.shape)
        frames.append(np.rint(noisy).clip(0, 255).astype(np.uint8))
    ground = np.rint(cv2.GaussianBlur(road, (0, 0), 0.6)).clip(0, 255).astype(np.uint8)
    return QueueClip(np.stack(frames), ground, np.stack(covers).mean(axis=0).astype(np.float32))


@dataclass(frozen=True, eq=False)
class _Car:
    x: float  # position along the road, pixels from the middle of the picture
    y: float
    length: float
    width: float
    colour: Float[Array, "3"]
    release: float  # time at which it starts, as a share of the clip; inf for one that passes


def _list_cars(generator: np.random.Generator, standing: float) -> list[_Car]:
    cars = []
    for lane in range(6):
        x = generator.uniform(120, 260)
        for rank in range(24 if lane in QUEUE_LANES else 9):
            length, width = generator.uniform(40, 54), generator.uniform(17, 21)
            colour = generator.choice(PAINTS) + generator.normal(0, 8, 3)
            release = standing + 0.02 * rank if lane in QUEUE_LANES else np.inf
            y = (lane - 2.5) * LANE_PX + generator.normal(0, 1.5)
            cars.append(_Car(x, y, length, width, colour.clip(5, 250), release))
            x -= length + generator.uniform(6, 30)
    return cars


def _draw_road(
    generator: np.random.Generator, axes: Float[Array, "2 2"]
) -> Float32[Array, "h w 3"]:
    """Asphalt with patches, lane lines and a crossing between two verges."""
    fine, coarse = (
        cv2.GaussianBlur(generator.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), sigma) * sigma
        for sigma in (1, 12)
    )
    verge = np.array([88, 105, 62]) + 30 * (fine + coarse)[..., None]
    asphalt = generator.uniform(80, 130) + (14 * fine + 10 * coarse)[..., None] + np.zeros(3)
    surface = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.fillPoly(surface, [_place([-900, 900], [-104, 104], axes)], [1], cv2.LINE_8, 4)
    ground = np.where(surface[..., None] > 0, asphalt, verge).astype(np.float32)
    for _ in range(25):
        x, y = generator.uniform(-450, 450), generator.uniform(-100, 100)
        ends = [x, x + generator.uniform(10, 90)], [y, y + generator.uniform(3, 25)]
        patched = ground.copy()
        grey = generator.uniform(60, 130)
        cv2.fillPoly(patched, [_place(*ends, axes)], [grey] * 3, cv2.LINE_8, 4)
        ground = 0.5 * ground + 0.5 * patched
    for line in range(7):
        y = (line - 3) * LANE_PX
        for start in range(-900, 900, 60):
            end = start + (60 if line in (0, 3, 6) else 25)
            mark = _place([start, end], [y - 1.5, y + 1.5], axes)
            cv2.fillPoly(ground, [mark], [215] * 3, cv2.LINE_AA, 4)
    for y in np.arange(-98, 100, 14).astype(float).tolist():
        stripe = _place([300, 340], [y - 3, y + 3], axes)
        cv2.fillPoly(ground, [stripe], [220] * 3, cv2.LINE_AA, 4)
    return ground


def _place(x: Sequence[float], y: Sequence[float], axes: Float[Array, "2 2"]) -> Int[Array, "4 2"]:
    """The pixels, in sixteenths, of a rectangle between two coordinates along and across."""
    corners = np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]])
    pixels = np.array([WIDTH, HEIGHT]) / 2 + corners @ axes
    return np.rint(pixels * 16).astype(np.int32)


def _draw_car(
    frame: Float32[Array, "h w 3"],
    cover: UInt8[Array, "h w"],
    car: _Car,
    axes: Float[Array, "2 2"],
    shadow: Float[Array, "2"],
) -> None:
    """Draw a car with its shadow, and where they cover the ground, in place."""
    half, side = car.length / 2, car.width / 2
    body = _place([car.x - half, car.x + half], [car.y - side, car.y + side], axes)
    dark = np.zeros(cover.shape, np.uint8)
    cv2.fillPoly(dark, [body + np.rint(shadow * 16).astype(np.int32)], [1], cv2.LINE_8, 4)
    frame[dark > 0] *= 0.55
    cover |= dark
    cv2.fillPoly(cover, [body], [1], cv2.LINE_8, 4)
    cv2.fillPoly(frame, [body], car.colour.tolist(), cv2.LINE_AA, 4)
    for back, front in ((0.15, 0.45), (-0.8, -0.6)):
        along = [car.x + back * half, car.x + front * half]
        window = _place(along, [car.y - 0.8 * side, car.y + 0.8 * side], axes)
        cv2.fillPoly(frame, [window], [35, 38, 42], cv2.LINE_AA, 4)
