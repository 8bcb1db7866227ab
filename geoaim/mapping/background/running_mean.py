"""Running mean of registered frames, and whether it has converged."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.errors import BackgroundError
from geoaim.geometry import transform_boxes
from geoaim.mapping.background.accumulate import PlaneSums, add_frame, compute_mean, start_sums
from geoaim.mapping.background.background import Background
from geoaim.mapping.background.exposure import Exposure, estimate_gain, start_exposure
from geoaim.mapping.background.warping import fill_polygons
from geoaim.mapping.video.detections import Detections, grow_boxes
from geoaim.mapping.video.frames import Frame

BLOCK_PX = 8  # change is measured on means of such blocks, which average noise but keep vehicles
FIRST_CHECK_FRAMES = 16  # frames before change is first measured
CHANGE_QUANTILE = 0.999  # of the blocks


@dataclass(eq=False)
class RunningMean:
    """A mean of the frames that `add_to_mean` has added so far, in place.

    Attributes:
        size: (height, width) of the image, pixels.
        detections: what to leave out of each frame, or None.
        tolerance: `change` at which the mean has converged, grey levels; 0 takes all frames.
        bands: horizontal bands of the image that the frames fill in turn.
        exposure: of the frames so far.
        sums: of the image's planes; none before the first frame.
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
    sums: tuple[PlaneSums, ...] = ()
    gains: list[float] = field(default_factory=list)
    blocks: Float32[Array, "h w c"] | None = None
    change: float = np.nan
    frame: Frame | None = None

    @property
    def converged(self) -> bool:
        """Whether further frames would hardly change the image."""
        return self.tolerance > 0 and self.change <= self.tolerance


def start_mean(
    size: tuple[int, int],
    *,
    detections: Detections | None = None,
    tolerance: float = 0.0,
    bands: int = 1,
) -> RunningMean:
    """Start a mean without frames.

    Args:
        size: (height, width) of the image, pixels.
        detections: as in `average_frames`, like the others.
        tolerance: grey levels of change at which the mean has converged.
        bands: that the image is divided into.

    Returns:
        The mean, to be filled by `add_to_mean`.
    """
    return RunningMean(size, detections, tolerance, bands, start_exposure(size))


def add_to_mean(mean: RunningMean, frame: Frame, image_from_frame: Float[Array, "3 3"]) -> None:
    """Add a registered frame to a mean, in place; a frame without known detections is skipped.

    Args:
        mean: the mean.
        frame: the frame.
        image_from_frame: (3, 3) its registration.
    """
    if mean.detections is None:
        add_masked(mean, frame, image_from_frame, None)
    elif (boxes := mean.detections(frame)) is not None:
        polygons = transform_boxes(image_from_frame, grow_boxes(boxes))
        mask = fill_polygons(np.ones(mean.size, np.uint8), polygons, 0)
        add_masked(mean, frame, image_from_frame, mask)


def add_masked(
    mean: RunningMean,
    frame: Frame,
    image_from_frame: Float[Array, "3 3"],
    mask: UInt8[Array, "H W"] | None,
) -> None:
    """Add a registered frame to a mean where its mask is not 0, in place.

    Args:
        mean: the mean.
        frame: the frame.
        image_from_frame: (3, 3) its registration.
        mask: (H, W) of the image; None masks nothing.
    """
    gains, bands = mean.gains, mean.bands
    mean.sums = mean.sums or start_sums(frame, mean.size)
    gain = estimate_gain(mean.exposure, frame, image_from_frame, gains[-1] if gains else 1.0)
    rows = _select_band(len(gains) % bands, bands, mean.size[0])
    add_frame(mean.sums, frame, image_from_frame, mask, gain, rows)
    gains.append(gain)
    mean.frame = frame
    if is_time_to_check(len(gains), bands):
        blocks = _average_sums(mean.sums[0])
        mean.change, mean.blocks = measure_change(mean.blocks, blocks), blocks


def finish_mean(mean: RunningMean) -> Background:
    """Compute the image of a mean; its sums are overwritten.

    Raises:
        BackgroundError: no frame was added.
    """
    if mean.frame is None:
        raise BackgroundError(
            "there is no frame to average: none is registered, or no detections are known of any; "
            "look at the registration's reasons and at the names of the box files"
        )
    image = compute_mean(mean.sums, mean.frame)
    first = mean.sums[0]
    always_masked = (first.count == 0) & (first.masked_count > 0)
    gains = np.array(mean.gains)
    return Background(image, first.count, always_masked, len(gains), mean.change, gains)


def is_time_to_check(count: int, bands: int) -> bool:
    """Whether change is measured after this number of frames: at 16, 32, 64 ..."""
    return count >= FIRST_CHECK_FRAMES * bands and count.bit_count() == 1


def measure_change(before: Float32[Array, "h w c"] | None, after: Float32[Array, "h w c"]) -> float:
    """Measure the change of block means as a high quantile; NaN without any common block."""
    if before is None:
        return np.nan
    change = np.abs(after - before)
    known = change[np.isfinite(change)]
    return float(np.quantile(known, CHANGE_QUANTILE)) if len(known) else np.nan


def average_blocks(pixels: Float32[Array, "H W *c"], reduction: int) -> Float32[Array, "h w c"]:
    """Average blocks of 8 x 8 pixels of the image, whose size is `reduction` times the pixels'."""
    size = [max(extent * reduction // BLOCK_PX, 1) for extent in pixels.shape[1::-1]]
    blocks = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.float32)
    return blocks.reshape(size[1], size[0], -1)


def _average_sums(plane: PlaneSums) -> Float32[Array, "h w c"]:
    """Means of blocks, NaN where no frame has shown one."""
    total = average_blocks(plane.total, 1)
    count = average_blocks(plane.count.astype(np.float32), 1)
    return np.where(count > 0, total / np.maximum(count, 1e-6), np.float32(np.nan))


def _select_band(number: int, bands: int, height: int) -> slice:
    """Rows of a band; it begins on an even row, where a row of chroma does."""
    first, last = (2 * (height * i // (2 * bands)) for i in (number, number + 1))
    return slice(first, height if number == bands - 1 else last)
