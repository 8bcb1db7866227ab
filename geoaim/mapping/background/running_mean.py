"""Running mean of registered frames, plane by plane.

Frames of video are summed as Y, U and V planes, so that only the mean is converted to RGB.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16
from numpy import ndarray as Array

from geoaim.base.errors import BackgroundError
from geoaim.base.geometry import transform_boxes, translation
from geoaim.mapping.background.exposure import (
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
    gains: Float[Array, "frames_used"]  # factors that bring each frame to the exposure of the first


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
        mean.add(frame, image_from_frame)
    return mean.finish()


class RunningMean:
    """The mean of the frames that are added, in memory that does not grow with their number."""

    def __init__(
        self, size: tuple[int, int], detections: Detections | None = None, bands: int = 1
    ) -> None:
        self.size, self.detections, self.bands = size, detections, bands
        self._exposure = start_exposure(size)
        self._sums: tuple[_PlaneSums, ...] = ()  # of the image's planes
        self._gains: list[float] = []
        self._frame: Frame | None = None  # the last one

    def add(
        self,
        frame: Frame,
        image_from_frame: Float[Array, "3 3"],
        mask: UInt8[Array, "H W"] | None = None,
    ) -> None:
        """Add a registered frame; with detections, one without an entry in them is skipped.

        Args:
            frame: the frame.
            image_from_frame: (3, 3) its registration.
            mask: (H, W) pixels of the image, 0 where the frame is left out, beside the boxes of
                the detections.
        """
        if self.detections is not None:
            outside = draw_outside(self.detections, frame, image_from_frame, self.size)
            if outside is None:
                return
            mask = outside if mask is None else mask * outside
        self._sums = self._sums or _start_sums(frame, self.size)
        gain = estimate_gain(self._exposure, frame, image_from_frame)
        rows = _select_band(len(self._gains) % self.bands, self.bands, self.size[0])
        shift = translation(0, -rows.start)
        size = rows.stop - rows.start, self.size[1]
        footprint = draw_footprint(frame.grey.shape, shift @ image_from_frame, size)
        unmasked = footprint if mask is None else footprint * mask[rows]
        for plane, pixels in zip(self._sums, frame.planes or (frame.image,), strict=True):
            every = slice(None, None, plane.scale)
            part = slice(rows.start // plane.scale, -(-rows.stop // plane.scale))
            scale = np.diag([plane.scale, plane.scale, 1.0])
            matrix = np.linalg.inv(scale) @ shift @ image_from_frame @ scale
            warped = apply_gain(warp(pixels, matrix, plane.count[part].shape), gain, plane.neutral)
            plane.blur[:] += [*measure_warp_blur(matrix, plane.count[part].shape), 1.0]
            # uint16 counts no more frames
            shown = unmasked[every, every] * (plane.count[part] < 65_535)
            cv2.accumulate(warped, plane.total[part], shown)
            plane.count[part] += shown
            if mask is not None:
                masked = footprint[every, every] * (plane.count[part] == 0)
                cv2.accumulate(warped, plane.masked_total[part], masked)
                plane.masked_count[part] += masked
        self._gains.append(gain)
        self._frame = frame

    def finish(self) -> Background:
        """Compute the background, after which nothing can be added.

        Raises:
            BackgroundError: no frame was added.
        """
        if self._frame is None:
            raise BackgroundError(
                "there is no frame to average: none is registered, or none has detections; "
                "look at the registration's reasons and at the names of the box files"
            )
        first = self._sums[0]
        always_masked = (first.count == 0) & (first.masked_count > 0)
        for plane in self._sums:
            _replace_total_by_mean(plane)
        if self._frame.encoding is not None and len(self._sums) == 3:
            y, u, v = (plane.total[..., 0] for plane in self._sums)
            image = image_from_planes(y, u, v, self._frame.encoding)
        else:
            image = np.rint(first.total).clip(0, 255).astype(np.uint8)
        image[(first.count == 0) & (first.masked_count == 0)] = 0
        gains = np.array(self._gains)
        return Background(image, first.count, always_masked, len(gains), gains)


def draw_outside(
    detections: Detections,
    frame: Frame,
    image_from_frame: Float[Array, "3 3"],
    size: tuple[int, int],
) -> UInt8[Array, "H W"] | None:
    """Draw where a frame shows no vehicle: 0 in the boxes, grown by 12 %, else 1."""
    if (boxes := convert_boxes(detections(frame))) is None:
        return None
    grown = transform_boxes(image_from_frame, grow_boxes(boxes.boxes))
    return 1 - draw_polygons(grown, size)


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
