"""The ground as registered frames show it: streaming means, in memory that no length changes.

`average_frames` is the mean of stabilised frames, masked where boxes are given. `remove_traffic`
needs no boxes: it reads the frames twice, first small to find the traffic. Frames of video are
averaged as Y, U and V planes, so that only the result is converted to RGB.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16
from numpy import ndarray as Array

from geoaim.errors import BackgroundError
from geoaim.geometry import transform_boxes
from geoaim.mapping.background.accumulate import (
    Plane,
    add_frame,
    compare_exposure,
    empty_planes,
    enlarge,
    fill_polygons,
    first_exposure,
    footprint,
    mean_image,
    shrink_frame,
    warp,
)
from geoaim.mapping.background.traffic_removal import FEWEST, Traffic, find_traffic
from geoaim.mapping.video.detections import Boxes, grow_boxes
from geoaim.mapping.video.frames import Frame

Registered = tuple[Frame, Float[Array, "3 3"]]  # a frame and its reference_from_frame
View = tuple[Frame, Float[Array, "3 3"], UInt8[Array, "H W"] | None]  # image_from_frame and mask

SMALL = 1024  # px, longest side of the frames in which traffic is looked for
BLOCK = 8  # px; change is judged on means of such blocks: noise is gone, ghosts are not
FIRST_CHECK = 16  # frames before the first look at what more of them change


@dataclass(frozen=True, eq=False)
class Background:
    """The ground, and how many frames tell of it.

    Attributes:
        image: (H, W, 3) RGB at the first frame's exposure; 0 where no frame reaches.
        coverage: (H, W) frames averaged at each pixel; 0 where none showed the ground.
        contested: (H, W) the ground is in doubt: masked in every frame (the image then shows the
            mean with traffic, and coverage is 0), or two lasting states dispute it.
        frames_used: frames that were read and averaged.
        change: grey levels by which the latter half of the frames moved the image: 99.9 % of its
            blocks of 8 x 8 pixels moved less. NaN with fewer than 32 frames, and from
            `remove_traffic` without a tolerance.
        gains: (frames_used,) factors that bring each frame to the exposure of the first.
    """

    image: UInt8[Array, "H W 3"]
    coverage: UInt16[Array, "H W"]
    contested: Bool[Array, "H W"]
    frames_used: int
    change: float
    gains: Float[Array, "frames_used"]


def average_frames(
    frames: Iterable[Registered],
    *,
    size: tuple[int, int],
    image_from_reference: Float[Array, "3 3"] | None = None,
    boxes: Boxes | None = None,
    tolerance: float = 0.0,
    bands: int = 1,
) -> Background:
    """Mean of registered frames, of what lies outside their boxes where boxes are given.

    Each pixel is the mean of all frames that show it; with `bands` it is the mean of every
    `bands`-th frame: each frame is warped only onto one of as many stripes of rows, in turn.

    Args:
        frames: each with its reference_from_frame, read once.
        size: (height, width) of the image, pixels.
        image_from_reference: where the image lies; by default it begins at the reference's corner.
        boxes: what to leave out of a frame, as left, top, right, bottom in its pixels; grown by
            12 %. None for a frame of which nothing is known: it is then left out as a whole.
        tolerance: stop when `Background.change` is at most this (grey levels); give the frames in
            an order that spreads over the video, as `spread_order` does. 0 takes all frames.
        bands: stripes that the image is cut into.

    Raises:
        BackgroundError: not one frame.
    """
    place = np.eye(3) if image_from_reference is None else image_from_reference

    def views() -> Iterator[View]:
        for frame, reference_from_frame in frames:
            image_from_frame = place @ reference_from_frame
            if boxes is None:
                yield frame, image_from_frame, None
            elif (known := boxes(frame)) is not None:
                yield frame, image_from_frame, _mask_boxes(known, image_from_frame, size)

    return _average(views(), size, tolerance, bands)


def remove_traffic(
    frames: Iterable[Registered],
    *,
    size: tuple[int, int],
    image_from_reference: Float[Array, "3 3"] | None = None,
    tolerance: float = 0.0,
) -> Background:
    """Mean of what `ghosts.find_traffic` takes for ground in registered frames.

    Some 30 to 60 frames spread over the video are enough, and memory grows by 5 to 8 MB with each.

    Args:
        frames: each with its reference_from_frame; read twice, so no one-shot iterator.
        size: (height, width) of the image, pixels.
        image_from_reference: where the image lies; by default it begins at the reference's corner.
        tolerance: as in `average_frames`.

    Raises:
        BackgroundError: fewer than 4 frames.
        TypeError: the frames can be read only once.
    """
    if iter(frames) is frames:
        raise TypeError("the frames are read twice: give a list, or make __iter__ start anew")
    place = np.eye(3) if image_from_reference is None else image_from_reference
    traffic, change = _watch_traffic(frames, place, size, tolerance)

    def views() -> Iterator[View]:
        # the masks first: when they run out, no further frame is read
        for moving, (frame, reference_from_frame) in zip(traffic.moving, frames, strict=False):
            yield frame, place @ reference_from_frame, enlarge(~moving, size)

    seen = _average(views(), size, 0.0, 1)
    disputed = enlarge(traffic.contested, size).view(bool) & (seen.coverage > 0)
    return replace(seen, contested=seen.contested | disputed, change=change)


def spread_order(count: int) -> list[int]:
    """The numbers 0 to count - 1 so that any first part of them is spread over the whole.

    Bits reversed, as in van der Corput's sequence.

    >>> spread_order(6)
    [0, 4, 2, 1, 5, 3]
    """
    digits = max(count - 1, 0).bit_length()
    mirrored = (int(format(i, f"0{digits}b")[::-1], 2) if digits else 0 for i in range(1 << digits))
    return [i for i in mirrored if i < count]


def _average(
    views: Iterable[View], size: tuple[int, int], tolerance: float, bands: int
) -> Background:
    planes: tuple[Plane, ...] = ()
    exposure, gains = first_exposure(size), list[float]()
    before: Float32[Array, "h w c"] | None = None
    change, frame = np.nan, None
    for frame, matrix, mask in views:
        planes = planes or empty_planes(frame, size)
        gain = compare_exposure(exposure, frame, matrix, gains[-1] if gains else 1.0)
        rows = _stripe(len(gains) % bands, bands, size[0])
        add_frame(planes, frame, matrix, mask, gain, rows)
        gains.append(gain)
        if _is_time_to_check(len(gains), bands):
            after = _block_means(planes[0])
            change, before = _change(before, after), after
            if tolerance > 0 and change <= tolerance:
                break
    if frame is None:
        raise BackgroundError(
            "there is no frame to average: none is registered, or no boxes are known of any; "
            "look at the registration's reasons and at the names of the box files"
        )
    image = mean_image(planes, frame)
    hidden = (planes[0].weight == 0) & (planes[0].spare_weight > 0)
    return Background(image, planes[0].weight, hidden, len(gains), change, np.array(gains))


def _watch_traffic(
    frames: Iterable[Registered],
    place: Float[Array, "3 3"],
    size: tuple[int, int],
    tolerance: float,
) -> tuple[Traffic, float]:
    """Look for traffic in small frames, until more of them no longer change the ground."""
    factor = -(-max(size) // SMALL)
    small = (-(-size[0] // factor), -(-size[1] // factor))
    small_from_canvas = np.diag([small[1] / size[1], small[0] / size[0], 1.0])
    exposure, gain, change = first_exposure(size), 1.0, np.nan
    stack: list[UInt8[Array, "h w 3"]] = []
    seen: list[Bool[Array, "h w"]] = []
    before: Float32[Array, "h w c"] | None = None
    traffic: Traffic | None = None
    for frame, reference_from_frame in frames:
        matrix = place @ reference_from_frame
        gain = compare_exposure(exposure, frame, matrix, gain)
        pixels, small_from_frame = shrink_frame(frame, factor, gain)
        matrix = small_from_canvas @ matrix @ np.linalg.inv(small_from_frame)
        stack.append(warp(pixels, matrix, small))
        seen.append(footprint(pixels.shape, matrix, small).view(bool))
        traffic = None
        if tolerance > 0 and _is_time_to_check(len(stack), 1):
            traffic = find_traffic(*_pack(stack, seen))
            after = _shrink_to_blocks(traffic.background.astype(np.float32), factor)
            change, before = _change(before, after), after
            if change <= tolerance:
                return traffic, change
    if len(stack) < FEWEST:
        raise BackgroundError(
            f"{len(stack)} registered frames; at least {FEWEST} are needed to tell traffic from "
            "ground: register more frames, give boxes, or average the frames as they are"
        )
    return traffic or find_traffic(*_pack(stack, seen)), change


def _pack(
    stack: list[UInt8[Array, "h w 3"]], seen: list[Bool[Array, "h w"]]
) -> tuple[UInt8[Array, "K h w 3"], Bool[Array, "K h w"]]:
    """Each list as one array, which the list's items become views of: nothing is held twice."""
    packed = np.stack(stack), np.stack(seen)
    stack[:], seen[:] = packed
    return packed


def _is_time_to_check(count: int, bands: int) -> bool:
    """Whenever the frames have doubled."""
    return count >= FIRST_CHECK * bands and count.bit_count() == 1


def _block_means(plane: Plane) -> Float32[Array, "h w c"]:
    """Means of blocks, NaN where no frame has shown one."""
    total = _shrink_to_blocks(plane.total, 1)
    weight = _shrink_to_blocks(plane.weight.astype(np.float32), 1)
    return np.where(weight > 0, total / np.maximum(weight, 1e-6), np.float32(np.nan))


def _shrink_to_blocks(pixels: Float32[Array, "H W *c"], factor: int) -> Float32[Array, "h w c"]:
    """Area means of blocks of 8 pixels of the canvas, of which the pixels show 1/factor."""
    size = [max(extent * factor // BLOCK, 1) for extent in pixels.shape[1::-1]]
    blocks = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.float32)
    return blocks.reshape(size[1], size[0], -1)


def _change(before: Float32[Array, "h w c"] | None, after: Float32[Array, "h w c"]) -> float:
    if before is None:
        return np.nan
    moved = np.abs(after - before)
    known = moved[np.isfinite(moved)]
    return float(np.quantile(known, 0.999)) if len(known) else np.nan


def _mask_boxes(
    boxes: Float[Array, "N 4"], matrix: Float[Array, "3 3"], size: tuple[int, int]
) -> UInt8[Array, "H W"]:
    """0 inside the grown boxes, as they lie on the canvas; 1 elsewhere."""
    return fill_polygons(np.ones(size, np.uint8), transform_boxes(matrix, grow_boxes(boxes)), 0)


def _stripe(number: int, bands: int, height: int) -> slice:
    """Rows of a stripe; it begins on an even row, where chroma does."""
    first, last = (2 * (height * i // (2 * bands)) for i in (number, number + 1))
    return slice(first, height if number == bands - 1 else last)
