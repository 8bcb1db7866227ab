"""Traffic in registered frames without boxes: which pixels of which frame show the empty ground.

A car that stands for most of the clip is what mean, median and mixture models take for ground.
But an object has an outline and the bare ground has none: where a frame and the background differ
over a region, the one with the stronger step across the region's border shows the object. Each
frame votes so, and where votes and numbers agree the background changes sides.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray as Array

FEWEST = 4  # frames; with less no majority can be told from chance
ROUNDS = 4  # votes; after three of them the background has moved where it will, the last judges
FLOOR = 8  # grey levels; below this a difference is compression, not traffic
DEVIATIONS = 3.0  # of the noise between frames that a difference must exceed
REACH = 32  # px, about a car's length at this size: how far along the outline a vote is heard
CELL = 4  # px, in which the outline is gathered
WHOLE = 48.0  # px of border that a region's mean is worth
SUPPORT = 0.1  # share of the frames that must show a state before it can be the ground
DOUBT = 0.3  # below this majority (0 even, 1 unanimous) the ground stays contested
CROSS = np.ones((3, 3), np.uint8)
DISC = np.array([[0, 1, 1, 1, 0], *[[1] * 5] * 3, [0, 1, 1, 1, 0]], np.uint8)


@dataclass(frozen=True)
class Traffic:
    """What moved or stood in K registered frames.

    Attributes:
        moving: (K, h, w) pixels that do not show the ground in this frame.
        contested: (h, w) pixels where the frames do not settle what the ground is.
        background: (h, w, 3) the ground, in the frames' colours.
    """

    moving: Bool[Array, "K h w"]
    contested: Bool[Array, "h w"]
    background: UInt8[Array, "h w 3"]


def find_traffic(stack: UInt8[Array, "K h w 3"], seen: Bool[Array, "K h w"]) -> Traffic:
    """Separate traffic from ground in small registered frames, about 1000 px wide.

    Args:
        stack: frames on one canvas, exposure compensated, any colour space, any order; pixels
            that a frame does not see are overwritten.
        seen: where each frame shows the canvas at all.

    Raises:
        ValueError: fewer than 4 frames.
    """
    if len(stack) < FEWEST:
        raise ValueError(f"{len(stack)} frames; at least {FEWEST} are needed")
    background = _median(stack, seen)
    threshold = max(FLOOR, DEVIATIONS * _noise(stack, seen, background))
    for _ in range(ROUNDS - 1):
        # not kept in a name: the votes of a round are as large as the frames
        background = _revise(
            stack, background, _votes(stack, seen, background, threshold), threshold
        )
    votes = _votes(stack, seen, background, threshold)
    moving = np.empty(seen.shape, bool)
    for frame, mine, mask in zip(stack, seen, moving, strict=True):
        mask[:] = mine & cv2.dilate(_foreground(frame, background, threshold), DISC).view(bool)
    ground = _mean(stack, seen & ~moving, background)
    return Traffic(moving, _contested(votes, moving, seen), ground)


def _noise(
    stack: UInt8[Array, "K h w 3"], seen: Bool[Array, "K h w"], background: UInt8[Array, "h w 3"]
) -> float:
    """Standard deviation of a frame about the background where it shows ground: robust, median."""
    typical = [
        np.median(_difference(frame, background)[::4, ::4][mine[::4, ::4]])
        for frame, mine in zip(stack[::4], seen[::4], strict=True)
        if mine[::4, ::4].any()
    ]
    return 1.4826 * float(np.median(typical)) if typical else 0.0


def _median(stack: UInt8[Array, "K h w 3"], seen: Bool[Array, "K h w"]) -> UInt8[Array, "h w 3"]:
    """Median over the frames that see a pixel, by bisection: 8 counts instead of a sort."""
    kind = np.uint8 if len(stack) < 256 else np.uint16
    half = np.maximum(seen.sum(0, dtype=np.uint16), 1)[..., None] / np.float32(2)
    stack[~seen] = 0  # never counts as bright
    low = np.zeros(stack.shape[1:], np.uint8)
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        middle = low | np.uint8(bit)
        count = np.zeros(low.shape, kind)
        for frame in stack:
            count += frame >= middle
        low = np.where(count >= half, middle, low)
    return low


def _difference(one: UInt8[Array, "h w 3"], other: UInt8[Array, "h w 3"]) -> UInt8[Array, "h w"]:
    """Largest absolute difference of the three channels."""
    first, second, third = cv2.split(cv2.absdiff(one, other))
    return np.asarray(cv2.max(cv2.max(first, second), third), np.uint8)


def _foreground(
    frame: UInt8[Array, "h w 3"], background: UInt8[Array, "h w 3"], threshold: float
) -> UInt8[Array, "h w"]:
    """1 on solid regions that differ, their holes filled: a car's roof may look like asphalt."""
    differs = (_difference(frame, background) > threshold).view(np.uint8)
    solid = cv2.morphologyEx(differs, cv2.MORPH_OPEN, CROSS)
    solid = cv2.morphologyEx(solid, cv2.MORPH_CLOSE, DISC)
    outlines, _ = cv2.findContours(solid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(solid, outlines, -1, 1, -1), np.uint8)


def _votes(
    stack: UInt8[Array, "K h w 3"],
    seen: Bool[Array, "K h w"],
    background: UInt8[Array, "h w 3"],
    threshold: float,
) -> Float32[Array, "K h w"]:
    """Votes in [-1, 1] of each frame: above 0 it shows ground where the background does not."""
    votes = np.zeros(seen.shape, np.float32)

    def fill(k: int) -> None:
        cv2.copyTo(background, (~seen[k]).view(np.uint8), stack[k])
        votes[k] = _vote(stack[k], background, _foreground(stack[k], background, threshold))

    with ThreadPoolExecutor(cv2.getNumThreads()) as pool:
        list(pool.map(fill, range(len(stack))))
    return votes


def _vote(
    frame: UInt8[Array, "h w 3"], background: UInt8[Array, "h w 3"], region: UInt8[Array, "h w"]
) -> Float32[Array, "h w"]:
    """Whose outline is it: steps across the border of a region, weighed against each other.

    The border within REACH counts, and the whole region's mean as much as WHOLE pixels of it: the
    first tells a car from the ghost that it touches, the second is less noisy.
    """
    border = cv2.findNonZero(region - cv2.erode(region, CROSS, borderValue=1))
    if border is None:
        return np.zeros(region.shape, np.float32)
    columns, rows = border.reshape(-1, 2).T
    smooth = cv2.GaussianBlur(region * np.uint8(255), (0, 0), 1.5)
    normal = np.stack([cv2.Sobel(smooth, cv2.CV_16S, *d)[rows, columns] for d in ((0, 1), (1, 0))])
    normal = normal.astype(np.float32) * np.float32(1.5) / (np.hypot(*normal) + 1e-6)
    ours = _step(background, rows, columns, normal)
    theirs = _step(frame, rows, columns, normal)
    count, labels = cv2.connectedComponents(region, connectivity=4)
    at = labels[rows, columns]
    length = np.maximum(np.bincount(at, minlength=count), 1)
    excess, both = (
        _heard(rows, columns, steps, region.shape)
        + (WHOLE * np.bincount(at, steps, count) / length).astype(np.float32)[labels]
        for steps in (ours - theirs, ours + theirs)
    )
    return np.asarray(region * excess / np.maximum(both, 1e-3), np.float32)


def _heard(
    rows: Array, columns: Array, steps: Float32[Array, "m"], shape: tuple[int, ...]
) -> Float32[Array, "h w"]:
    """Sums of the border's steps within REACH, gathered in cells."""
    height, width = -(-shape[0] // CELL), -(-shape[1] // CELL)
    cell = rows // CELL * width + columns // CELL
    sums = np.bincount(cell, steps, height * width).reshape(height, width).astype(np.float32)
    window = (REACH // CELL, REACH // CELL)
    near = cv2.boxFilter(sums, cv2.CV_32F, window, normalize=False)
    return np.asarray(near.repeat(CELL, 0)[: shape[0]].repeat(CELL, 1)[:, : shape[1]], np.float32)


def _step(
    image: UInt8[Array, "h w 3"], rows: Array, columns: Array, normal: Float32[Array, "2 m"]
) -> Float32[Array, "m"]:
    """Absolute difference across the border, summed over channels: blind to edges that cross it."""
    limit = np.array(image.shape[:2])[:, None] - 1
    here = np.stack([rows, columns])
    sides = [np.clip(np.rint(here + s * normal), 0, limit).astype(np.intp) for s in (1, -1)]
    inner, outer = (image[tuple(side)].astype(np.float32) for side in sides)
    return np.asarray(np.abs(inner - outer).sum(-1), np.float32)


def _revise(
    stack: UInt8[Array, "K h w 3"],
    background: UInt8[Array, "h w 3"],
    votes: Float32[Array, "K h w"],
    threshold: float,
) -> UInt8[Array, "h w 3"]:
    """Take the frame with the strongest vote where enough frames are like it and back it.

    Frames that are unlike both sides have no say: a third car that passes is evidence for neither.
    """
    best = votes.argmax(0)[None, ..., None]
    rival = np.take_along_axis(stack, best, 0)[0]
    backing = np.zeros(background.shape[:2], np.float32)
    like = np.zeros(background.shape[:2], np.uint16)
    for frame, vote in zip(stack, votes, strict=True):
        alike = _difference(frame, rival) <= threshold
        like += alike
        backing += vote * alike
    swap = (backing > 0) & (like >= SUPPORT * len(stack))
    revised = np.where(swap[..., None], rival, background)
    alike = np.stack([_difference(frame, revised) <= threshold for frame in stack])
    return _mean(stack, alike, revised)


def _mean(
    stack: UInt8[Array, "K h w 3"], chosen: Bool[Array, "K h w"], otherwise: UInt8[Array, "h w 3"]
) -> UInt8[Array, "h w 3"]:
    """Mean over the chosen frames of each pixel; `otherwise` where none is chosen."""
    total = np.zeros(otherwise.shape, np.float32)
    for frame, mine in zip(stack, chosen, strict=True):
        cv2.accumulate(frame, total, mine.view(np.uint8))
    count = chosen.sum(0)[..., None]
    mean = np.rint(total / np.maximum(count, 1)).astype(np.uint8)
    return np.where(count > 0, mean, otherwise)


def _contested(
    votes: Float32[Array, "K h w"], moving: Bool[Array, "K h w"], seen: Bool[Array, "K h w"]
) -> Bool[Array, "h w"]:
    """Ground that hardly any frame shows, or that a lasting rival nearly outvotes."""
    views = seen.sum(0)
    clean = views - moving.sum(0)
    majority = -votes.sum(0) / (sum(np.abs(vote) for vote in votes) + 1e-6)
    lasting = sum((vote != 0).astype(np.uint16) for vote in votes) >= 2 * SUPPORT * views
    few = (clean < np.maximum(SUPPORT * views, 2)) & (views > 0)
    return np.asarray(few | (lasting & (majority < DOUBT)), bool)
