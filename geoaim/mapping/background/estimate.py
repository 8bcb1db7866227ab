"""The ground as registered frames show it: streaming means, in memory that no length changes.

`average_frames` is the mean of stabilised frames, masked where boxes are given. `remove_traffic`
needs no boxes: it reads the frames twice, first small to find the traffic. Frames of video are
averaged as Y, U and V planes, so that only the result is converted to RGB.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16
from numpy import ndarray as Array

from geoaim.errors import BackgroundError
from geoaim.geometry import transform_boxes
from geoaim.mapping.background.accumulate import (
    Exposure,
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
from geoaim.mapping.video.detections import Detections, grow_boxes
from geoaim.mapping.video.frames import Frame

Registered = tuple[Frame, Float[Array, "3 3"]]  # a frame and its reference_from_frame

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


@dataclass(eq=False)
class RunningMean:
    """A mean of the frames that `add_to_mean` has added so far, in place.

    Attributes:
        size: (height, width) of the image, pixels.
        detections: what to leave out of each frame, or None.
        tolerance: `change` at which the mean has converged, grey levels; 0 takes all frames.
        bands: stripes of rows that the frames fill in turn.
        exposure: of the frames so far.
        planes: sums of the image's planes; none before the first frame.
        gains: factors that bring each frame to the exposure of the first.
        blocks: means of blocks when `change` was last measured.
        change: as in `Background`.
        frame: the last one added.
    """

    size: tuple[int, int]
    detections: Detections | None
    tolerance: float
    bands: int
    exposure: Exposure
    planes: tuple[Plane, ...] = ()
    gains: list[float] = field(default_factory=list)
    blocks: Float32[Array, "h w c"] | None = None
    change: float = np.nan
    frame: Frame | None = None

    @property
    def converged(self) -> bool:
        """Whether further frames would hardly change the image."""
        return self.tolerance > 0 and self.change <= self.tolerance


@dataclass(eq=False)
class TrafficSearch:
    """Small copies of the frames that `add_to_search` has added so far, and the traffic in them.

    Attributes:
        size: (height, width) of the image, pixels.
        tolerance: `change` at which the ground has converged, grey levels; 0 takes all frames.
        exposure: of the frames so far.
        gain: factor that brings the last frame to the exposure of the first.
        stack: the small frames, on the image.
        seen: where each of them shows the image.
        traffic: in these frames, when it was looked for after the last of them.
        blocks: means of blocks when `change` was last measured.
        change: as in `Background`, of the small ground.
    """

    size: tuple[int, int]
    tolerance: float
    exposure: Exposure
    gain: float = 1.0
    stack: list[UInt8[Array, "h w 3"]] = field(default_factory=list)
    seen: list[Bool[Array, "h w"]] = field(default_factory=list)
    traffic: Traffic | None = None
    blocks: Float32[Array, "h w c"] | None = None
    change: float = np.nan

    @property
    def factor(self) -> int:
        """By how much the frames are reduced."""
        return -(-max(self.size) // SMALL)

    @property
    def small_size(self) -> tuple[int, int]:
        """(height, width) of the small frames."""
        return -(-self.size[0] // self.factor), -(-self.size[1] // self.factor)

    @property
    def converged(self) -> bool:
        """Whether further frames would hardly change the ground."""
        return self.tolerance > 0 and self.change <= self.tolerance


def average_frames(
    frames: Iterable[Registered],
    *,
    size: tuple[int, int],
    image_from_reference: Float[Array, "3 3"] | None = None,
    detections: Detections | None = None,
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
        detections: boxes to leave out of a frame, grown by 12 %. A frame of which nothing is
            known (None) is left out as a whole.
        tolerance: stop when `Background.change` is at most this (grey levels); give the frames in
            an order that spreads over the video, as `spread_order` does. 0 takes all frames.
        bands: stripes that the image is cut into.

    Raises:
        BackgroundError: not one frame.
    """
    place = np.eye(3) if image_from_reference is None else image_from_reference
    mean = start_mean(size, detections=detections, tolerance=tolerance, bands=bands)
    for frame, reference_from_frame in frames:
        add_to_mean(mean, frame, place @ reference_from_frame)
        if mean.converged:
            break
    return finish_mean(mean)


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
    search = start_search(size, tolerance)
    for frame, reference_from_frame in frames:
        add_to_search(search, frame, place @ reference_from_frame)
        if search.converged:
            break
    return average_ground(((frame, place @ matrix) for frame, matrix in frames), search)


def spread_order(count: int) -> list[int]:
    """The numbers 0 to count - 1 so that any first part of them is spread over the whole.

    Bits reversed, as in van der Corput's sequence.

    >>> spread_order(6)
    [0, 4, 2, 1, 5, 3]
    """
    digits = max(count - 1, 0).bit_length()
    mirrored = (int(format(i, f"0{digits}b")[::-1], 2) if digits else 0 for i in range(1 << digits))
    return [i for i in mirrored if i < count]


def start_mean(
    size: tuple[int, int],
    *,
    detections: Detections | None = None,
    tolerance: float = 0.0,
    bands: int = 1,
) -> RunningMean:
    """A mean of no frames yet; the arguments are those of `average_frames`."""
    return RunningMean(size, detections, tolerance, bands, first_exposure(size))


def add_to_mean(mean: RunningMean, frame: Frame, image_from_frame: Float[Array, "3 3"]) -> None:
    """Add a registered frame to a mean, in place; nothing is added when its boxes are unknown."""
    if mean.detections is None:
        _add_masked(mean, frame, image_from_frame, None)
    elif (known := mean.detections(frame)) is not None:
        _add_masked(mean, frame, image_from_frame, _mask_boxes(known, image_from_frame, mean.size))


def _add_masked(
    mean: RunningMean,
    frame: Frame,
    image_from_frame: Float[Array, "3 3"],
    mask: UInt8[Array, "H W"] | None,
) -> None:
    gains, bands = mean.gains, mean.bands
    mean.planes = mean.planes or empty_planes(frame, mean.size)
    gain = compare_exposure(mean.exposure, frame, image_from_frame, gains[-1] if gains else 1.0)
    rows = _stripe(len(gains) % bands, bands, mean.size[0])
    add_frame(mean.planes, frame, image_from_frame, mask, gain, rows)
    gains.append(gain)
    mean.frame = frame
    if _is_time_to_check(len(gains), bands):
        blocks = _block_means(mean.planes[0])
        mean.change, mean.blocks = _change(mean.blocks, blocks), blocks


def finish_mean(mean: RunningMean) -> Background:
    """The image of a mean; its sums are overwritten.

    Raises:
        BackgroundError: no frame was added.
    """
    if mean.frame is None:
        raise BackgroundError(
            "there is no frame to average: none is registered, or no detections are known of any; "
            "look at the registration's reasons and at the names of the box files"
        )
    image = mean_image(mean.planes, mean.frame)
    first = mean.planes[0]
    hidden = (first.weight == 0) & (first.spare_weight > 0)
    gains = np.array(mean.gains)
    return Background(image, first.weight, hidden, len(gains), mean.change, gains)


def start_search(size: tuple[int, int], tolerance: float = 0.0) -> TrafficSearch:
    """A search for traffic in no frames yet; the arguments are those of `remove_traffic`."""
    return TrafficSearch(size, tolerance, first_exposure(size))


def add_to_search(
    search: TrafficSearch, frame: Frame, image_from_frame: Float[Array, "3 3"]
) -> None:
    """Add a registered frame to a search, in place, and look for traffic at 16, 32, 64 frames."""
    factor, small = search.factor, search.small_size
    small_from_image = np.diag([small[1] / search.size[1], small[0] / search.size[0], 1.0])
    search.gain = compare_exposure(search.exposure, frame, image_from_frame, search.gain)
    pixels, small_from_frame = shrink_frame(frame, factor, search.gain)
    matrix = small_from_image @ image_from_frame @ np.linalg.inv(small_from_frame)
    search.stack.append(warp(pixels, matrix, small))
    search.seen.append(footprint(pixels.shape, matrix, small).view(bool))
    search.traffic = None
    if search.tolerance > 0 and _is_time_to_check(len(search.stack), 1):
        search.traffic = find_traffic(*_pack(search.stack, search.seen))
        blocks = _shrink_to_blocks(search.traffic.background.astype(np.float32), factor)
        search.change, search.blocks = _change(search.blocks, blocks), blocks


def average_ground(frames: Iterable[Registered], search: TrafficSearch) -> Background:
    """Mean of what a search did not find to be traffic; the search's small frames are dropped.

    Args:
        frames: those of the search, in the same order, each with its image_from_frame.
        search: as filled by `add_to_search`.

    Raises:
        BackgroundError: fewer than 4 frames.
    """
    if len(search.stack) < FEWEST:
        raise BackgroundError(
            f"{len(search.stack)} registered frames; at least {FEWEST} are needed to tell traffic "
            "from ground: register more frames, give detections, or average the frames as they are"
        )
    traffic = search.traffic or find_traffic(*_pack(search.stack, search.seen))
    search.stack.clear()
    search.seen.clear()
    mean = start_mean(search.size)
    # the masks first: when they run out, no further frame is read
    for moving, (frame, image_from_frame) in zip(traffic.moving, frames, strict=False):
        _add_masked(mean, frame, image_from_frame, enlarge(~moving, search.size))
    ground = finish_mean(mean)
    disputed = enlarge(traffic.contested, search.size).view(bool) & (ground.coverage > 0)
    return replace(ground, contested=ground.contested | disputed, change=search.change)


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
