"""Frames of a video file, of a folder of images or of arrays: re-iterable, in constant memory."""

import glob
import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.errors import GeoaimWarning, GeoreferenceError, VideoError
from geoaim.mapping.video.decoding import open_clip, read_clip, seek_clip
from geoaim.mapping.video.frames import Colour, Frame, image_from_planes
from geoaim.mapping.video.telemetry import Telemetry, read_exif, read_srt

__all__ = ["Colour", "Frame", "Video", "image_from_planes", "open_video"]

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff"})
Pixels = UInt8[Array, "H W 3"] | UInt8[Array, "H W"]
TICK = 1e-6  # of a frame: 0.3 s at 10 frames a second is frame 2.999...


@dataclass(frozen=True, eq=False)
class Video:
    """Frames that can be read again and again: `for frame in video`. Made by `open_video`.

    Attributes:
        source: what was opened, for messages.
        height: of an upright frame, pixels.
        width: of an upright frame, pixels.
        rate: frames per second, on average.
        frame_count: number of frames that the source states; None when it does not.
        names: file names of images, None for other sources.
    """

    source: str
    height: int
    width: int
    rate: float
    frame_count: int | None
    names: tuple[str, ...] | None
    read_all: Callable[[], Iterator[Frame]]
    read_at: Callable[[Float[Array, " n"], float], Iterator[Frame]]
    read_telemetry: Callable[[], Telemetry | None]

    def __iter__(self) -> Iterator[Frame]:
        return self.read_all()

    @property
    def duration(self) -> float:
        """Seconds that the source states to last; NaN when it does not state it."""
        return math.nan if self.frame_count is None else self.frame_count / self.rate

    @cached_property
    def telemetry(self) -> Telemetry | None:
        """From the .SRT beside the video or the EXIF of the images; None where there is none."""
        try:
            return self.read_telemetry()
        except (GeoreferenceError, OSError) as error:
            message = f"{self.source}: its telemetry is left out: {error}"
            warnings.warn(GeoaimWarning(message), stacklevel=2)
            return None

    def frames_at(self, times: Iterable[float]) -> Iterator[Frame]:
        """The frames shown at these times (s), in order of time and each once."""
        wanted = np.unique(np.asarray(list(times), np.float64))
        if not np.isfinite(wanted).all():
            raise ValueError("times must be finite numbers of seconds")
        return self.read_at(wanted, 0.0)

    def sampled(self, count: int) -> Iterator[Frame]:
        """Up to `count` frames spread evenly over the whole, the first frame included.

        A keyframe within half a step of a wanted frame is taken in its place: it alone has to be
        decoded. Nothing between is read, so that a longer video costs no more.
        """
        if count < 1:
            raise ValueError(f"count must be at least 1, not {count}")
        total = self.frame_count if self.frame_count is not None else sum(1 for _ in self)
        if count >= total:
            return iter(self)
        last = (total - 1) / self.rate
        half_a_step = last / max(count - 1, 1) / 2
        return self.read_at(np.linspace(0.0, last, count), half_a_step)


def open_video(source: Any, *, rate: float = 1.0, threads: int | None = None) -> Video:
    """Open a video file, a folder or glob of images, a list of image paths, or arrays.

    Args:
        source: path of a video, of a folder of images (jpg, png, tif, in natural order) or of one
            image; a glob pattern; a sequence of image paths; a sequence or re-iterable of
            (H, W, 3) RGB or (H, W) grey uint8 arrays; or a Video, which is returned.
        rate: frames per second of images and arrays; 1 makes time the index.
            Video files carry their own timestamps.
        threads: decoding threads; by default the decoder chooses.

    Raises:
        VideoError: nothing there, or not one frame of it can be read.
        TypeError: a one-shot iterator, or something that is no source at all.

    >>> video = open_video(np.zeros((5, 4, 6, 3), np.uint8), rate=10)
    >>> [(frame.index, frame.time) for frame in video.sampled(3)]
    [(0, 0.0), (2, 0.2), (4, 0.4)]
    """
    if rate <= 0:
        raise ValueError(f"rate must be positive, not {rate}")
    if isinstance(source, Video):
        return source
    if isinstance(source, str | Path):
        paths = _image_paths(str(source))
        if paths is None:
            return _open_file(Path(source), threads)
        return _open_images(str(source), paths, rate)
    if not isinstance(source, Iterable):
        raise TypeError(f"a path or an iterable of images is needed, not {type(source).__name__}")
    if iter(source) is source:
        raise TypeError(
            "the frames come from a one-shot iterator, and are read more than once: "
            "give a list, or an object whose __iter__ starts anew"
        )
    if not isinstance(source, Sequence | Array):
        return _open_stream(source, rate)
    if len(source) and isinstance(source[0], str | Path):
        return _open_images(f"{len(source)} images", [Path(path) for path in source], rate)
    return _open_indexed(lambda index: source[index], len(source), rate)


def _open_file(path: Path, threads: int | None) -> Video:
    clip = open_clip(path, threads)
    height, width = clip.stored_size[::-1] if clip.turn.transpose else clip.stored_size
    return Video(
        source=str(path),
        height=height,
        width=width,
        rate=clip.rate,
        frame_count=clip.count or None,
        names=None,
        read_all=lambda: read_clip(clip),
        read_at=lambda times, slack: seek_clip(clip, times.tolist(), slack),
        read_telemetry=lambda: _sidecar(path),
    )


def _sidecar(path: Path) -> Telemetry | None:
    """Telemetry from the .SRT file beside a video."""
    beside = [path.with_suffix(suffix) for suffix in (".SRT", ".srt")]
    found = next((sidecar for sidecar in beside if sidecar.is_file()), None)
    return None if found is None else read_srt(found)


def _image_paths(source: str) -> list[Path] | None:
    """Images that a path or pattern names, in natural order; None when it names a video file."""
    path = Path(source)
    if path.is_dir():
        found = [entry for entry in path.iterdir() if _is_image(entry)]
    elif path.exists():
        return [path] if _is_image(path) else None
    elif any(sign in source for sign in "*?["):
        found = [Path(entry) for entry in glob.glob(source) if _is_image(Path(entry))]
    else:
        raise VideoError(f"{source}: there is no such file or folder")
    if not found:
        kinds = ", ".join(sorted(IMAGE_SUFFIXES))
        raise VideoError(f"{source}: no image found; {kinds} are read")
    return sorted(found, key=_natural_order)


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Key that puts frame_2 before frame_10."""
    parts = re.split(r"(\d+)", str(path).lower())
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _read_image(path: Path) -> UInt8[Array, "H W 3"]:
    """RGB with the EXIF orientation applied."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR) if path.is_file() else None
    if image is None:
        found = "not an image that can be read" if path.is_file() else "there is no such file"
        raise VideoError(f"{path}: {found}; leave it out, or repair it")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB, dst=image)


def _open_images(source: str, paths: list[Path], rate: float) -> Video:
    names = tuple(path.name for path in paths)
    video = _open_indexed(lambda index: _read_image(paths[index]), len(paths), rate, names)
    return replace(video, source=source, read_telemetry=lambda: read_exif(paths, rate=rate))


def _open_indexed(
    load: Callable[[int], Any], count: int, rate: float, names: tuple[str, ...] | None = None
) -> Video:
    """Frames that can be had one by one: images, and sequences of arrays."""
    if not count:
        raise VideoError("there are no frames: the sequence is empty")
    labels = names or [f"frame {index}" for index in range(count)]
    height, width = _checked(load(0), labels[0]).shape[:2]

    def read(indices: Iterable[int]) -> Iterator[Frame]:
        for index in indices:
            pixels = _checked(load(index), labels[index], (height, width))
            yield Frame(index, index / rate, names[index] if names else None, pixels)

    return Video(
        source="arrays",
        height=height,
        width=width,
        rate=rate,
        frame_count=count,
        names=names,
        read_all=lambda: read(range(count)),
        read_at=lambda times, _: read(_indices(times, rate, count)),
        read_telemetry=lambda: None,
    )


def _open_stream(arrays: Iterable[Any], rate: float) -> Video:
    """Frames that can only be had from the first on, each time anew."""
    first = next(iter(arrays), None)
    if first is None:
        raise VideoError("there are no frames: the iterable is empty")
    height, width = _checked(first, "frame 0").shape[:2]

    def read() -> Iterator[Frame]:
        for index, array in enumerate(arrays):
            pixels = _checked(array, f"frame {index}", (height, width))
            yield Frame(index, index / rate, None, pixels)

    def read_at(times: Float[Array, " n"], _: float) -> Iterator[Frame]:
        wanted = set(_indices(times, rate, sum(1 for _ in arrays)))
        return (frame for frame in read() if frame.index in wanted)

    return Video(
        source="arrays",
        height=height,
        width=width,
        rate=rate,
        frame_count=None,
        names=None,
        read_all=read,
        read_at=read_at,
        read_telemetry=lambda: None,
    )


def _indices(times: Float[Array, " n"], rate: float, count: int) -> list[int]:
    """Indices of the frames shown at the times, each once."""
    shown = np.floor(times * rate + TICK).clip(0, count - 1).astype(np.int64)
    return [int(index) for index in np.unique(shown)]


def _checked(array: Any, where: str, size: tuple[int, int] | None = None) -> Pixels:
    pixels = np.asarray(array)
    colour = pixels.ndim == 3 and pixels.shape[2] == 3
    if pixels.dtype != np.uint8 or not (pixels.ndim == 2 or colour):
        raise TypeError(
            f"{where}: uint8 of shape (H, W, 3) or (H, W) needed, not {pixels.dtype} {pixels.shape}"
        )
    if size is not None and pixels.shape[:2] != size:
        raise VideoError(
            f"{where}: {pixels.shape[0]} x {pixels.shape[1]} pixels (height x width), but the "
            f"first frame has {size[0]} x {size[1]}; all must have one size"
        )
    return pixels
