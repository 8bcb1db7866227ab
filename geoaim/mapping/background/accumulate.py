"""Accumulate registered frames: sums and counts for each pixel, plane by plane.

Frames of video are summed as Y, U and V planes, so that only the mean is converted to RGB.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8, UInt16
from numpy import ndarray as Array

from geoaim.geometry import translation
from geoaim.mapping.background.exposure import apply_gain, black_level
from geoaim.mapping.background.warping import (
    draw_footprint,
    measure_warp_blur,
    sharpen_mean,
    warp,
)
from geoaim.mapping.video.frames import Frame, image_from_planes

MAX_COUNT = 65_535  # frames that a pixel of uint16 can count


@dataclass(frozen=True, eq=False)
class PlaneSums:
    """Sums over one plane of the image, at 1/scale of its size; filled in place.

    Attributes:
        scale: 2 for the chroma of a video, else 1.
        neutral: the value that a change of exposure leaves as it is.
        total: (h, w, c) sums of the pixels that are not masked.
        count: (h, w) number of frames in them.
        masked_total: (h, w, c) sums of masked pixels, until a frame shows them unmasked.
        masked_count: (h, w) number of frames in these.
        blur: sums over the frames of their warps' blur along x and y, and their number.
    """

    scale: int
    neutral: float
    total: Float32[Array, "h w c"]
    count: UInt16[Array, "h w"]
    masked_total: Float32[Array, "h w c"]
    masked_count: UInt16[Array, "h w"]
    blur: Float[Array, "3"]


def start_sums(frame: Frame, size: tuple[int, int]) -> tuple[PlaneSums, ...]:
    """Make empty sums for the Y, U and V planes of a video, or for RGB.

    Args:
        frame: any of the frames, for the kind of its planes.
        size: (height, width) of the image.
    """
    kinds = [(1, 0.0, 3)]
    if frame.planes is not None:
        kinds = [(1, black_level(frame), 1), (2, 128.0, 1), (2, 128.0, 1)]
    sums = []
    for scale, neutral, channels in kinds:
        shape = (-(-size[0] // scale), -(-size[1] // scale))
        totals = [np.zeros((*shape, channels), np.float32) for _ in range(2)]
        counts = [np.zeros(shape, np.uint16) for _ in range(2)]
        arrays = totals[0], counts[0], totals[1], counts[1]
        sums.append(PlaneSums(scale, neutral, *arrays, np.zeros(3)))
    return tuple(sums)


def add_frame(
    sums: tuple[PlaneSums, ...],
    frame: Frame,
    image_from_frame: Float[Array, "3 3"],
    mask: UInt8[Array, "H W"] | None,
    gain: float,
    rows: slice,
) -> None:
    """Warp a frame to some rows of the image and add it to the sums, in place.

    Args:
        sums: of each plane.
        frame: the frame.
        image_from_frame: (3, 3) its registration.
        mask: (H, W) of the image, 0 where the frame shows traffic; None where nothing is masked.
        gain: factor that brings the frame to the exposure of the first.
        rows: of the image; the first is even.
    """
    shift = translation(0, -rows.start)
    size = rows.stop - rows.start, sums[0].count.shape[1]
    footprint = draw_footprint(frame.grey.shape, shift @ image_from_frame, size)
    for plane, pixels in zip(sums, frame.planes or (frame.image,), strict=True):
        every = slice(None, None, plane.scale)
        part = slice(rows.start // plane.scale, -(-rows.stop // plane.scale))
        scale = np.diag([plane.scale, plane.scale, 1.0])
        matrix = np.linalg.inv(scale) @ shift @ image_from_frame @ scale
        warped = warp(pixels, matrix, plane.count[part].shape)
        warped = apply_gain(warped, gain, plane.neutral)
        plane.blur[:] += [*measure_warp_blur(matrix, plane.count[part].shape), 1.0]
        shown = footprint[every, every].copy()
        unmasked = shown if mask is None else shown * mask[rows][every, every]
        unmasked = unmasked * (plane.count[part] < MAX_COUNT)
        cv2.accumulate(warped, plane.total[part], unmasked)
        plane.count[part] += unmasked
        if mask is not None:
            masked = shown * (plane.count[part] == 0)
            cv2.accumulate(warped, plane.masked_total[part], masked)
            plane.masked_count[part] += masked


def compute_mean(sums: tuple[PlaneSums, ...], frame: Frame) -> UInt8[Array, "H W 3"]:
    """Compute the mean as RGB, of the masked pixels where there are no others.

    Args:
        sums: as filled by `add_frame`; they are overwritten.
        frame: any of the frames, for the encoding of its planes.

    Returns:
        (H, W, 3) the mean; 0 where no frame reaches.
    """
    for plane in sums:
        _replace_total_by_mean(plane)
    if frame.encoding is not None and len(sums) == 3:
        y, u, v = (plane.total[..., 0] for plane in sums)
        image = image_from_planes(y, u, v, frame.encoding)
    else:
        image = np.rint(sums[0].total).clip(0, 255).astype(np.uint8)
    image[(sums[0].count == 0) & (sums[0].masked_count == 0)] = 0
    return image


def _replace_total_by_mean(plane: PlaneSums) -> None:
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
