"""Vehicles in what differs from the ground: no shadows, neighbours split, turned boxes."""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from skimage.segmentation import watershed

from geoaim.tracking.background_difference import UNIT

CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
WEAK = 0.6  # of the tolerance; what differs by so much belongs to what differs by more
CLOSING_M = 0.5  # gaps in a vehicle
MIN_AREA_M2 = 0.25  # of anything
# of what touches; more is a change of light or a frame that is registered badly, and took minutes
MAX_GROUP_M2 = 3000.0
MIN_STRONG_M2 = 0.15  # that differs by the whole tolerance
MIN_BODY_SHARE = 0.25  # of what differs; a smaller body is a dark vehicle with highlights
MAX_WIDTH_M, MAX_LENGTH_M = 3.0, 20.0  # of a vehicle
MAX_CAR_LENGTH_M = 6.5  # a longer vehicle is wider than `MAX_CAR_WIDTH_M`
MAX_CAR_WIDTH_M = 2.2
MAX_JOINED_WIDTH_M, MIN_JOINED = 2.5, 0.85  # of a car whose parts are joined; what differs in it
MIN_FILLED = 0.55  # of a vehicle's box
EROSIONS_M = (0.2, 0.35, 0.5, 0.65, 0.8)  # by which neighbours are told apart
MIN_PART_M2 = 2.0  # of the core of a neighbour that is split off, before erosion


@dataclass(frozen=True, eq=False)
class Shapes:
    """Vehicles of a frame as turned boxes on the grid."""

    corners: Float[Array, "N 4 2"]  # cells; the first side along the longer one
    scores: Float[Array, " N"]


def find_shapes(
    strength: UInt8[Array, "H W"],
    shaded: UInt8[Array, "H W"],
    resolution: float,
    sun: Float[Array, "2"],
    min_area: float = MIN_AREA_M2,
) -> Shapes:
    """Find the shapes of vehicles in what differs from the ground.

    Args:
        strength: the difference, `UNIT` for one of the tolerance.
        shaded: which cells may be shadow.
        resolution: metres per cell.
        sun: from a vehicle's outline to its shadow's, cells; zero where that is not known.
        min_area: of a shape, m².

    Returns:
        The boxes of all that may be a vehicle, a pedestrian or a cyclist.
    """
    weak = (strength > WEAK * UNIT).view(np.uint8)
    size = 2 * max(1, round(CLOSING_M / resolution / 2)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    joined = cv2.morphologyEx(weak, cv2.MORPH_CLOSE, kernel)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(joined)
    boxes, scores = [], []
    for number in range(1, count):
        left, top, width, height, area = stats[number].tolist()
        if not min_area <= area * resolution**2 <= MAX_GROUP_M2:
            continue
        window = slice(top, top + height), slice(left, left + width)
        group = labels[window] == number
        strong = group & (strength[window] > UNIT)
        if strong.sum() * resolution**2 < MIN_STRONG_M2:
            continue
        body = _find_body(group, weak[window], shaded[window], kernel, sun)
        for part in _join(_split(body, resolution), group, resolution):
            if part.sum() * resolution**2 < min_area:
                continue
            corners = _fit_box(_trim_rim(part, strength[window]))
            level = float(np.mean(strength[window][part])) / UNIT
            boxes.append(corners + np.array([left, top]))
            scores.append(min(1.0, level / 2.5))
    return Shapes(np.array(boxes, float).reshape(-1, 4, 2), np.array(scores, float))


def _find_body(
    group: Bool[Array, "h w"],
    weak: UInt8[Array, "h w"],
    shaded: UInt8[Array, "h w"],
    kernel: UInt8[Array, "k k"],
    sun: Float[Array, "2"],
) -> Bool[Array, "h w"]:
    """Find the parts of a group that are no shadow; of one that is dark, by where the sun stands.

    A dark vehicle and its shadow, which is the same outline moved, cover the group together.
    """
    body = (group & (weak > 0) & (shaded == 0)).view(np.uint8)
    pad = len(kernel)
    padded = cv2.copyMakeBorder(body, pad, pad, pad, pad, cv2.BORDER_CONSTANT)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)
    if min(group.shape) > 5:
        closed = cv2.morphologyEx(closed, cv2.MORPH_OPEN, CROSS)
    body = closed[pad:-pad, pad:-pad] > 0
    if body.sum() > MIN_BODY_SHARE * group.sum():
        return body
    back = np.array([[1.0, 0.0, -sun[0]], [0.0, 1.0, -sun[1]]])
    moved = cv2.warpAffine(
        group.view(np.uint8), back, group.shape[::-1], flags=cv2.INTER_NEAREST, borderValue=0
    )
    dark = group & (moved > 0)
    return dark if dark.sum() > MIN_BODY_SHARE * group.sum() else group


def _split(body: Bool[Array, "h w"], resolution: float) -> list[Bool[Array, "h w"]]:
    """Split a body into the vehicles that touch in it."""
    count, labels = cv2.connectedComponents(body.view(np.uint8))
    parts: list[Bool[Array, "h w"]] = []
    for number in range(1, count):
        part = labels == number
        parts += [part] if _is_one(part, resolution) else _split_touching(part, resolution)
    return parts


def _join(
    parts: list[Bool[Array, "h w"]], group: Bool[Array, "h w"], resolution: float
) -> list[Bool[Array, "h w"]]:
    """Join parts of a dark car whose roof looks like shadow: all of their common box differs."""
    for one, other in combinations(range(len(parts)), 2):
        corners = _fit_box(parts[one] | parts[other])
        sides = np.hypot(*np.diff(corners[:3], axis=0).T) * resolution
        if sides[0] > MAX_CAR_LENGTH_M or sides[1] > MAX_JOINED_WIDTH_M:
            continue
        box = np.zeros(group.shape, np.uint8)
        cv2.fillConvexPoly(box, np.rint(corners - 0.5).astype(np.int32), 1)
        inside = (box > 0) & group
        if inside.sum() > MIN_JOINED * box.sum():
            rest = [part for k, part in enumerate(parts) if k not in (one, other)]
            return _join([inside, *rest], group, resolution)
    return parts


def _is_one(part: Bool[Array, "h w"], resolution: float) -> bool:
    """Tell whether a part may be one vehicle, by its sides and how much of its box it fills."""
    corners = _fit_box(part)
    length = float(np.hypot(*(corners[1] - corners[0]))) * resolution
    width = float(np.hypot(*(corners[2] - corners[1]))) * resolution
    filled = part.sum() * resolution**2 / (length * width)
    if length > MAX_LENGTH_M or width > MAX_WIDTH_M or filled < MIN_FILLED:
        return False
    return length < MAX_CAR_LENGTH_M or width > MAX_CAR_WIDTH_M or bool(filled > 0.85)


def _split_touching(part: Bool[Array, "h w"], resolution: float) -> list[Bool[Array, "h w"]]:
    """Split a part at its narrow places, at the first erosion that leaves several cores."""
    padded = np.pad(part, 1)
    depth = cv2.distanceTransform(padded.view(np.uint8), cv2.DIST_L2, 5) * resolution
    for erosion in EROSIONS_M:
        if erosion < 0.8 * resolution:
            continue
        count, cores, stats, _ = cv2.connectedComponentsWithStats((depth > erosion).view(np.uint8))
        least = max(MIN_PART_M2 - 6.0 * erosion, 0.3) / resolution**2
        kept = [n for n in range(1, count) if stats[n, cv2.CC_STAT_AREA] >= least]
        if len(kept) > 1:
            seeds = np.where(np.isin(cores, kept), cores, 0)
            flooded: Any = watershed  # it has no types
            labels: Int[Array, "H W"] = flooded(-depth, seeds, mask=padded)[1:-1, 1:-1]
            # what is farther from a core than the erosion is the bridge between both
            reach = cv2.distanceTransform((seeds == 0).view(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
            near = reach <= erosion / resolution + 1.5
            return [one for n in kept for one in _split((labels == n) & near, resolution)]
    return [part]


def _trim_rim(part: Bool[Array, "h w"], strength: UInt8[Array, "h w"]) -> Bool[Array, "h w"]:
    """Leave out cells of the rim that differ by less than half of what is beside them: blur."""
    inner = cv2.erode(part.view(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    most = cv2.dilate(strength * part, np.ones((5, 5), np.uint8))
    return np.asarray(part & ((inner > 0) | (strength >= most / 2)))


def _fit_box(part: Bool[Array, "h w"]) -> Float[Array, "4 2"]:
    """Fit the smallest turned box about the cells of a part, its first side the longer one."""
    rows, columns = np.nonzero(part)
    points = np.column_stack([columns, rows]).astype(np.float32)
    (x, y), sides, turn = cv2.minAreaRect(points)
    along = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
    across = np.array([-along[1], along[0]])
    width, height = sides[0] + 1.0, sides[1] + 1.0
    if height > width:
        along, across, width, height = across, -along, height, width
    middle = np.array([x, y]) + 0.5
    half, side = along * width / 2, across * height / 2
    return np.stack(
        [middle - half - side, middle + half - side, middle + half + side, middle - half + side]
    )
