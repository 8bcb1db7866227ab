"""Made hover videos over real stills: exact truth, real texture, and ways to make them hard.

The stills (Songdo Vision, CC BY 4.0) are looked for in `find_data()`; nothing made from them
belongs into the repository. A video is a sequence of frames: index it, iterate it, encode it.
"""

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.bench.data import find_data
from geoaim.encode import write_video
from geoaim.synthetic.camera import (
    Clip,
    Hover,
    Traffic,
    film,
    frame_boxes,
    reference_from_frames,
    render_frame,
)

Kind = Literal["plain", "queue", "cars", "shadow", "gain", "cut", "noise"]
STILLS = ("00003", "00972")
SIZES = {"720p": (720, 1280), "1080p": (1080, 1920), "4k": (2160, 3840)}

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
# Lane and place of the stop line along it, as a share of its length.
_QUEUES = {"00003": [(6, 0.38), (7, 0.36), (8, 0.20), (9, 0.20)], "00972": [(3, 0.36), (4, 0.36)]}


@dataclass(frozen=True)
class MadeVideo:
    """A clip as it is shown: some kinds spoil frames. Index it or iterate it for frames.

    Attributes:
        clip: the truth.
        kind: what makes it hard.
        good: (T,) frames that show the clip's scene; the others must be refused.
        other: what the bad frames of a "cut" show.
    """

    clip: Clip
    kind: Kind
    good: Bool[Array, "T"]
    other: Clip | None = None

    def __len__(self) -> int:
        return len(self.good)

    def __getitem__(self, index: int) -> UInt8[Array, "H W 3"]:
        if not 0 <= index < len(self):
            raise IndexError(index)
        return _spoil(self, index)

    def __iter__(self) -> Iterator[UInt8[Array, "H W 3"]]:
        return (self[index] for index in range(len(self)))


def made_video(
    still: str,
    *,
    size: str = "1080p",
    count: int = 120,
    kind: Kind = "plain",
    hover: Hover | None = None,
    seed: int = 0,
) -> MadeVideo:
    """A hover video over one of the stills, its cars removed and others driving.

    Args:
        still: "00003" or "00972".
        size: "720p", "1080p" or "4k"; drift and tilt grow with it.
        count: frames, at 30 a second.
        kind: "plain" (60 cars and a queue that leaves), "queue" (traffic over a fifth of the
            frame, queues standing for 60 % of the time), "cars" (300), "shadow" (x0.15 over
            half of the frame, moving), "gain" (x3 in the middle third), "cut" (the last third
            shows the other still), "noise" (a fifth of the frames).
        hover: the camera, instead of the default for the size; its count is replaced.
        seed: of everything random.

    Raises:
        FileNotFoundError: the stills are not here.
    """
    height, width = SIZES[size]
    scale = width / 1920
    hover = hover or Hover(drift=28 * scale, perspective=1.5 * scale, vibration=0.4 * scale)
    hover = replace(hover, count=count)
    generator = np.random.default_rng([seed, STILLS.index(still)])
    moving = {"cars": 300, "queue": 70}.get(kind, 60)
    queue = 10 if kind == "queue" else 5
    traffic = lane_traffic(still, hover, moving=moving, queue=queue, generator=generator)
    clip = film(clean_still(still), traffic, hover, height=height, width=width, generator=generator)
    good = np.ones(count, bool)
    if kind == "noise":
        good[1 + generator.choice(count - 1, count // 5, replace=False)] = False
    if kind != "cut":
        return MadeVideo(clip, kind, good)
    good[2 * count // 3 :] = False
    other = made_video(next(s for s in STILLS if s != still), size=size, count=count, seed=seed + 1)
    return MadeVideo(clip, kind, good, other.clip)


def write_made_video(video: MadeVideo, path: Path, *, crf: int = 20) -> Path:
    """Encode a made video, and save its truth beside it as .npz.

    The truth holds times (T,), frame_from_background and reference_from_frame (T, 3, 3; frame 0
    is the reference), good (T,), gains (T,), and boxes (M, 5): frame index, left, top, right,
    bottom.
    """
    clip = video.clip
    write_video(video, path, frame_rate=clip.hover.frame_rate, crf=crf)
    boxes = [np.insert(frame_boxes(clip, i), 0, i, axis=1) for i in range(len(video))]
    np.savez_compressed(
        path.with_suffix(".npz"),
        times=clip.times,
        frame_from_background=clip.frame_from_background,
        reference_from_frame=reference_from_frames(clip),
        good=video.good,
        gains=clip.gains,
        boxes=np.concatenate(boxes),
    )
    return path


def lane_traffic(
    still: str, hover: Hover, *, moving: int, queue: int, generator: np.random.Generator
) -> Traffic:
    """Cars on the still's lanes: platoons, and queues that stand for 60 % of the clip and leave."""
    times = np.arange(hover.count) / hover.frame_rate
    lanes = [_smooth_lane(lane) for lane in _LANES[still]]
    stops = dict(_QUEUES[still])
    poses = []
    for number in stops:
        place = stops[number] * len(lanes[number])
        for rank in range(queue):
            leaving = ((times / times[-1] - 0.6) / 0.4).clip(0) ** 2
            poses.append(_follow(lanes[number], place - 150 * rank + 4500 * leaving, loop=False))
    free = [lane for number, lane in enumerate(lanes) if number not in stops]
    for rank in range(moving):
        lane = free[rank % len(free)]
        share = (rank // len(free)) / -(-moving // len(free))
        own = np.random.default_rng([rank % len(free), len(still)])  # one speed for each lane
        speed = own.uniform(220, 420)
        start = len(lane) * (share + own.uniform()) + generator.uniform(-15, 15)
        poses.append(_follow(lane, start + speed * times, loop=True))
    cut = car_sprites(still)
    chosen = generator.integers(0, len(cut), len(poses))
    sizes = np.array([cut[i].shape[1::-1] for i in chosen], float) - 4
    return Traffic(tuple(cut[i] for i in chosen), sizes, np.stack(poses, axis=1))


def car_sprites(still: str) -> list[UInt8[Array, "_ _ 4"]]:
    """Cars cut out of the still, heading right, with soft rounded edges and 2 px of air."""
    image, boxes = _read_still(still)
    sprites = []
    for left, top, right, bottom in boxes.tolist():
        long, short = max(right - left, bottom - top), min(right - left, bottom - top)
        inside = left > 2 and top > 2 and right < 3838 and bottom < 2158
        if not inside or short < 38 or long > 160 or not 2.0 < long / short < 3.2:
            continue
        body = image[top:bottom, left:right]
        body = np.rot90(body) if len(body) == long else body
        x = np.abs(np.linspace(-1, 1, body.shape[1]))[None, :]
        y = np.abs(np.linspace(-1, 1, body.shape[0]))[:, None]
        alpha = ((1.02 - (x**6 + y**6) ** (1 / 6)) * 12).clip(0, 1) * 255
        rgba = np.dstack([body, alpha.astype(np.uint8)])
        sprites.append(np.pad(rgba, ((2, 2), (2, 2), (0, 0))))
    return sprites


def clean_still(still: str) -> UInt8[Array, "2160 3840 3"]:
    """The still without its vehicles: each box filled with road from nearby. Cached on disk."""
    cached = cache_folder() / f"clean-{still}.png"
    if not cached.exists():
        image, boxes = _read_still(still)
        cached.parent.mkdir(parents=True, exist_ok=True)
        part = cached.with_suffix(".part.png")
        cv2.imwrite(str(part), _remove_boxes(image, boxes)[..., ::-1])
        part.replace(cached)
    return _read_image(cached)


def cache_folder() -> Path:
    """Where made things are kept: $XDG_CACHE_HOME/geoaim, else a folder for temporary files."""
    return Path(os.environ.get("XDG_CACHE_HOME", tempfile.gettempdir())) / "geoaim-bench"


def _read_still(still: str) -> tuple[UInt8[Array, "2160 3840 3"], Array]:
    data = find_data()
    if data is None:
        raise FileNotFoundError("made videos need the stills of hover/songdo_stills: GEOAIM_DATA")
    folder = data / "hover" / "songdo_stills"
    image = _read_image(folder / f"{still}.jpg")
    centres = np.loadtxt(folder / f"{still}.txt")[:, 1:]
    half = centres[:, 2:] / 2
    boxes = np.hstack([centres[:, :2] - half, centres[:, :2] + half])
    return image, np.rint(boxes.clip(0, 1) * [3840, 2160, 3840, 2160]).astype(int)


def _read_image(path: Path) -> UInt8[Array, "H W 3"]:
    image = cv2.imread(str(path))
    if image is None:
        raise FileNotFoundError(f"{path} is not there, or no image")
    return np.ascontiguousarray(image[..., ::-1], np.uint8)


def _remove_boxes(image: UInt8[Array, "H W 3"], boxes: Array) -> UInt8[Array, "H W 3"]:
    """Fill each box by the nearby patch that suits it best, its rim blended in."""
    limit = np.tile(image.shape[1::-1], 2)
    grown = np.hstack([boxes[:, :2] - 14, boxes[:, 2:] + 14]).clip(0, limit)
    occupied = np.zeros(image.shape[:2], bool)
    for left, top, right, bottom in grown.tolist():
        occupied[top:bottom, left:right] = True
    clean = image.copy()
    for left, top, right, bottom in grown.tolist():
        target = clean[top:bottom, left:right]
        patch = _best_patch(clean, occupied, (left, top, right, bottom))
        if patch is None:
            window = np.zeros(image.shape[:2], np.uint8)
            window[top:bottom, left:right] = 255
            clean = np.asarray(cv2.inpaint(clean, window, 5, cv2.INPAINT_TELEA), np.uint8)
        else:
            weight = _ramp(*target.shape[:2])[..., None]
            target[:] = (weight * patch + (1 - weight) * target).astype(np.uint8)
    return clean


def _best_patch(
    image: UInt8[Array, "H W 3"], occupied: Bool[Array, "H W"], box: tuple[int, int, int, int]
) -> UInt8[Array, "h w 3"] | None:
    """The free patch nearby whose rim is like the box's rim, and whose inside is like its rim."""
    left, top, right, bottom = box
    height, width = bottom - top, right - left
    rows, columns = image.shape[:2]
    inside = np.zeros((height, width), bool)
    inside[10:-10, 10:-10] = True
    rim = image[top:bottom, left:right][~inside][::5].astype(int)
    best, chosen = np.inf, None
    for y in range(max(0, top - 3 * height), min(rows - height, top + 3 * height) + 1, 8):
        for x in range(max(0, left - 4 * width), min(columns - width, left + 4 * width) + 1, 8):
            if occupied[y : y + height : 4, x : x + width : 4].any():
                continue
            patch = image[y : y + height, x : x + width]
            cost = np.abs(patch[~inside][::5] - rim).mean()
            cost += 0.7 * np.abs(patch[inside][::11] - np.median(rim, axis=0)).mean()
            if cost < best:
                best, chosen = float(cost), patch.copy()
    return chosen


def _ramp(height: int, width: int) -> Float[Array, "h w"]:
    """1 inside, falling to 0 over the outer 10 px."""
    y = np.minimum(np.arange(height), np.arange(height)[::-1])[:, None]
    x = np.minimum(np.arange(width), np.arange(width)[::-1])[None, :]
    return np.asarray((np.minimum(y, x) / 10.0).clip(0, 1))


def _smooth_lane(corners: list[tuple[int, int]]) -> Float[Array, "L 2"]:
    """A point per pixel of length along a lane, run out by 300 px at its ends, corners cut."""
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


def _follow(
    lane: Float[Array, "L 2"], along: Float[Array, "T"], *, loop: bool
) -> Float[Array, "T 3"]:
    """Poses at distances along a lane; past its end a vehicle begins again or is absent."""
    along = along % (len(lane) - 1) if loop else along
    steps = np.arange(len(lane))
    at = [np.stack([np.interp(along + d, steps, lane[:, k]) for k in (0, 1)]) for d in (-20, 20)]
    middle = np.stack([np.interp(along, steps, lane[:, k]) for k in (0, 1)])
    ahead = at[1] - at[0]
    poses = np.stack([*middle, np.arctan2(-ahead[1], ahead[0])], axis=1)
    poses[(along < 0) | (along > len(lane) - 1)] = np.nan
    return poses


def _spoil(video: MadeVideo, index: int) -> UInt8[Array, "H W 3"]:
    clip, count = video.clip, len(video)
    if video.kind == "noise" and not video.good[index]:
        noise = np.random.default_rng(index).integers(0, 256, (clip.height, clip.width, 3))
        return noise.astype(np.uint8)
    if video.other is not None and not video.good[index]:
        return render_frame(video.other, index)
    frame = render_frame(clip, index)
    if video.kind == "gain" and count // 3 <= index < 2 * count // 3:
        return np.asarray(cv2.convertScaleAbs(frame, alpha=3), np.uint8)
    if video.kind == "shadow":
        shade = _moving_shadow(clip.height, clip.width, index / max(count - 1, 1))
        return np.asarray(np.rint(frame * shade[..., None]), np.uint8)
    return frame


def _moving_shadow(height: int, width: int, progress: float) -> Float[Array, "H W"]:
    """Factors 0.15 under a slanted band, half as wide as the frame, that crosses it in the clip."""
    across = np.arange(width)[None, :] / width + 0.2 * np.arange(height)[:, None] / height
    middle = -0.3 + 1.8 * progress
    depth = ((0.25 - np.abs(across - middle)) * 50 + 0.5).clip(0, 1)
    return np.asarray(1 - 0.85 * depth)
