"""Running mean of registered frames, plane by plane, and whether it has converged.

Frames of video are summed as Y, U and V planes, so that only the mean is converted to RGB.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16
from numpy import ndarray as Array

from geoaim.base.errors import BackgroundError
from geoaim.base.geometry import transform_boxes, translation
from geoaim.mapping.background.exposure import (
    Exposure,
    apply_gain,
    black_level,
    estimate_gain,
    start_exposure,
)
from geoaim.mapping.background.warping import (
    draw_footprint,
    draw_polygons,
    measure_warp_blur,
    sharpen_mean,
    warp,
)
from geoaim.mapping.video.detections import Detections, convert_boxes, grow_boxes
from geoaim.mapping.video.frames import Frame, image_from_planes

MAX_COUNT = 65_535  # frames that a pixel of uint16 can count
BLOCK_PX = 8  # change is measured on means of such blocks, which average noise but keep vehicles
FIRST_CHECK_FRAMES = 16  # frames before change is first measured
CHANGE_QUANTILE = 0.999  # quantile over the blocks

Registered = tuple[Frame, Float[Array, "3 3"]]  # a frame and its image_from_frame


@dataclass(frozen=True, eq=False)
class Background:
    """An image of the ground, with the number of frames behind each pixel."""

    image: UInt8[Array, "H W 3"]  # RGB at the first frame's exposure; 0 where no frame reaches
    # number of frames averaged at each pixel; 0 where none shows the ground
    coverage: UInt16[Array, "H W"]
    # the ground is in doubt: masked in every frame (the image then shows the mean with traffic, and
    # coverage is 0), or two lasting states were seen
    contested: Bool[Array, "H W"]
    frames_used: int  # frames that were read and averaged
    # grey levels by which the latter half of the frames changed the image: the 99.9 % quantile over
    # blocks of 8 x 8 pixels. NaN where it was not measured
    change: float
    gains: Float[Array, "frames_used"]  # factors that bring each frame to the exposure of the first


@dataclass(eq=False)
class Accumulation:
    """What frames have added up to so far, and whether further ones would hardly change it."""

    size: tuple[int, int]  # (height, width) of the image, pixels
    tolerance: float = 0.0  # `change` at which it has converged, grey levels; 0 takes all frames
    exposure: Exposure = field(init=False)  # exposure of the frames so far
    # means of blocks when `change` was last measured
    blocks: Float32[Array, "h w c"] | None = field(init=False, default=None)
    # change of the background, as in `Background`
    change: float = field(init=False, default=np.nan)

    def __post_init__(self) -> None:
        self.exposure = start_exposure(self.size)

    @property
    def converged(self) -> bool:
        """Whether further frames would hardly change the image."""
        return self.tolerance > 0 and self.change <= self.tolerance


@dataclass(eq=False)
class RunningMean(Accumulation):
    """A mean of the frames that `add_to_mean` has added so far, in place."""

    detections: Detections | None = None  # what to leave out of each frame, or None
    bands: int = 1  # horizontal bands of the image that the frames fill in turn
    # sums over the frames for each of the image's planes; none before the first frame
    sums: tuple["_PlaneSums", ...] = field(init=False, default=())
    # factors that bring each frame to the exposure of the first
    gains: list[float] = field(init=False, default_factory=list)
    frame: Frame | None = field(init=False, default=None)  # the last one added


@dataclass(frozen=True, eq=False)
class _PlaneSums:
    """Sums over a plane of the image, filled in place; masked pixels count where no others do."""

    scale: int  # size of the image divided by the plane's: 2 for the chroma of a video, else 1
    neutral: float  # the value that a change of exposure leaves as it is
    total: Float32[Array, "h w c"]
    count: UInt16[Array, "h w"]
    masked_total: Float32[Array, "h w c"]
    masked_count: UInt16[Array, "h w"]
    blur: Float[Array, "3"]  # sums of the warps' blur along x and y, and their number


def average_frames(
    frames: Iterable[Registered],
    *,
    size: tuple[int, int],
    detections: Detections | None = None,
    bands: int = 1,
) -> Background:
    """Average registered frames, without the boxes of detections where these are given.

    The memory does not grow with the number of frames.

    Args:
        frames: each with its image_from_frame (3, 3), read once.
        size: (height, width) of the image, pixels.
        detections: gives the boxes to leave out of a frame, grown by 12 %. A frame for which it
            gives None is left out as a whole.
        bands: number of horizontal bands of the image. Each frame is warped to the next one only,
            so that a pixel is the mean of every `bands`-th frame that shows it.

    Returns:
        The background.

    Raises:
        BackgroundError: there is no frame, or none with detections.
    """
    mean = RunningMean(size, detections=detections, bands=bands)
    for frame, image_from_frame in frames:
        add_to_mean(mean, frame, image_from_frame)
    return finish_mean(mean)


def add_to_mean(
    mean: RunningMean,
    frame: Frame,
    image_from_frame: Float[Array, "3 3"],
    mask: UInt8[Array, "H W"] | None = None,
) -> None:
    """Add a registered frame to a mean, in place.

    Args:
        mean: the mean; if it has detections, a frame without an entry in them is skipped.
        frame: the frame.
        image_from_frame: (3, 3) its registration.
        mask: (H, W) pixels of the image, 0 where the frame is left out, beside the boxes of the
            detections.
    """
    if mean.detections is not None:
        outside = draw_outside(mean.detections, frame, image_from_frame, mean.size)
        if outside is None:
            return
        mask = outside if mask is None else mask * outside
    mean.sums = mean.sums or _start_sums(frame, mean.size)
    gain = estimate_gain(mean.exposure, frame, image_from_frame)
    rows = _select_band(len(mean.gains) % mean.bands, mean.bands, mean.size[0])
    shift = translation(0, -rows.start)
    size = rows.stop - rows.start, mean.size[1]
    footprint = draw_footprint(frame.grey.shape, shift @ image_from_frame, size)
    unmasked = footprint if mask is None else footprint * mask[rows]
    for plane, pixels in zip(mean.sums, frame.planes or (frame.image,), strict=True):
        every = slice(None, None, plane.scale)
        part = slice(rows.start // plane.scale, -(-rows.stop // plane.scale))
        scale = np.diag([plane.scale, plane.scale, 1.0])
        matrix = np.linalg.inv(scale) @ shift @ image_from_frame @ scale
        warped = apply_gain(warp(pixels, matrix, plane.count[part].shape), gain, plane.neutral)
        plane.blur[:] += [*measure_warp_blur(matrix, plane.count[part].shape), 1.0]
        shown = unmasked[every, every] * (plane.count[part] < MAX_COUNT)
        cv2.accumulate(warped, plane.total[part], shown)
        plane.count[part] += shown
        if mask is not None:
            masked = footprint[every, every] * (plane.count[part] == 0)
            cv2.accumulate(warped, plane.masked_total[part], masked)
            plane.masked_count[part] += masked
    mean.gains.append(gain)
    mean.frame = frame
    if is_time_to_check(len(mean.gains), mean.bands):
        luma = mean.sums[0]
        total, count = average_blocks(luma.total), average_blocks(luma.count.astype(np.float32))
        means = np.where(count > 0, total / np.maximum(count, 1e-6), np.float32(np.nan))
        measure_change(mean, means)


def draw_outside(
    detections: Detections,
    frame: Frame,
    image_from_frame: Float[Array, "3 3"],
    size: tuple[int, int],
) -> UInt8[Array, "H W"] | None:
    """Draw where a frame shows no vehicle: 0 in the boxes, grown by 12 %, else 1.

    Args:
        detections: the boxes.
        frame: the frame.
        image_from_frame: (3, 3) its registration.
        size: (height, width) of the image, pixels.

    Returns:
        (H, W), or None where nothing is known of the frame.
    """
    if (boxes := convert_boxes(detections(frame))) is None:
        return None
    grown = transform_boxes(image_from_frame, grow_boxes(boxes.boxes))
    return 1 - draw_polygons(grown, size)


def finish_mean(mean: RunningMean) -> Background:
    """Compute the background from a running mean; the mean cannot be used afterwards.

    Raises:
        BackgroundError: no frame was added.
    """
    if mean.frame is None:
        raise BackgroundError(
            "there is no frame to average: none is registered, or none has detections; "
            "look at the registration's reasons and at the names of the box files"
        )
    first = mean.sums[0]
    always_masked = (first.count == 0) & (first.masked_count > 0)
    for plane in mean.sums:
        _replace_total_by_mean(plane)
    if mean.frame.encoding is not None and len(mean.sums) == 3:
        y, u, v = (plane.total[..., 0] for plane in mean.sums)
        image = image_from_planes(y, u, v, mean.frame.encoding)
    else:
        image = np.rint(first.total).clip(0, 255).astype(np.uint8)
    image[(first.count == 0) & (first.masked_count == 0)] = 0
    gains = np.array(mean.gains)
    return Background(image, first.count, always_masked, len(gains), mean.change, gains)


def is_time_to_check(count: int, bands: int = 1) -> bool:
    """Tell whether change is measured after this number of frames: 16, 32, 64, ...

    With several bands, the first is the smallest power of two from 16 times their number on.
    """
    return count >= FIRST_CHECK_FRAMES * bands and count.bit_count() == 1


def measure_change(accumulation: Accumulation, blocks: Float32[Array, "h w c"]) -> None:
    """Set `change`: by how much block means differ from those at the last call, 99.9 % quantile.

    Blocks without data (NaN) at either call are left out; if none is left, the change is NaN.
    """
    if accumulation.blocks is not None:
        change = np.abs(blocks - accumulation.blocks)
        known = change[np.isfinite(change)]
        quantile = float(np.quantile(known, CHANGE_QUANTILE)) if len(known) else np.nan
        accumulation.change = quantile
    accumulation.blocks = blocks


def average_blocks(pixels: Float32[Array, "H W *c"], reduction: int = 1) -> Float32[Array, "h w c"]:
    """Average blocks of 8 x 8 pixels of an image; `pixels` is it, shrunk by `reduction`."""
    size = [max(extent * reduction // BLOCK_PX, 1) for extent in pixels.shape[1::-1]]
    blocks = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.float32)
    return blocks.reshape(size[1], size[0], -1)


def _start_sums(frame: Frame, size: tuple[int, int]) -> tuple[_PlaneSums, ...]:
    """Empty sums for the Y, U and V planes of a video, or for RGB."""
    kinds = [(1, 0.0, 3)]
    if frame.planes is not None:
        kinds = [(1, black_level(frame), 1), (2, 128.0, 1), (2, 128.0, 1)]
    sums = []
    for scale, neutral, channels in kinds:
        shape = (-(-size[0] // scale), -(-size[1] // scale))
        total, masked_total = np.zeros((2, *shape, channels), np.float32)
        count, masked_count = np.zeros((2, *shape), np.uint16)
        arrays = total, count, masked_total, masked_count, np.zeros(3)
        sums.append(_PlaneSums(scale, neutral, *arrays))
    return tuple(sums)


def _select_band(number: int, bands: int, height: int) -> slice:
    """Rows of a band; it begins on an even row, where a row of chroma does."""
    first, last = (2 * (height * i // (2 * bands)) for i in (number, number + 1))
    return slice(first, height if number == bands - 1 else last)


def _replace_total_by_mean(plane: _PlaneSums) -> None:
    """Overwrite the total by the sharpened mean, and by the neutral value where there is none."""
    always_masked = plane.count == 0
    np.copyto(plane.total, plane.masked_total, where=always_masked[..., None])
    count = np.where(always_masked, plane.masked_count, plane.count)
    divisor = np.maximum(count, 1)[..., None]
    np.divide(plane.total, divisor, out=plane.total, casting="same_kind")
    empty = count == 0
    plane.total[empty] = plane.neutral
    sharp = sharpen_mean(plane.total, plane.blur[:2] / plane.blur[2])
    if empty.any():  # sharpening would mix in the neutral value of empty neighbours
        rim = cv2.dilate(empty.view(np.uint8), np.ones((5, 5), np.uint8)).view(bool)
        sharp[rim] = plane.total[rim]
    plane.total[:] = sharp
