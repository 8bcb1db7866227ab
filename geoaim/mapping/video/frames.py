"""One frame of a video: its time, and its pixels as grey, RGB or raw YUV planes."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8
from numpy import ndarray as Array

# Pixel formats whose first plane is 8-bit luma, so that grey images need no copy.
LUMA_FIRST = frozenset(
    {"yuv420p", "yuvj420p", "yuv422p", "yuvj422p", "yuv444p", "yuvj444p", "nv12", "nv21", "gray"}
)
# Weights of red and blue in luma by AVColorSpace (ITU-T H.273, table 4); anything else is BT.601,
# as FFmpeg itself takes untagged video to be.
LUMA_WEIGHTS = {1: (0.2126, 0.0722), 4: (0.30, 0.11), 7: (0.212, 0.087), 9: (0.2627, 0.0593)}


class YuvEncoding(NamedTuple):
    """How YUV encodes RGB: weights of red and blue in luma, and whether luma spans 0 to 255."""

    red: float
    blue: float
    full_range: bool


@dataclass(frozen=True, eq=False)
class Frame:
    """One decoded frame. `grey` and `image` are computed on first access and cached."""

    index: int  # number in presentation order, from 0
    time: float  # seconds since the first frame, from presentation timestamps
    name: str | None  # file name of an image, None for a frame of a video
    decoded: Any  # the frame of PyAV, or the array, that holds the pixels
    quarter_turns: int = 0  # counter-clockwise, that turn the pixels upright

    @cached_property
    def grey(self) -> UInt8[Array, "H W"]:
        """Luma as stored: 16 to 235 where the video has limited range, 0 to 255 otherwise.

        Upright 8-bit YUV gives a read-only view of the decoder's memory; others are converted.
        """
        if isinstance(self.decoded, Array):
            is_grey = self.decoded.ndim == 2
            return self.decoded if is_grey else cv2.cvtColor(self.decoded, cv2.COLOR_RGB2GRAY)
        as_stored = self.decoded.format.name in LUMA_FIRST
        luma = self.decoded if as_stored else self.decoded.reformat(format="yuv420p")
        return _turn(_view_plane(luma, 0), self.quarter_turns)

    @cached_property
    def image(self) -> UInt8[Array, "H W 3"]:
        """RGB, converted with the matrix and range that the video states (untagged: BT.601)."""
        if isinstance(self.decoded, Array):
            is_grey = self.decoded.ndim == 2
            return cv2.cvtColor(self.decoded, cv2.COLOR_GRAY2RGB) if is_grey else self.decoded
        return _turn(self.decoded.to_ndarray(format="rgb24"), self.quarter_turns)

    @property
    def planes(self) -> tuple[UInt8[Array, "H W"], UInt8[Array, "h w"], UInt8[Array, "h w"]] | None:
        """Raw (Y, U, V), read-only, of an upright 8-bit 4:2:0 video; None for any other source.

        `image_from_planes(y, u, v, frame.encoding)` converts them, or means of them, to RGB.
        """
        if isinstance(self.decoded, Array) or self.quarter_turns:
            return None
        if self.decoded.format.name not in ("yuv420p", "yuvj420p"):
            return None
        y, u, v = (_view_plane(self.decoded, plane) for plane in range(3))
        return y, u, v

    @property
    def encoding(self) -> YuvEncoding | None:
        """How the planes of a video file's frame encode RGB; None for images and arrays."""
        if isinstance(self.decoded, Array):
            return None
        # 2 is AVCOL_RANGE_JPEG
        full = self.decoded.color_range == 2 or "yuvj" in self.decoded.format.name
        weights = LUMA_WEIGHTS.get(int(self.decoded.colorspace), (0.299, 0.114))  # BT.601
        return YuvEncoding(*weights, full)


@dataclass(frozen=True, eq=False)
class FrameList:
    """What tells which frame of a video something belongs to."""

    source: str  # name of the video, for messages
    size: tuple[int, int]  # (width, height), pixels
    rate: float  # frames per second, on average
    names: tuple[str, ...] | None  # file names of images; None: a video has none
    times: Float[Array, " N"] | None  # of all frames, s; None: only reading tells their number

    @property
    def count(self) -> int | None:
        """Number of frames."""
        return None if self.times is None else len(self.times)


def image_from_planes(
    y: Shaped[Array, "H W"], u: Shaped[Array, "h w"], v: Shaped[Array, "h w"], encoding: YuvEncoding
) -> UInt8[Array, "H W 3"]:
    """Convert Y, U, V planes to RGB (ITU-T H.273, 8.3).

    Chroma is repeated, not interpolated, as by FFmpeg in `Frame.image`. FFmpeg rounds down, so that
    its images are darker by about one grey level.

    >>> half = np.full((1, 1), 128.0)
    >>> image_from_planes(np.full((2, 2), 235.0), half, half, YuvEncoding(0.3, 0.1, False))[0, 0]
    array([255, 255, 255], dtype=uint8)
    """
    height, width = y.shape
    offset, luma, chroma = (0.0, 1.0, 1.0) if encoding.full_range else (16.0, 255 / 219, 255 / 224)
    grey = (y.astype(np.float32) - offset) * luma
    blue_difference, red_difference = (
        ((plane.astype(np.float32) - 128) * chroma).repeat(2, 0).repeat(2, 1)[:height, :width]
        for plane in (u, v)
    )
    image = np.empty((height, width, 3), np.uint8)
    red = grey + 2 * (1 - encoding.red) * red_difference
    blue = grey + 2 * (1 - encoding.blue) * blue_difference
    green = (grey - encoding.red * red - encoding.blue * blue) / (1 - encoding.red - encoding.blue)
    for channel, values in enumerate((red, green, blue)):
        image[..., channel] = np.clip(np.rint(values), 0, 255)
    return image


def _turn(pixels: UInt8[Array, "H W *C"], quarter_turns: int) -> UInt8[Array, "h w *C"]:
    """Turn counter-clockwise; 0 quarter turns give the pixels themselves, not a copy."""
    return np.ascontiguousarray(np.rot90(pixels, quarter_turns)) if quarter_turns else pixels


def _view_plane(frame: Any, index: int) -> UInt8[Array, "H W"]:
    """Read-only view of a plane of 8-bit samples, without its padding."""
    plane = frame.planes[index]
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    view = rows[: plane.height, : plane.width]
    view.flags.writeable = False
    return view
