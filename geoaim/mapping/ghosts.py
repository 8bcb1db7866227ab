"""Traffic in registered frames without boxes: which pixels of which frame show the empty ground.

A car that stands for most of the clip is what mean, median and mixture models take for ground.
But an object has an outline and the bare ground has none: where a frame and the background differ
over a region, the one with the stronger step across the region's border shows the object. Each
frame votes so, and where votes and numbers agree the background changes sides.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray as Array

ROUNDS = 4  # votes; after three of them the background has moved where it will, the last judges
FLOOR = 8  # grey levels; below this a difference is compression, not traffic
DEVIATIONS = 3.0  # of the noise between frames that a difference must exceed
REACH = 31  # px, about a car's length at this size: how far along the outline a vote is heard
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
        ValueError: fewer than 4 frames: no majority could be told from chance.
    """
    if len(stack) < 4:
        raise ValueError(f"at least 4 frames are needed to tell traffic from ground: {len(stack)}")
    background = _median(stack, seen)
    noise = np.median([np.median(_difference(f, background)[::4, ::4]) for f in stack[::4]])
    threshold = max(FLOOR, DEVIATIONS * 1.4826 * float(noise))
    for _ in range(ROUNDS - 1):
        votes = _votes(stack, seen, background, threshold)
        background = _revise(stack, background, votes, threshold)
    votes = _votes(stack, seen, background, threshold)
    moving = np.empty(seen.shape, bool)
    for frame, mine, mask in zip(stack, seen, moving, strict=True):
        found = _foreground(frame, background, threshold)
        mask[:] = cv2.dilate(found, DISC) * mine
    return Traffic(moving, _contested(votes, moving, seen), background)


def _median(stack: UInt8[Array, "K h w 3"], seen: Bool[Array, "K h w"]) -> UInt8[Array, "h w 3"]:
    """Median over the frames that see a pixel, by bisection: 8 counts instead of a sort."""
    total = seen.sum(0, dtype=np.uint16)[..., None]
    low = np.zeros(stack.shape[1:], np.uint8)
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        middle = low | np.uint8(bit)
        count = np.zeros(low.shape, np.uint16)
        for frame, mine in zip(stack, seen, strict=True):
            count += (frame >= middle) & mine[..., None]
        low = np.where(2 * count >= np.maximum(total, 1), middle, low)
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
    for frame, mine, vote in zip(stack, seen, votes, strict=True):
        np.copyto(frame, background, where=~mine[..., None])
        vote[:] = _vote(frame, background, _foreground(frame, background, threshold))
    return votes


def _vote(
    frame: UInt8[Array, "h w 3"], background: UInt8[Array, "h w 3"], region: UInt8[Array, "h w"]
) -> Float32[Array, "h w"]:
    """Whose outline is it: steps across the region's border, heard within REACH of it.

    What lies farther inside hears the mean of its whole region.
    """
    rows, columns = np.nonzero(region - cv2.erode(region, CROSS, borderValue=1))
    if len(rows) == 0:
        return np.zeros(region.shape, np.float32)
    smooth = cv2.GaussianBlur(region.astype(np.float32), (0, 0), 1.5)
    normal = np.stack([cv2.Sobel(smooth, cv2.CV_32F, *d)[rows, columns] for d in ((0, 1), (1, 0))])
    normal *= 1.5 / (np.hypot(*normal) + 1e-6)
    ours = _step(background, rows, columns, normal)
    theirs = _step(frame, rows, columns, normal)
    count, labels = cv2.connectedComponents(region, connectivity=4)
    at = labels[rows, columns]
    length = np.bincount(at, minlength=count) + 1e-6
    heard = []
    for evidence in (ours - theirs, ours + theirs):
        line = np.zeros(region.shape, np.float32)
        line[rows, columns] = evidence
        whole = (0.05 * np.bincount(at, evidence, count) / length).astype(np.float32)
        heard.append(cv2.blur(line, (REACH, REACH)) + whole[labels])
    return np.asarray(np.where(region, heard[0] / (heard[1] + 1e-6), 0), np.float32)


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
    """Take the frame with the strongest vote where the majority and enough like frames back it."""
    best = votes.argmax(0)[None, ..., None]
    rival = np.take_along_axis(stack, best, 0)[0]
    backing = np.zeros(background.shape[:2], np.float32)
    like = np.zeros(background.shape[:2], np.uint16)
    for frame, vote in zip(stack, votes, strict=True):
        alike = _difference(frame, rival) <= threshold
        like += alike
        backing += vote * alike
    swap = (votes.sum(0) > 0) & (backing > 0) & (like >= SUPPORT * len(stack))
    revised = np.where(swap[..., None], rival, background)
    total = np.zeros(background.shape, np.float32)
    count = np.zeros(background.shape[:2], np.float32)
    for frame in stack:
        alike = (_difference(frame, revised) <= threshold).view(np.uint8)
        cv2.accumulate(frame, total, alike)
        count += alike
    mean = np.rint(total / np.maximum(count, 1)[..., None])
    return np.where(count[..., None] > 0, mean, revised).astype(np.uint8)


def _contested(
    votes: Float32[Array, "K h w"], moving: Bool[Array, "K h w"], seen: Bool[Array, "K h w"]
) -> Bool[Array, "h w"]:
    """Ground that hardly any frame shows, or that a lasting rival nearly outvotes."""
    views = seen.sum(0)
    clean = views - moving.sum(0)
    majority = -votes.sum(0) / (np.abs(votes).sum(0) + 1e-6)
    lasting = (votes != 0).sum(0) >= 2 * SUPPORT * views
    few = (clean < np.maximum(SUPPORT * views, 2)) & (views > 0)
    return np.asarray(few | (lasting & (majority < DOUBT)), bool)
