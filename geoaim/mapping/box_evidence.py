"""Whether boxes lie on what a video shows: on what differs from the map, where agents were."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import warn
from geoaim.base.geometry import to_opencv, transform_points
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.mapping.video.frames import Frame

MIN_BOXES = 20  # of which a statistic tells something
WIDEST = 1280  # pixels of a frame's longer side that are compared
FRAMES = 12  # spread over the video, in which boxes are compared with the picture
CLEAR = 8.0  # times the median difference from the map: that of an agent
INNER = 0.7  # of a box's sides, inside of which its agent is
# of what boxes lack, by which another reading must be better, and least evidence of the boxes as
# they are given: 0.93 of right boxes of the sample video, 0.67 of those five frames late, 0.12 of
# those of a letterbox, and under 0.07 of others; other readings of right boxes lack 1.0 or more
BETTER, LEAST = 0.5, 0.15
# standard errors over the frames, by which boxes of a frame or two before or after must be better
CERTAIN = 3.0

Bounds = Float[Array, "_ 4"]  # left, top, right, bottom; pixels


@dataclass(frozen=True, eq=False)
class View:
    """A frame, perhaps reduced, and where it differs from the map as it sees it."""

    index: int  # of the frame
    differs: Float[Array, "H W"]  # 0 to 1
    known: Bool[Array, "H W"]  # which pixels the map covers


def shrink(grey: UInt8[Array, "H W"]) -> UInt8[Array, "h w"]:
    """Reduce a grey frame to what is compared.

    >>> shrink(np.zeros((2160, 3840), np.uint8)).shape
    (720, 1280)
    """
    factor = min(WIDEST / max(grey.shape), 1.0)
    size = [round(side * factor) for side in grey.shape[::-1]]
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)


def compare(frame: Shaped[Array, "H W"], view: Shaped[Array, "H W"], known: Array) -> Array:
    """Compare a grey frame with the map as it sees it: 0 where they are alike, 1 where they differ.

    The map is brought to the contrast and brightness of the frame.
    """
    one, other = (cv2.GaussianBlur(part.astype(np.float32), (0, 0), 1.0) for part in (frame, view))
    gain = one[known].std() / max(float(other[known].std()), 1e-6)
    difference = np.abs(one - one[known].mean() - gain * (other - other[known].mean())) * known
    return np.asarray(np.minimum(difference / (CLEAR * max(np.median(difference[known]), 0.5)), 1))


def view_frames(
    frames: Iterable[Frame],
    map_from_frame: Mapping[int, Float[Array, "3 3"]],
    grey: UInt8[Array, "h w"],
    covered: Bool[Array, "h w"],
) -> list[View]:
    """Compare frames, each by its number's transform to the map's pixels, with a grey map."""
    views = []
    for frame in frames:
        small = shrink(frame.grey)
        ratio = np.array([*frame.grey.shape[::-1], 1]) / [*small.shape[::-1], 1]
        matrix = map_from_frame[frame.index] @ np.diag(ratio)
        view, seen = view_map(grey, covered, matrix, small.shape)
        if seen.any():
            views.append(View(frame.index, compare(small, view, seen), seen))
    return views


def view_map(
    image: UInt8[Array, "h w *c"],
    covered: Bool[Array, "h w"],
    map_from_frame: Float[Array, "3 3"],
    size: tuple[int, int],
) -> tuple[UInt8[Array, "H W *c"], Bool[Array, "H W"]]:
    """View a map's image, grey or RGB, as a frame of that (height, width) does."""
    matrix = to_opencv(np.linalg.inv(map_from_frame))
    view = cv2.warpPerspective(image, matrix, size[::-1], flags=cv2.INTER_LINEAR)
    known = cv2.warpPerspective(
        covered.astype(np.uint8), matrix, size[::-1], flags=cv2.INTER_NEAREST
    )
    return np.asarray(view, np.uint8), np.asarray(known) > 0


def check_evidence(
    views: Sequence[View],
    boxes: Mapping[int, DetectedBoxes | None],
    reference_from_frame: Mapping[int, Float[Array, "3 3"]],
    size: tuple[int, int],
    rate: float,
) -> int | None:
    """Warn where boxes do not lie on what differs from the map, or would do so read otherwise.

    Only boxes of agents that moved on count: who stands all the time may be in the map. Boxes and
    transforms to the pixels of one frame are by number of frame; the size is width and height, the
    rate frames a second. Gives how many such boxes there are, if too few to tell.
    """
    if not views:
        return None
    sums = [[cv2.integral(np.asarray(p, float)) for p in (v.differs, v.known)] for v in views]
    usual = float(np.mean([view.differs[view.known].mean() for view in views]))
    moving = _find_moving(boxes, reference_from_frame)
    at = [view.index for view in views]
    given, count = _weigh(sums, [moving.get(n) for n in at], usual, size)
    if count < MIN_BOXES:
        return count
    best, text = given, ""
    for what, read in _list_readings(moving, at, size, reference_from_frame, rate):
        value, number = _weigh(sums, read, usual, size)
        if number >= max(MIN_BOXES, count / 2) and value > best:
            best, text = value, what
    found = f"of boxes that move {max(given, 0):.0%} differs from the map"
    if 1 - best < BETTER * (1 - given) and best > 2 * LEAST:
        warn(f"{found}; it would be {best:.0%} {text}")
    elif given < LEAST:
        warn(f"{found}; most of it is needed: are they of this video, and of these frames?")
    elif lag := _find_lag(sums, moving, at, usual, size):
        warn(f"{found}, and surely more of those {_describe_lag(lag)}")
    return None


def _find_moving(
    boxes: Mapping[int, DetectedBoxes | None], reference_from_frame: Mapping[int, Array]
) -> dict[int, Bounds]:
    """Find the boxes of each frame at whose place there is none at some other time."""
    ends = {n: np.asarray(own.boxes, float) for n, own in boxes.items() if own is not None}
    places = {
        n: transform_points(reference_from_frame[n], (own[:, :2] + own[:, 2:]) / 2)
        for n, own in ends.items()
        if n in reference_from_frame
    }
    times = [n for n in list(places)[:: max(len(places) // FRAMES, 1)] if len(places[n])]
    moving = {}
    for n, own in places.items():
        reach = (ends[n][:, 2:] - ends[n][:, :2]).max(axis=1, initial=0) / 2
        left = np.zeros(len(own), bool)
        for other in times:
            left |= np.hypot(*(own[:, None] - places[other]).transpose(2, 0, 1)).min(1) > reach
        moving[n] = ends[n][left]
    return moving


def _weigh(
    sums: Sequence[Sequence[Array]],
    boxes: Sequence[Bounds | None],
    usual: float,
    size: tuple[int, int],
) -> tuple[float, int]:
    """Weigh how much of the boxes differs from the map, less what does so anywhere; and count."""
    shares = []
    for (differs, known), own in zip(sums, boxes, strict=True):
        if own is None:
            continue
        limits = np.array(known.shape[::-1] * 2) - 1
        own = own * (limits / np.array(size * 2))
        middle, half = (own[:, :2] + own[:, 2:]) / 2, INNER * (own[:, 2:] - own[:, :2]) / 2
        ends = np.concatenate([middle - half, middle + half], axis=1)
        ends = ends.round().clip(0, limits).astype(int)
        area = _add_up(known, ends)
        seen = area > 2 * half.prod(axis=1)  # half of the box is on the map
        shares += (_add_up(differs, ends)[seen] / np.maximum(area[seen], 1)).tolist()
    mean = float(np.mean(shares)) if shares else 0.0
    return (mean - usual) / (1 - usual), len(shares)


def _add_up(integral: Float[Array, "h w"], ends: Int[Array, "n 4"]) -> Float[Array, " n"]:
    left, top, right, bottom = ends.T
    upper, lower = (integral[row, right] - integral[row, left] for row in (top, bottom))
    return np.asarray(lower - upper)


def _list_readings(
    boxes: Mapping[int, Bounds],
    at: Sequence[int],
    size: tuple[int, int],
    reference_from_frame: Mapping[int, Array],
    rate: float,
) -> Iterator[tuple[str, list[Bounds | None]]]:
    """List what boxes may be instead of what they are taken for, and those of some frames so."""
    whole, exchanged = np.array(size * 2), [1, 0, 3, 2]
    text = "with x and y exchanged, as in TensorFlow's ymin, xmin, ymax, xmax: exchange them"
    slips: tuple[tuple[str, Callable[[Bounds], Bounds]], ...] = (
        (
            "if y counts from the bottom: turn them over",
            lambda own: np.where([False, True] * 2, whole - own[:, [2, 3, 0, 1]], own),
        ),
        (text, lambda own: own[:, exchanged]),  # of pixels, and of shares
        (text, lambda own: own[:, exchanged] * whole / whole[exchanged]),
        (
            "as shares of a square to which frames were padded: give boxes of the frames",
            lambda own: (own - whole / 2) * max(size) / whole + whole / 2,
        ),
    )
    for text, change in slips:
        yield text, [change(boxes[n]) if n in boxes else None for n in at]
    moved = {
        n: transform_points(np.linalg.inv(reference_from_frame[n]), boxes[n].reshape(-1, 2))
        for n in boxes.keys() & at
        if np.isfinite(reference_from_frame[n]).all()
    }
    text = "if they are of a stabilised video: detect vehicles in this one"
    yield text, [moved[n].reshape(-1, 4) if n in moved else None for n in at]
    for stride in range(2, 31):
        text = f"if one in {stride} frames has boxes, numbered on: --rate {rate / stride:.4g}"
        yield f"{text} says so", [boxes.get(n // stride) for n in at]
    for lag in range(1, max(boxes, default=0)):
        yield _describe_lag(lag), [boxes.get(n + lag) for n in at]
        yield _describe_lag(-lag), [boxes.get(n - lag) for n in at]


def _describe_lag(lag: int) -> str:
    """Describe boxes that are late by some frames, or early.

    >>> _describe_lag(2)
    '2 frames earlier: do they count from 2 (--first 2)?'
    """
    if lag > 0:
        return f"{lag} frames earlier: do they count from {lag} (--first {lag})?"
    return f"{-lag} frames later: are they of a part of the video that begins there?"


def _find_lag(
    sums: Sequence[Sequence[Array]],
    boxes: Mapping[int, Bounds],
    at: Sequence[int],
    usual: float,
    size: tuple[int, int],
) -> int:
    """Find by how few frames boxes are surely late, or early (< 0): to where they fit best."""

    def weigh(lag: int) -> Float[Array, "n"]:
        read = [boxes.get(n + lag) for n in at]
        pairs = [_weigh([own], [one], usual, size) for own, one in zip(sums, read, strict=True)]
        return np.array([value if count else np.nan for value, count in pairs])

    def gain(one: Float[Array, "n"], other: Float[Array, "n"]) -> tuple[float, float]:
        known = (one - other)[np.isfinite(one - other)]
        if len(known) < 2:
            return 0.0, np.inf
        return float(known.mean()), float(known.std(ddof=1) / np.sqrt(len(known)))

    given = weigh(0)
    for step in (1, -1):
        lag, now = 0, given
        while gain(after := weigh(lag + step), now)[0] > 0:
            lag, now = lag + step, after
        better, sigma = gain(now, given)
        if better > CERTAIN * sigma:
            return lag
    return 0
