"""Clips of queues that stand and drive off: real cars pasted on a real picture of the ground."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from benchmarks.background.queue_sprites import cut_place


@dataclass(frozen=True, eq=False)
class QueueClip:
    """Registered frames with their truth."""

    frames: UInt8[Array, "K h w 3"]  # RGB, spread over the clip
    ground: UInt8[Array, "h w 3"]  # the ground without traffic
    # share of the time in which traffic covers a pixel; NaN: not judged
    share: Float32[Array, "h w"]
    transforms: Float[Array, "K 3 3"] | None = None  # image_from_frame; None for a still camera
    # boxes of the traffic in each frame, if known
    boxes: tuple[Float[Array, "_ 4"], ...] | None = None


def paste_queue(place: str, *, standing: float, seed: int, count: int = 32) -> QueueClip:
    """Make a clip of queues: real cars, pasted on a picture of the place where they were filmed.

    Args:
        place: a folder of the data folder's `hover` with a box file for each frame, such as
            "minsk_junction".
        standing: share of the time, from the start, in which the queues stand.
        seed: random seed.
        count: number of frames.

    Returns:
        The clip. Two queues stand across the image, a third from its top to its bottom; other cars
        pass.
    """
    generator = np.random.default_rng([seed, 1])
    ground, sprites = cut_place(place)
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
    frames, covered, boxes = [], np.zeros((height, width), np.float32), []
    for k in range(count):
        picture, shown = ground.astype(np.float32), np.zeros((height, width), np.float32)
        for sprite, places in cars:
            _paste(picture, shown, sprite, places[k])
        covered += shown > 0.3
        frames.append(record(picture, generator))
        corners = [(*places[k], *(places[k] + sprite.shape[1::-1])) for sprite, places in cars]
        boxes.append(clip_boxes(np.array(corners), (height, width)))
    return QueueClip(np.stack(frames), ground, covered / count, boxes=tuple(boxes))


def clip_boxes(boxes: Float[Array, "N 4"], size: tuple[int, int]) -> Float[Array, "M 4"]:
    """Cut boxes off at the rim of a (height, width) image; those outside are left out."""
    cut = boxes.clip(0, [*size[::-1], *size[::-1]])
    return cut[(cut[:, 2] > cut[:, 0]) & (cut[:, 3] > cut[:, 1])]


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


def record(
    picture: Float32[Array, "h w 3"], generator: np.random.Generator
) -> UInt8[Array, "h w 3"]:
    """What is left of a picture after jitter, noise and compression."""
    shift = np.array([[1, 0, generator.normal(0, 0.1)], [0, 1, generator.normal(0, 0.1)]])
    moved = cv2.warpAffine(picture, shift, picture.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
    noisy = moved + generator.normal(0, 2, picture.shape)
    pixels = np.rint(noisy).clip(0, 255).astype(np.uint8)
    _, code = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), np.uint8)
