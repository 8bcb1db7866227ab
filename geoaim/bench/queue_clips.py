"""Clips of queues that stand at a light and drive off: two generators that share no code.

Each gives registered frames with the exact ground and the share of the time that traffic covers
each pixel. `paste_queue` moves cars cut from real frames over a real picture of the ground.
`draw_queue` draws everything.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int, UInt8
from numpy import ndarray as Array

from geoaim.bench.data import require_data
from geoaim.mapping import average_frames, open_video, read_detections, register

HEIGHT, WIDTH = 540, 960
LANE_PX = 34.0
QUEUE_LANES = (1, 2, 4)  # of the six drawn ones
PAINTS = np.array(
    [[35, 35, 38], [90, 92, 95], [225, 225, 222], [150, 152, 155], [140, 25, 30], [30, 50, 110]]
)


@dataclass(frozen=True, eq=False)
class QueueClip:
    """Registered frames with their truth.

    Attributes:
        frames: (K, h, w, 3) RGB, spread over the clip.
        ground: (h, w, 3) without traffic.
        share: (h, w) of the frames in which traffic covers the pixel, 0 to 1.
    """

    frames: UInt8[Array, "K h w 3"]
    ground: UInt8[Array, "h w 3"]
    share: Float32[Array, "h w"]


def paste_queue(place: str, *, standing: float, seed: int, count: int = 32) -> QueueClip:
    """Paste cars cut from a hovering camera's frames on the place that these frames show.

    Args:
        place: a folder of `hover` with a box file for each frame, such as "minsk_junction".
        standing: share of the time that the queues stand.
        seed: random seed.
        count: number of frames.

    Returns:
        The clip. Two queues stand in rows, a third in a column; other cars pass.
    """
    generator = np.random.default_rng([seed, 1])
    ground, sprites = _cut_place(place)
    height, width = ground.shape[:2]
    length = int(np.median([sprite.shape[1] for sprite in sprites]))
    side = int(np.median([sprite.shape[0] for sprite in sprites]))
    cars = []  # (sprite, positions (count, 2) of its upper left corner)
    lanes = generator.permutation(np.linspace(0.1, 0.85, 5))
    time = np.arange(count) / count
    for lane, across in enumerate(lanes):
        column = lane == 2
        extent, other = (height, width) if column else (width, height)
        for rank in range(24):
            if lane >= 3 and rank % 3:  # fewer cars pass than queue
                continue
            sprite = sprites[generator.integers(len(sprites))]
            if lane < 3:  # the first cars leave the picture, those behind them follow
                start = 0.75 * extent - rank * 1.35 * length
                along = start + 4 * extent * (time - standing - 0.01 * rank).clip(0) ** 1.5
            else:
                along = (rank / 24 + 3.3 * time) % 1 * 1.3 * extent - 0.15 * extent
            place_across = np.full(count, across * other + generator.uniform(-0.1, 0.1) * side)
            if column:
                cars.append((np.rot90(sprite), np.stack([place_across, along], -1)))
            else:
                cars.append((sprite, np.stack([along, place_across], -1)))
    frames, covered = [], np.zeros((height, width), np.float32)
    for k in range(count):
        picture, shown = ground.astype(np.float32), np.zeros((height, width), np.float32)
        for sprite, places in cars:
            _paste(picture, shown, sprite, places[k])
        covered += shown > 0.3
        frames.append(_record(picture, generator))
    return QueueClip(np.stack(frames), ground, covered / count)


def _cut_place(place: str) -> tuple[UInt8[Array, "h w 3"], list[UInt8[Array, "_ _ 4"]]]:
    """The ground of a real sequence, its traffic masked by boxes, and its cars, heading right."""
    folder = require_data(f"hover/{place}")
    video, boxes = open_video(folder), read_detections(folder)
    registration = register(video)
    pairs = [
        (frame, registration.reference_from_frame[frame.index])
        for frame in video
        if registration.valid[frame.index]
    ]
    ground = average_frames(pairs, size=(video.height, video.width), detections=boxes).image
    scale = min(WIDTH / video.width, 1.0)
    sprites = []
    for frame, _ in pairs[::4]:
        known = boxes(frame)
        if known is None:
            continue
        for left, top, right, bottom in np.rint(known).astype(int).tolist():
            inside = left > 2 and top > 2 and right < video.width - 2 and bottom < video.height - 2
            long, short = max(right - left, bottom - top), min(right - left, bottom - top)
            if not inside or not 1.9 < long / max(short, 1) < 3.0 or short * scale < 12:
                continue
            body = frame.image[top:bottom, left:right]
            body = np.rot90(body) if len(body) == long else body
            x, y = (np.abs(np.linspace(-1, 1, n)) for n in body.shape[1::-1])
            alpha = ((1.0 - (x[None] ** 6 + y[:, None] ** 6) ** (1 / 6)) * 12).clip(0, 1) * 255
            sprite = np.dstack([body, alpha.astype(np.uint8)])
            sprites.append(_resize(sprite, scale))
    lengths = np.array([sprite.shape[1] for sprite in sprites])
    usual = np.abs(lengths / np.median(lengths) - 1) < 0.3
    return _resize(ground, scale), [s for s, keep in zip(sprites, usual, strict=True) if keep]


def _resize(image: UInt8[Array, "H W c"], scale: float) -> UInt8[Array, "h w c"]:
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _paste(
    picture: Float32[Array, "h w 3"],
    shown: Float32[Array, "h w"],
    sprite: UInt8[Array, "_ _ 4"],
    place: Float[Array, "2"],
) -> None:
    """Blend a sprite at a sub-pixel place, in place."""
    left, top = np.floor(place).astype(int)
    fraction = place - [left, top]
    padded = np.pad(sprite, ((1, 2), (1, 2), (0, 0))).astype(np.float32)
    padded[..., :3] *= padded[..., 3:] / 255
    shift = np.array([[1, 0, fraction[0]], [0, 1, fraction[1]]])
    moved = cv2.warpAffine(padded, shift, padded.shape[1::-1])
    first = np.maximum([top, left], 0)
    last = np.minimum([top + len(moved), left + moved.shape[1]], picture.shape[:2])
    if (first >= last).any():
        return
    part = np.s_[first[0] : last[0], first[1] : last[1]]
    cut = moved[first[0] - top : last[0] - top, first[1] - left : last[1] - left]
    alpha = cut[..., 3:] / 255
    picture[part] = cut[..., :3] + (1 - alpha) * picture[part]
    shown[part] = np.maximum(shown[part], alpha[..., 0])


def _record(
    picture: Float32[Array, "h w 3"], generator: np.random.Generator
) -> UInt8[Array, "h w 3"]:
    """What is left of a picture after jitter, noise and compression."""
    shift = np.array([[1, 0, generator.normal(0, 0.1)], [0, 1, generator.normal(0, 0.1)]])
    moved = cv2.warpAffine(picture, shift, picture.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
    noisy = moved + generator.normal(0, 2, picture.shape)
    pixels = np.rint(noisy).clip(0, 255).astype(np.uint8)
    _, code = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), np.uint8)


def draw_queue(*, standing: float, seed: int, count: int = 32) -> QueueClip:
    """Draw a road with its queue: asphalt, markings, verges, cars with windows and shadows.

    Args:
        standing: share of the time that the queues stand; their cars start one after another.
        seed: random seed, also of the road's direction.
        count: number of frames.

    Returns:
        The clip. Queues stand in three lanes of six.
    """
    random = np.random.default_rng([seed, 2])
    angle = random.uniform(0, np.pi)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    road, cars = _draw_road(random, axes), _list_cars(random, standing)
    shadow = random.uniform(-9, 9, 2)
    frames, covers = [], []
    for t in (np.arange(count) + 0.5) / count:
        frame, cover = road.copy(), np.zeros((HEIGHT, WIDTH), np.uint8)
        for car in cars:
            looping = (car.x + 5200 * t + 700) % 1500 - 750
            x = looping if np.isinf(car.release) else car.x + 3500 * max(t - car.release, 0)
            _draw_car(frame, cover, replace(car, x=x), axes, shadow)
        covers.append(cover)
        soft = cv2.GaussianBlur(frame, (0, 0), 0.6)
        noisy = soft + random.normal(0, 2.5, soft.shape)
        frames.append(np.rint(noisy).clip(0, 255).astype(np.uint8))
    ground = np.rint(cv2.GaussianBlur(road, (0, 0), 0.6)).clip(0, 255).astype(np.uint8)
    return QueueClip(np.stack(frames), ground, np.stack(covers).mean(axis=0).astype(np.float32))


@dataclass(frozen=True, eq=False)
class _Car:
    x: float  # along the road, pixels from the middle of the picture
    y: float
    length: float
    width: float
    colour: Float[Array, "3"]
    release: float  # time at which it starts, as a share of the clip; inf for one that passes


def _list_cars(random: np.random.Generator, standing: float) -> list[_Car]:
    cars = []
    for lane in range(6):
        x = random.uniform(120, 260)
        for rank in range(24 if lane in QUEUE_LANES else 9):
            length, width = random.uniform(40, 54), random.uniform(17, 21)
            colour = random.choice(PAINTS) + random.normal(0, 8, 3)
            release = standing + 0.02 * rank if lane in QUEUE_LANES else np.inf
            y = (lane - 2.5) * LANE_PX + random.normal(0, 1.5)
            cars.append(_Car(x, y, length, width, colour.clip(5, 250), release))
            x -= length + random.uniform(6, 30)
    return cars


def _draw_road(random: np.random.Generator, axes: Float[Array, "2 2"]) -> Float32[Array, "h w 3"]:
    """Asphalt with patches, lane lines and a crossing between two verges."""
    fine, coarse = (
        cv2.GaussianBlur(random.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), sigma) * sigma
        for sigma in (1, 12)
    )
    verge = np.array([88, 105, 62]) + 30 * (fine + coarse)[..., None]
    asphalt = random.uniform(80, 130) + (14 * fine + 10 * coarse)[..., None] + np.zeros(3)
    surface = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.fillPoly(surface, [_place([-900, 900], [-104, 104], axes)], [1], cv2.LINE_8, 4)
    ground = np.where(surface[..., None] > 0, asphalt, verge).astype(np.float32)
    for _ in range(25):
        x, y = random.uniform(-450, 450), random.uniform(-100, 100)
        ends = [x, x + random.uniform(10, 90)], [y, y + random.uniform(3, 25)]
        patched = ground.copy()
        grey = random.uniform(60, 130)
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
