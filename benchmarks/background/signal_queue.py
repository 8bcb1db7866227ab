"""Clips of a busy road before a signal: traffic passes, queues in the middle of the clip, passes.

The ground is bare for moments only, before the queue and after it, between vehicles of many lengths
that follow each other by the model of Newell (2002), "A simplified car-following theory".
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from benchmarks.background.queue_clips import QueueClip, clip_boxes, record

HEIGHT, WIDTH = 400, 960
LANE_PX = 36
QUEUE_LANES = (0, 1, 3)  # three of the five
REACTION = 1.2  # seconds
STOP_LINE = 820.0  # pixels from the left
DURATION = 100.0  # seconds
SHADOW = np.array([[0, 0, 3], [0, 0, 5]])  # its displacement, pixels
LENGTHS = np.array([38.0, 44.0, 48.0, 62.0, 115.0])  # pixels: small cars to buses
PAINTS = np.array([[228, 228, 226], [38, 38, 41], [165, 168, 170], [90, 92, 95], [150, 30, 32]])
PAINT_SHARES = (0.35, 0.25, 0.2, 0.1, 0.1)
LENGTH_SHARES = (0.2, 0.35, 0.25, 0.12, 0.08)


def film_signal(*, standing: float, seed: int, count: int = 40, speed: float = 14.0) -> QueueClip:
    """Film five lanes, of which three stop at red.

    Args:
        standing: share of the time that the signal is red, in the middle of the clip.
        seed: random seed.
        count: number of frames.
        speed: pixels a second of the traffic that moves; at 9 it crawls, so that the ground is
            hardly ever bare.

    Returns:
        The clip.
    """
    generator = np.random.default_rng([seed, 3])
    ground = _paint_ground(generator)
    shares = [standing if lane in QUEUE_LANES else 0.0 for lane in range(5)]
    lanes = [_drive(generator, share, speed, count) for share in shares]
    vehicles = [[_paint_vehicle(generator, length) for length in lengths] for _, lengths in lanes]
    frames, covers, boxes = [], [], []
    for k in range(count):
        picture = ground.astype(np.float32)
        covered, own = np.zeros((HEIGHT, WIDTH), bool), []
        for lane, (fronts, _) in enumerate(lanes):
            top = HEIGHT // 2 + (lane - 2.5) * LANE_PX + 9
            for front, vehicle in zip(fronts[k], vehicles[lane], strict=True):
                _place_vehicle(picture, covered, vehicle, (front - vehicle.shape[1], top))
                own.append((front - vehicle.shape[1], top, front, top + vehicle.shape[0]))
        covers.append(covered)
        boxes.append(clip_boxes(np.array(own), (HEIGHT, WIDTH)))
        frames.append(record(picture, generator))
    share = np.stack(covers).mean(axis=0).astype(np.float32)
    return QueueClip(np.stack(frames), ground, share, boxes=tuple(boxes))


def _drive(
    generator: np.random.Generator, standing: float, speed: float, count: int
) -> tuple[Float[Array, "T N"], Float[Array, "N"]]:
    """The fronts of a lane's vehicles in each frame, from the right one to the left, and lengths.

    A vehicle is where its leader was a reaction time ago, less the gap, or drives at full speed.
    """
    number = 60
    lengths = generator.choice(LENGTHS, number, p=LENGTH_SHARES)
    gaps = np.r_[0.0, lengths[:-1]] + generator.uniform(5, 16, number)  # when standing
    spacing = gaps + speed * REACTION * generator.uniform(0.5, 1.6, number)
    fronts = WIDTH + 200 + generator.uniform(0, 100) - np.cumsum(spacing)
    times = np.arange(0, DURATION, REACTION)
    red = np.abs(times / DURATION - 0.5) < standing / 2
    path = np.empty((len(times), number))
    for step, is_red in enumerate(red):
        path[step] = fronts
        limit = np.r_[np.inf, fronts[:-1]] - gaps
        if is_red:  # those that have passed the line drive on
            limit = np.minimum(limit, np.where(fronts <= STOP_LINE, STOP_LINE, np.inf))
        fronts = np.maximum(fronts, np.minimum(fronts + speed * REACTION, limit))
    moments = (np.arange(count) + 0.5) / count * times[-1]
    frames = [np.interp(moments, times, vehicle) for vehicle in path.T]
    return np.stack(frames, axis=1), lengths


def _paint_ground(generator: np.random.Generator) -> UInt8[Array, "h w 3"]:
    """Asphalt with stains along the lanes, seams and worn markings, between walks and trees."""
    shape = HEIGHT, WIDTH
    fine = cv2.GaussianBlur(generator.normal(0, 7, shape), (0, 0), 0.8)
    coarse = cv2.GaussianBlur(generator.normal(0, 1, shape), (0, 0), 25) * 300
    lane = (np.arange(HEIGHT)[:, None] - HEIGHT / 2 + 2.5 * LANE_PX) / LANE_PX
    on_road = (lane > 0) & (lane < 5)
    grey = 118 + fine + coarse - 9 * np.exp(-(((lane % 1) - 0.5) ** 2) / 0.03) * on_road
    for _ in range(60):  # patches of repairs, with sealed edges
        place = generator.integers([0, 0], [WIDTH, HEIGHT])
        corners = place.tolist(), (place + generator.integers([15, 5], [120, 30])).tolist()
        cv2.rectangle(grey, *corners, generator.uniform(85, 140), -1)
        cv2.rectangle(grey, *corners, 70, 1)
    marking = np.abs(lane - np.rint(lane)) * LANE_PX < 1.5
    dashed = (np.arange(WIDTH) % 70 < 30) | (np.rint(lane) % 5 == 0)
    grey += 75 * (marking & dashed & on_road) * generator.uniform(0.6, 1)
    grey[:, int(STOP_LINE) + 4 : int(STOP_LINE) + 10] += 70 * on_road
    walk = np.array([150, 143, 132]) + (fine * 2 + coarse)[..., None]
    ground = np.where(on_road[..., None], grey[..., None] + [-2, 0, 3], walk)
    for _ in range(25):  # trees beside the road
        x, y = generator.uniform(0, WIDTH), generator.choice([0, HEIGHT])
        colour = [*generator.uniform([40, 70], [80, 110]), 40]
        middle = round(x), round(y + generator.uniform(-50, 50))
        cv2.circle(ground, middle, int(generator.uniform(12, 40)), colour, -1)
    return np.rint(cv2.GaussianBlur(ground, (0, 0), 0.7)).clip(0, 255).astype(np.uint8)


def _paint_vehicle(generator: np.random.Generator, length: float) -> Float32[Array, "h w 4"]:
    """A shaded body with roof, windows and lamps, RGBA, heading right; grey like the road often."""
    width = 19 if length < 60 else 24
    body = np.full((width, round(length), 4), 255.0)
    paint = generator.choice(PAINTS, p=PAINT_SHARES) + generator.normal(0, 5, 3)
    shade = 14 * np.cos(np.linspace(-1.5, 1.5, width))[:, None, None]
    body[..., :3] = paint + shade + generator.normal(0, 2, (*body.shape[:2], 1))
    for start, end in ((0.2, 0.3), (0.62, 0.74)) if length < 60 else ((0.9, 0.96),):
        body[3:-3, int(start * length) : int(end * length), :3] = generator.uniform(25, 60)
    body[[2, -3], -2:, :3] = 235
    rows, columns = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in body.shape[:2])
    body[rows[:, None] + columns < 3, 3] = 0  # rounded corners
    return body.clip(0, 255).astype(np.float32)


def _place_vehicle(
    picture: Float32[Array, "H W 3"],
    covered: Bool[Array, "H W"],
    vehicle: Float32[Array, "h w 4"],
    place: tuple[float, float],
) -> None:
    """Draw a vehicle and its shadow at a sub-pixel place, in place."""
    if not -vehicle.shape[1] < place[0] < WIDTH:
        return
    left, top = np.floor(place).astype(int)
    shift = np.array([[1, 0, place[0] - left], [0, 1, place[1] - top]])
    size = vehicle.shape[1] + 5, vehicle.shape[0] + 7
    drawn = cv2.warpAffine(vehicle, shift, size)
    shade = cv2.warpAffine(vehicle[..., 3], shift + SHADOW, size)[..., None] / 255
    inside = slice(max(-left, 0), WIDTH - left)
    drawn, shade = drawn[:, inside], shade[:, inside]
    part = np.s_[top : top + size[1], max(left, 0) : min(left + size[0], WIDTH)]
    alpha = drawn[..., 3:] / 255
    picture[part] = picture[part] * (1 - 0.4 * shade) * (1 - alpha) + drawn[..., :3] * alpha
    covered[part] |= ((alpha + shade) > 0.3)[..., 0]
