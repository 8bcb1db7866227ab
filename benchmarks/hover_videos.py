"""Hover videos rendered from real stills: real texture, exact truth, and kinds of difficulty."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from benchmarks.stills import STILLS, cut_sprites, read_clean_still
from benchmarks.synthetic import VIDEOS, make_sample
from benchmarks.synthetic.camera import Hover, HoverClip, SpriteTracks, film, render_frame
from benchmarks.synthetic.roads.layouts import PlaceKind

Kind = Literal["plain", "queue", "cars", "shadow", "gain", "cut", "noise"]

# Lanes in pixels of the 3840 x 2160 stills, in driving order, read off the pictures.
_LANES: dict[str, list[list[tuple[int, int]]]] = {
    "00003": [
        [(3840, 1068), (0, 1180)],
        [(3840, 1160), (0, 1275)],
        [(0, 1366), (3840, 1253)],
        [(0, 1437), (3840, 1332)],
        [(0, 1516), (3840, 1411)],
        [(0, 1582), (3840, 1480)],
        [(2347, 0), (1973, 817), (1846, 1266), (1846, 2160)],
        [(2420, 0), (2060, 733), (1925, 1266), (1925, 2160)],
        [(2089, 2160), (2089, 1740), (2189, 1266), (2466, 660), (2756, 0)],
        [(2215, 2160), (2215, 1688), (2320, 1266), (2545, 738), (2850, 0)],
    ],
    "00972": [
        [(3840, 493), (0, 506)],
        [(3840, 562), (0, 567)],
        [(3840, 640), (0, 625)],
        [(0, 1361), (1424, 1361), (2637, 1432), (3840, 1432)],
        [(0, 1424), (1424, 1424), (2637, 1495), (3840, 1490)],
        [(0, 1482), (3840, 1561)],
        [(0, 1540), (3840, 1616)],
        [(1820, 0), (1900, 237), (2268, 1318), (2387, 2160)],
        [(1952, 0), (2004, 237), (2083, 1318), (2083, 2160)],
        [(2215, 2160), (2189, 1318), (2110, 237), (2100, 0)],
    ],
}
# Lane, and the position of its stop line as a share of its length.
_QUEUES = {"00003": [(6, 0.38), (7, 0.36), (8, 0.20), (9, 0.20)], "00972": [(3, 0.36), (4, 0.36)]}


@dataclass(frozen=True)
class HoverVideo:
    """A rendered clip with one kind of difficulty; index or iterate it for its frames."""

    clip: HoverClip  # the rendered scene and its true transforms
    kind: Kind  # the difficulty
    is_valid: Bool[
        Array, "T"
    ]  # whether a frame shows the clip's scene; the others must be rejected
    other: HoverClip | None = None  # the scene that the invalid frames of a "cut" show

    def __len__(self) -> int:
        return len(self.is_valid)

    def __getitem__(self, index: int) -> UInt8[Array, "H W 3"]:
        if not 0 <= index < len(self):
            raise IndexError(index)
        return _degrade(self, index)

    def __iter__(self) -> Iterator[UInt8[Array, "H W 3"]]:
        return (self[index] for index in range(len(self)))


def make_hover_video(
    still: str, *, size: str = "1080p", count: int = 120, kind: Kind = "plain", seed: int = 0
) -> HoverVideo:
    """Render a hover video over one of the stills, with moving cars in place of its own.

    Args:
        still: "00003" or "00972".
        size: "720p", "1080p" or "4k"; drift and tilt grow with it.
        count: number of frames, at 30 frames/s.
        kind: "plain" (60 cars and a queue that leaves), "queue" (traffic over a fifth of the
            frame, queues standing for 60 % of the time), "cars" (300), "shadow" (x0.15 over
            half of the frame, moving), "gain" (x3 in the middle third), "cut" (the last third
            shows the other still), "noise" (a fifth of the frames).
        seed: random seed.

    Returns:
        The video with its truth.

    Raises:
        TracksError: the folder of real data does not hold the stills.
    """
    (height, width), hover = VIDEOS[size], _make_hover(size, count)
    generator = np.random.default_rng([seed, STILLS.index(still)])
    moving = {"cars": 300, "queue": 70}.get(kind, 60)
    queue = 10 if kind == "queue" else 5
    traffic = make_lane_traffic(still, hover, moving=moving, queue=queue, generator=generator)
    ground = read_clean_still(still)
    clip = film(ground, traffic, hover, height=height, width=width, generator=generator)
    is_valid = np.ones(count, bool)
    if kind == "noise":
        is_valid[1 + generator.choice(count - 1, count // 5, replace=False)] = False
    if kind != "cut":
        return HoverVideo(clip, kind, is_valid)
    is_valid[2 * count // 3 :] = False
    other = make_hover_video(
        next(s for s in STILLS if s != still), size=size, count=count, seed=seed + 1
    )
    return HoverVideo(clip, kind, is_valid, other.clip)


def film_place(kind: PlaceKind, *, size: str, count: int) -> HoverVideo:
    """Render a hover video over a drawn place with its traffic, which needs no real data.

    Args:
        kind: kind of the place.
        size: "720p", "1080p" or "4k"; drift grows with it.
        count: number of frames, at 30 frames/s.

    Returns:
        The video with its truth.
    """
    hover = _make_hover(size, count)
    minutes = max(count / hover.frame_rate / 60, 1 / 60) + 1e-6
    resolution = 0.1 if size == "720p" else 0.05
    sample = make_sample(
        3, kind=kind, minutes=minutes, video=VIDEOS[size], hover=hover, resolution=resolution
    )
    assert sample.clip is not None
    return HoverVideo(sample.clip, "plain", np.ones(count, bool))


def _make_hover(size: str, count: int) -> Hover:
    """The camera, whose motion in pixels grows with the width of the frames."""
    scale = VIDEOS[size][1] / 1920
    return Hover(count, drift=28 * scale, perspective=1.5 * scale, vibration=0.4 * scale)


def film_ground(ground: UInt8[Array, "H W 3"], hover: Hover, seed: int) -> HoverVideo:
    """Render a hover video of 720p over ground without traffic.

    Args:
        ground: the still.
        hover: the camera.
        seed: random seed.

    Returns:
        The video with its truth.
    """
    none = SpriteTracks((), np.empty((0, 2)), np.empty((hover.count, 0, 3)))
    height, width = VIDEOS["720p"]
    generator = np.random.default_rng(seed)
    clip = film(ground, none, hover, height=height, width=width, generator=generator)
    return HoverVideo(clip, "plain", np.ones(hover.count, bool))


def make_lane_traffic(
    still: str, hover: Hover, *, moving: int, queue: int, generator: np.random.Generator
) -> SpriteTracks:
    """Drive cars along the still's lanes: platoons, and queues that stop for 60 % of the clip.

    Args:
        still: "00003" or "00972".
        hover: the camera, for the number and rate of the frames.
        moving: number of cars in platoons.
        queue: number of cars in each queue.
        generator: source of randomness.

    Returns:
        The cars' sprites, sizes and poses (T, N, 3) in pixels of the still.
    """
    times = np.arange(hover.count) / hover.frame_rate
    lanes = [smooth_lane(lane) for lane in _LANES[still]]
    stops = dict(_QUEUES[still])
    poses = []
    for number in stops:
        place = stops[number] * len(lanes[number])
        for rank in range(queue):
            leaving = ((times / times[-1] - 0.6) / 0.4).clip(0) ** 2
            poses.append(
                follow_lane(lanes[number], place - 150 * rank + 4500 * leaving, loop=False)
            )
    free = [lane for number, lane in enumerate(lanes) if number not in stops]
    for rank in range(moving):
        lane = free[rank % len(free)]
        share = (rank // len(free)) / -(-moving // len(free))
        own = np.random.default_rng([rank % len(free), len(still)])  # one speed for each lane
        speed = own.uniform(220, 420)
        start = len(lane) * (share + own.uniform()) + generator.uniform(-15, 15)
        poses.append(follow_lane(lane, start + speed * times, loop=True))
    sprites = cut_sprites(still)
    chosen = generator.integers(0, len(sprites), len(poses))
    sizes = np.array([sprites[i].shape[1::-1] for i in chosen], float) - 4
    return SpriteTracks(tuple(sprites[i] for i in chosen), sizes, np.stack(poses, axis=1))


def smooth_lane(corners: list[tuple[int, int]]) -> Float[Array, "L 2"]:
    """Sample a lane every pixel of its length, corners rounded, extended by 300 px at both ends."""
    lane = np.array(corners, float)
    first, last = lane[0] - lane[1], lane[-1] - lane[-2]
    lane = np.vstack(
        [lane[0] + 300 * first / np.hypot(*first), lane, lane[-1] + 300 * last / np.hypot(*last)]
    )
    for _ in range(4):  # Chaikin's corner cutting
        near, far = 0.75 * lane[:-1] + 0.25 * lane[1:], 0.25 * lane[:-1] + 0.75 * lane[1:]
        cut = np.stack([near, far], axis=1).reshape(-1, 2)
        lane = np.vstack([lane[:1], cut, lane[-1:]])
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(lane, axis=0).T))])
    steps = np.arange(along[-1])
    return np.stack([np.interp(steps, along, lane[:, k]) for k in (0, 1)], axis=1)


def follow_lane(
    lane: Float[Array, "L 2"], along: Float[Array, "T"], *, loop: bool
) -> Float[Array, "T 3"]:
    """Compute poses at distances along a lane; past its end a car starts again or is absent."""
    along = along % (len(lane) - 1) if loop else along
    steps = np.arange(len(lane))
    at = [np.stack([np.interp(along + d, steps, lane[:, k]) for k in (0, 1)]) for d in (-20, 20)]
    middle = np.stack([np.interp(along, steps, lane[:, k]) for k in (0, 1)])
    ahead = at[1] - at[0]
    poses = np.stack([*middle, np.arctan2(-ahead[1], ahead[0])], axis=1)
    poses[(along < 0) | (along > len(lane) - 1)] = np.nan
    return poses


def _degrade(video: HoverVideo, index: int) -> UInt8[Array, "H W 3"]:
    clip, count = video.clip, len(video)
    if video.kind == "noise" and not video.is_valid[index]:
        noise = np.random.default_rng(index).integers(0, 256, (clip.height, clip.width, 3))
        return noise.astype(np.uint8)
    if video.other is not None and not video.is_valid[index]:
        return render_frame(video.other, index)
    frame = render_frame(clip, index)
    if video.kind == "gain" and count // 3 <= index < 2 * count // 3:
        return np.asarray(cv2.convertScaleAbs(frame, alpha=3), np.uint8)
    if video.kind == "shadow":
        shade = _shade_band(clip.height, clip.width, index / max(count - 1, 1))
        return np.asarray(np.rint(frame * shade[..., None]), np.uint8)
    return frame


def _shade_band(height: int, width: int, progress: float) -> Float[Array, "H W"]:
    """A slanted band, half as wide as the frame and darkened to 0.15, that crosses it."""
    across = np.arange(width)[None, :] / width + 0.2 * np.arange(height)[:, None] / height
    middle = -0.3 + 1.8 * progress
    depth = ((0.25 - np.abs(across - middle)) * 50 + 0.5).clip(0, 1)
    return np.asarray(1 - 0.85 * depth)
