"""Open a video file, images or arrays as a `Video`: frames that can be read again and again."""

import glob
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, dropwhile, takewhile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import GeoreferenceError, VideoError, warn
from geoaim.base.limits import check_memory, refuse_damaged
from geoaim.base.raster_files import open_raster_file
from geoaim.mapping.video.decoding import VideoFile, open_video_file, read_frames, read_frames_at
from geoaim.mapping.video.exif import read_exif
from geoaim.mapping.video.flight_log import is_flight_log, read_flight_log
from geoaim.mapping.video.frames import Frame, FrameList
from geoaim.mapping.video.srt import read_srt
from geoaim.mapping.video.subtitles import read_subtitles
from geoaim.mapping.video.telemetry import SLOW_MOTION, Telemetry, join_telemetry

BYTES_PER_PIXEL = 16  # memory for a pixel while an image is decoded
IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff"})
VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mpg", ".ts"})
Pixels = UInt8[Array, "H W 3"] | UInt8[Array, "H W"]
# seconds of a video to which it is cut, as of a media fragment (W3C): flight.mp4#t=8.5,24
PART = re.compile(r"#t=(\d+\.?\d*),(\d+\.?\d*)$")
INDEX_TOLERANCE = 1e-6  # frames: in floats, 0.3 s at 10 frames a second is frame 2.999...


@dataclass(frozen=True, eq=False)
class Video:
    """Frames that can be read repeatedly, in constant memory, by `for frame in video`.

    Made by `open_video`.

    Attributes:
        source: name of what was opened, for messages.
        height: height of an upright frame, pixels.
        width: width of an upright frame, pixels.
        rate: frames per second, on average.
        frame_count: number of frames that the source states; None when it states none.
        read_all: reads every frame in order.
        read_at: reads the frames at times (s, ascending), or keyframes within some seconds of them.
        read_telemetry: reads the state of the camera over time; None where there is none.
        names: file names of images, None for other sources.
        keyframe_interval: seconds between keyframes, which are decoded alone; 0 where every frame
            is, inf where frames are only read from the first on.
        read_times: reads the times of all frames, s; None where they are evenly spaced.
        is_fixed: whether the camera is said to stand still, on a mast or a tripod.
        start: time of the first frame, s; 0 unless it is a part of a video, whose frames keep their
            numbers and times.
    """

    source: str
    height: int
    width: int
    rate: float
    frame_count: int | None
    read_all: Callable[[], Iterator[Frame]]
    read_at: Callable[[Float[Array, " n"], float], Iterator[Frame]]
    read_telemetry: Callable[[], Telemetry | None] = lambda: None
    names: tuple[str, ...] | None = None
    keyframe_interval: float = 0.0
    read_times: Callable[[], Float[Array, " N"] | None] = lambda: None
    is_fixed: bool = False
    start: float = 0.0

    def __iter__(self) -> Iterator[Frame]:
        return self.read_all()

    @property
    def duration(self) -> float:
        """Seconds, by the number of frames and their rate; NaN when that number is unknown."""
        return math.nan if self.frame_count is None else self.frame_count / self.rate

    @cached_property
    def listed(self) -> FrameList:
        """The frames' names and times, by the index of a video file."""
        times = self.read_times()
        if times is None and self.frame_count:
            times = np.arange(self.frame_count) / self.rate
        return FrameList(self.source, (self.width, self.height), self.rate, self.names, times)

    def find_time(self, index: int) -> float:
        """Find the time of a frame by its number, s since the first."""
        times, count = self.listed.times, self.listed.count
        if index < 0 or (count is not None and index >= count):
            raise ValueError(f"{self.source} has {count} frames, from 0, and none is {index}")
        return index / self.rate if times is None else float(times[index])

    @cached_property
    def first(self) -> int:
        """Number of the first frame; 0 unless it is a part of a video."""
        times = self.listed.times
        return 0 if times is None else int(np.argmin(np.abs(times - self.start)))

    @cached_property
    def telemetry(self) -> Telemetry | None:
        """State of the camera, from a file beside the video or the EXIF of images, or None."""
        try:
            return self.read_telemetry()
        except (GeoreferenceError, OSError) as error:
            message = f"{self.source}: its telemetry is ignored: {error}"
            warn(message)
            return None

    def frames_at(self, times: Iterable[float]) -> Iterator[Frame]:
        """Read the frames displayed at some times (s since the first), in order and each once."""
        ordered = np.unique(np.asarray(list(times), np.float64))
        if not np.isfinite(ordered).all():
            raise ValueError("times must be finite numbers of seconds")
        return self.read_at(ordered, 0.0)

    def sample(self, count: int) -> Iterator[Frame]:
        """Read up to `count` frames spread evenly over the video, including the first.

        A keyframe replaces a frame within half a step of it, since only the keyframe has to be
        decoded. Nothing between is read, so that a longer video costs no more.
        """
        if count < 1:
            raise ValueError(f"count must be at least 1, not {count}")
        total = self.frame_count if self.frame_count is not None else sum(1 for _ in self)
        if count >= total:
            return iter(self)
        length = (total - 1) / self.rate
        half_a_step = length / max(count - 1, 1) / 2
        return self.read_at(self.start + np.linspace(0.0, length, count), half_a_step)


VideoSource = str | Path | Video | Sequence[str | Path] | Iterable[Array]


def find_video_file(source: str) -> Path | None:
    """Find the file of a video or of a part of one, whose times are those of the whole."""
    path = Path(source if os.path.exists(source) else PART.sub("", source))
    return path.absolute() if path.is_file() else None


def read_frame(video: Video, time: float) -> Frame:
    """Read the frame that a video shows at a time, seconds; of a part at least its first one.

    Raises:
        ValueError: the video is shorter.
    """
    end = video.start + video.duration
    found = next(video.frames_at([max(time, video.start)]), None)
    if found is None or time >= end:
        raise ValueError(f"{video.source} has no frame at {time:g} s: it lasts {end:.2f} s")
    return found


def open_video(source: VideoSource, *, rate: float = 1.0, threads: int | None = None) -> Video:
    """Open a video file or its parts, a folder or glob of images, a list of images, or arrays.

    Args:
        source: path of a video, of a folder of images (jpg, png, tif, in natural order) or of one
            image; a glob pattern; a sequence of image paths; a sequence or re-iterable of
            (H, W, 3) RGB or (H, W) grey uint8 arrays; or a Video, which is returned. A path may end
            with the seconds of a part, `flight.mp4#t=8.5,24`: telemetry, numbers and times of its
            frames stay those of the whole video. A glob or sequence of video files is one
            recording, in several files as drones split it: all follow one another.
        rate: frames per second of images and arrays; 1 makes time the index. Video files carry
            their own timestamps.
        threads: decoding threads; None leaves the number to the decoder.

    Returns:
        The video. Frames are decoded when it is iterated.

    Raises:
        VideoError: the source does not exist, or no frame of it can be read.
        TypeError: the source is a one-shot iterator, or no source of frames.
        ValueError: the rate is not positive.

    >>> video = open_video(np.zeros((5, 4, 6, 3), np.uint8), rate=10)
    >>> [(frame.index, frame.time) for frame in video.sample(3)]
    [(0, 0.0), (2, 0.2), (4, 0.4)]
    """
    if rate <= 0:
        raise ValueError(f"rate must be positive, not {rate}")
    if isinstance(source, Video):
        return source
    if isinstance(source, str | Path):
        if (part := PART.search(str(source))) and not os.path.exists(source):
            whole = open_video(str(source)[: part.start()], rate=rate, threads=threads)
            return _cut_video(whole, float(part[1]), float(part[2]))
        paths = _list_files(str(source))
        if not _is_image(paths[0]):
            return _join_parts(str(source), paths, threads)
        return _open_images(str(source), paths, rate)
    if not isinstance(source, Iterable):
        raise TypeError(f"a path or an iterable of images is needed, not {type(source).__name__}")
    if iter(source) is source:
        raise TypeError(
            "the source is a one-shot iterator, but frames are read more than once; give a list, "
            "or an object whose __iter__ starts from the first image"
        )
    if not isinstance(source, Sequence | Array):
        return _open_stream(source, rate)
    if len(source) and isinstance(source[0], str | Path):
        if len(source) == 1:
            return open_video(source[0], rate=rate, threads=threads)
        paths = [Path(path) for path in source]
        if all(_is_image(path) for path in paths):
            return _open_images(f"{len(paths)} images", paths, rate)
        return _join_parts(f"{paths[0]} and {len(paths) - 1} more", paths, threads)
    return _open_indexed(lambda index: source[index], len(source), rate)


def _cut_video(video: Video, start: float, end: float) -> Video:
    """Cut a video to the frames between two times, s."""
    times = video.listed.times
    if times is None:
        times = np.array([frame.time for frame in video])
    inside = times[(times >= start - INDEX_TOLERANCE) & (times <= end + INDEX_TOLERANCE)]
    if not len(inside):
        raise VideoError(
            f"{video.source} has no frame between {start:g} and {end:g} s; its frames are of "
            f"{times[0]:.2f} to {times[-1]:.2f} s"
        )
    first, last = inside[[0, -1]] + [-INDEX_TOLERANCE, INDEX_TOLERANCE]

    def read_at(wanted: Float[Array, " n"], slack: float) -> Iterator[Frame]:
        for frame in video.read_at(wanted, slack):
            if slack == 0.0 or first < frame.time < last:  # a keyframe may lie outside
                yield frame

    return replace(
        video,
        rate=(len(inside) - 1) / (inside[-1] - inside[0]) if len(inside) > 1 else video.rate,
        frame_count=len(inside),
        read_all=lambda: _take_between(video, first, last),
        read_at=read_at,
        read_times=lambda: times,
        start=float(inside[0]),
    )


def _take_between(frames: Iterable[Frame], first: float, last: float) -> Iterator[Frame]:
    return takewhile(
        lambda frame: frame.time < last, dropwhile(lambda frame: frame.time < first, frames)
    )


def _join_parts(source: str, paths: list[Path], threads: int | None) -> Video:
    """Join the files of one recording, which follow one another without a gap."""
    parts = [_open_file(path, threads) for path in paths]
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    for part in parts[1:]:
        # a file's rate is its number of frames by its length, which is rounded in short files
        if (part.height, part.width) != (first.height, first.width) or not math.isclose(
            part.rate, first.rate, rel_tol=0.01
        ):
            raise VideoError(
                f"{part.source} has {part.width} x {part.height} px and {part.rate:.4g} frames a "
                f"second, {first.source} {first.width} x {first.height} and {first.rate:.4g}: they "
                "are no parts of one recording; give each alone"
            )
    times = [part.listed.times for part in parts]
    own = [
        np.array([frame.time for frame in part]) if stated is None else stated
        for part, stated in zip(parts, times, strict=True)
    ]
    firsts = np.cumsum([0, *(len(stated) for stated in own)])
    starts = np.cumsum([0.0, *(stated[-1] + 1 / first.rate for stated in own)])
    every = np.concatenate([stated + start for stated, start in zip(own, starts, strict=False)])

    def move(number: int, frames: Iterator[Frame]) -> Iterator[Frame]:
        for frame in frames:
            index, time = frame.index + int(firsts[number]), frame.time + float(starts[number])
            yield replace(frame, index=index, time=time)

    def read_at(wanted: Float[Array, " n"], slack: float) -> Iterator[Frame]:
        numbers = np.searchsorted(starts[1:-1] - INDEX_TOLERANCE, wanted, side="right")
        for number in np.unique(numbers).tolist():
            inside = (wanted[numbers == number] - starts[number]).clip(0.0)
            yield from move(number, parts[number].read_at(inside, slack))

    return replace(
        first,
        source=source,
        rate=len(every) / float(starts[-1]),
        frame_count=len(every),
        read_all=lambda: chain.from_iterable(move(n, iter(part)) for n, part in enumerate(parts)),
        read_at=read_at,
        read_telemetry=lambda: (
            _read_sidecar_log(paths[0], float(starts[-1]))
            or join_telemetry([part.read_telemetry() for part in parts], starts)
        ),
        keyframe_interval=max(part.keyframe_interval for part in parts),
        read_times=lambda: every,
    )


def _open_file(path: Path, threads: int | None) -> Video:
    file = open_video_file(path, threads)
    height, width = file.stored_size[::-1] if file.quarter_turns % 2 else file.stored_size
    return Video(
        source=str(path),
        height=height,
        width=width,
        rate=file.rate,
        frame_count=file.count or None,
        read_all=lambda: read_frames(file),
        read_at=lambda times, slack: read_frames_at(file, times.tolist(), slack),
        read_telemetry=lambda: _read_telemetry(path, file),
        keyframe_interval=file.keyframe_interval,
        read_times=lambda: file.frame_times if len(file.frame_times) else None,
    )


def _read_telemetry(path: Path, file: VideoFile) -> Telemetry | None:
    """Telemetry from the .SRT or flight log beside a video or from its subtitles, or None."""
    sidecars = [path.with_suffix(suffix) for suffix in (".SRT", ".srt")]
    found = next((read_srt(sidecar) for sidecar in sidecars if sidecar.exists()), None)
    if found is None:
        found = _read_sidecar_log(path, file.count / file.rate if file.count else math.nan)
    if found is None:
        found = read_subtitles(path, 0.0 if np.isnan(file.start) else file.start)
    if found is None or file.quarter_turns % 4 == 0:
        return found
    reason = f"the video is turned by {90 * file.quarter_turns} degrees for display"
    remarks = {**found.remarks, "yaw": reason}
    return replace(found, yaw=np.full_like(found.yaw, np.nan), remarks=remarks)


def _read_sidecar_log(path: Path, duration: float) -> Telemetry | None:
    """Telemetry from the flight log of the same name as a video, or None."""
    logs = [path.with_suffix(suffix) for suffix in (".csv", ".CSV")]
    found = next((log for log in logs if log.is_file() and is_flight_log(log)), None)
    return None if found is None else read_flight_log(found, duration)


def warn_of_pace(video: Video) -> None:
    """Warn of slow motion and time lapse, where the dates of the telemetry tell it."""
    telemetry = video.telemetry if video.names is None else None
    if telemetry is None or not len(telemetry.time):
        return
    recorded, shown = telemetry.recorded, float(np.ptp(telemetry.time))
    others = (shown, video.duration)  # a video whose times were mended keeps its old .SRT
    if all(
        abs(recorded - one) > 2.0 and max(recorded, one) > SLOW_MOTION * min(recorded, one)
        for one in others
    ):
        pace = recorded / shown
        kind = "slow motion" if pace < 1 else "a time lapse"
        warn(
            f"{video.source} is {kind}: by the dates of its telemetry {recorded:.0f} s were "
            f"recorded, which it shows in {shown:.0f} s, so that speeds are {pace:.3g} times the "
            f"true ones; mend its times (ffmpeg -itsscale {pace:.4g} -i IN -c copy OUT)"
        )


def _list_files(source: str) -> list[Path]:
    """Images of a folder or pattern, else the videos of a pattern, in natural order; or a file."""
    path = Path(source)
    if os.path.isdir(source):  # False of a name that is too long
        entries = list(path.iterdir())
    elif os.path.exists(source):
        return [path]
    elif any(sign in source for sign in "*?["):
        entries = [Path(entry) for entry in glob.glob(source)]
    else:
        raise VideoError(f"{source}: there is no such file or folder")
    found = [entry for entry in entries if _is_image(entry)]
    if not found and not os.path.isdir(source):
        found = [entry for entry in entries if entry.suffix.lower() in VIDEO_SUFFIXES]
    if not found:
        kinds = ", ".join(sorted(IMAGE_SUFFIXES))
        raise VideoError(f"{source}: no image found; {kinds} are read, and patterns of videos")
    return sorted(found, key=_natural_sort_key)


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")


def _natural_sort_key(path: Path) -> list[tuple[int, str]]:
    """Sort key that puts frame_2 before frame_10."""
    parts = re.split(r"(\d+)", str(path).lower())
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _read_image(path: Path) -> UInt8[Array, "H W 3"]:
    """RGB with the EXIF orientation applied."""
    if not path.is_file():
        raise VideoError(f"{path}: no such file; leave it out of the list")
    with refuse_damaged(path, VideoError, "an image that can be read"):
        with open_raster_file(path) as header:
            height, width = header.shape
            if header.count > 4 or "GEOAIM" in header.tags():
                raise ValueError(
                    f"it has {header.count} bands or is a map of geoaim, for geoaim view and align"
                )
        size, needed = path.stat().st_size, BYTES_PER_PIXEL * height * width
        check_memory(path, needed, size, VideoError, f"{height} x {width} pixels")
        image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise ValueError("OpenCV cannot decode it")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB, dst=image)


def _open_images(source: str, paths: list[Path], rate: float) -> Video:
    names = tuple(path.name for path in paths)
    video = _open_indexed(lambda index: _read_image(paths[index]), len(paths), rate, names)
    return replace(video, source=source, read_telemetry=lambda: read_exif(paths, rate=rate))


def _open_indexed(
    load: Callable[[int], Any], count: int, rate: float, names: tuple[str, ...] | None = None
) -> Video:
    """Open frames that can be loaded by index: images, and sequences of arrays."""
    if not count:
        raise VideoError("there are no frames: the sequence is empty")
    labels = names or [f"frame {index}" for index in range(count)]
    height, width = _check_pixels(load(0), labels[0]).shape[:2]

    def read(indices: Iterable[int]) -> Iterator[Frame]:
        for index in indices:
            pixels = _check_pixels(load(index), labels[index], (height, width))
            yield Frame(index, index / rate, names[index] if names else None, pixels)

    return Video(
        source="arrays",
        height=height,
        width=width,
        rate=rate,
        frame_count=count,
        read_all=lambda: read(range(count)),
        read_at=lambda times, _: read(_compute_indices(times, rate, count)),
        names=names,
    )


def _open_stream(arrays: Iterable[Any], rate: float) -> Video:
    """Open frames that can only be read from the first on, each time anew."""
    first = next(iter(arrays), None)
    if first is None:
        raise VideoError("there are no frames: the iterable is empty")
    height, width = _check_pixels(first, "frame 0").shape[:2]

    def read() -> Iterator[Frame]:
        for index, array in enumerate(arrays):
            pixels = _check_pixels(array, f"frame {index}", (height, width))
            yield Frame(index, index / rate, None, pixels)

    def read_at(times: Float[Array, " n"], _: float) -> Iterator[Frame]:
        indices = set(_compute_indices(times, rate, sum(1 for _ in arrays)))
        return (frame for frame in read() if frame.index in indices)

    return Video("arrays", height, width, rate, None, read, read_at, keyframe_interval=math.inf)


def _compute_indices(times: Float[Array, " n"], rate: float, count: int) -> list[int]:
    """Indices of the frames displayed at the times, each once."""
    indices = np.floor(times * rate + INDEX_TOLERANCE).clip(0, count - 1).astype(np.int64)
    return [int(index) for index in np.unique(indices)]


def _check_pixels(array: Any, label: str, size: tuple[int, int] | None = None) -> Pixels:
    pixels = np.asarray(array)
    colour = pixels.ndim == 3 and pixels.shape[2] == 3
    if pixels.dtype != np.uint8 or not (pixels.ndim == 2 or colour):
        raise TypeError(
            f"{label}: uint8 of shape (H, W, 3) or (H, W) needed, not {pixels.dtype} {pixels.shape}"
        )
    if size is not None and pixels.shape[:2] != size:
        raise VideoError(
            f"{label}: {pixels.shape[0]} x {pixels.shape[1]} pixels (height x width), but the "
            f"first frame has {size[0]} x {size[1]}; all must have the same size"
        )
    return pixels
