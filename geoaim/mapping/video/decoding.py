"""Video files by FFmpeg: all frames in order, or those at given times by leaps to keyframes."""

import math
import warnings
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, groupby, islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import av
import numpy as np

from geoaim.errors import GeoaimWarning, VideoError
from geoaim.mapping.video.frames import UPRIGHT, Frame, Turn

TICK = 1e-3  # seconds; Matroska rounds timestamps to milliseconds


@dataclass(frozen=True)
class Clip:
    """What opening a video file told.

    Attributes:
        path: the file.
        threads: decoding threads, None for the decoder's choice.
        stored_size: (height, width) of the frames before they are set upright.
        turn: sets them upright.
        start: presentation time of the first frame, seconds; NaN where frames carry no time.
        rate: average frames per second.
        count: frames that the file states to have, 0 when it does not.
        counted: whether `count` is a count, not duration times rate.
        searchable: whether seeking finds the frame of a time; raw streams and AVI do not.
    """

    path: Path
    threads: int | None
    stored_size: tuple[int, int]
    turn: Turn
    start: float
    rate: float
    count: int
    counted: bool
    searchable: bool


@dataclass(frozen=True)
class _Key:
    """A keyframe: when it is shown, how to seek to it, and whether it is all that is wanted."""

    time: float
    offset: int = field(compare=False)  # several lead to one keyframe
    backward: bool = field(compare=False)
    alone: bool = False


def open_clip(path: Path, threads: int | None) -> Clip:
    """Decode the first frame of a video file, and learn what the file says of itself.

    Raises:
        VideoError: empty, not a video, no video stream, or not one frame that can be decoded.
    """
    with _container(path) as container:
        stream = _video_stream(container, path, threads)
        decoded = _decoded(stream.codec_context, container.demux(stream))
        first = next((frame for frame in decoded if frame is not None), None)
        if first is None:
            raise VideoError(f"{path}: not one frame could be decoded; the file is damaged")
        count, counted = _stated_count(container, stream)
        stamped = first.pts is not None and container.format.name != "avi"  # AVI has none
        return Clip(
            path=path,
            threads=threads,
            stored_size=(first.height, first.width),
            turn=_turn(first),
            start=float(first.pts * stream.time_base) if stamped else math.nan,
            rate=_rate(stream),
            count=count,
            counted=counted,
            searchable=stamped and count > 0 and _is_searchable(container),
        )


def read_clip(clip: Clip) -> Iterator[Frame]:
    """Every frame in presentation order, then a warning where some are missing."""
    index, time, missed = -1, -1 / clip.rate, 0
    breaks: list[str] = []
    with _container(clip.path) as container:
        stream = _video_stream(container, clip.path, clip.threads)
        for decoded in _decoded(stream.codec_context, container.demux(stream)):
            if decoded is None:
                missed += 1
                continue
            now = _time(clip, stream, decoded, time + (missed + 1) / clip.rate)
            if missed:  # the decoder may drop more than it tells: the time says how many
                lost = max(round((now - time) * clip.rate) - 1, 0)
                breaks.append(f"{lost} frame(s) after frame {index} ({time:.3f} s)")
                index += lost
            index, time, missed = index + 1, now, 0
            yield _frame(clip, decoded, index, time)
    if missed:
        breaks.append(f"{missed} frame(s) after frame {index} ({time:.3f} s)")
    _warn_of_breaks(clip, breaks, index, time)


def seek_clip(clip: Clip, times: list[float], slack: float) -> Iterator[Frame]:
    """The frame shown at each of the times, which are in order; each frame once.

    Only what lies between the keyframe before a time and that time is decoded; or nothing but a
    keyframe, where one lies within `slack` seconds of the time.
    """
    if not clip.searchable:
        yield from _shown(read_clip(clip), times)
        return
    lost: list[float] = []
    last = -math.inf
    with _container(clip.path) as container:
        stream = _video_stream(container, clip.path, clip.threads)
        keys = [_keyframe_for(clip, container, stream, time, slack) for time in times]
        for key, run in groupby(zip(keys, times, strict=True), itemgetter(0)):
            wanted = [time for _, time in run]
            frames = _frames_from(clip, container, stream, key) if key else iter(())
            read = False
            for frame in _shown(frames, wanted):
                read = True
                if frame.time > last:
                    last = frame.time
                    yield frame
            ended = not (key and key.alone) and next(frames, None) is None
            beyond = last + _hold(clip) if ended else math.inf
            lost += [time for time in wanted if not read or time > beyond]
    if lost:
        message = (
            f"{clip.path}: {len(lost)} of {len(times)} wanted frames cannot be read, the first at "
            f"{lost[0]:.3f} s: the file ends before, or is damaged"
        )
        warnings.warn(GeoaimWarning(message), stacklevel=2)


def _container(path: Path) -> Any:
    try:
        return av.open(str(path))
    except av.FFmpegError as error:
        with path.open("rb") as file:
            head = file.read(8)
        if not head:
            raise VideoError(f"{path}: the file is empty") from error
        if head[4:] == b"ftyp":
            raise VideoError(
                f"{path}: an MP4 or MOV whose index (moov atom) cannot be read: the recording or "
                "the copy broke off before its end; copy it again, or repair it (untrunc)"
            ) from error
        raise VideoError(f"{path}: not a video that FFmpeg can read ({error.strerror})") from error


def _video_stream(container: Any, path: Path, threads: int | None) -> Any:
    cover = av.stream.Disposition.attached_pic
    streams = [stream for stream in container.streams.video if not stream.disposition & cover]
    if not streams:
        kinds = ", ".join(sorted({stream.type for stream in container.streams})) or "nothing"
        raise VideoError(f"{path}: no video in this file, only {kinds}")
    streams[0].thread_type = "AUTO"
    if threads is not None:
        streams[0].thread_count = threads
    return streams[0]


def _turn(frame: Any) -> Turn:
    """From the display matrix: stored (x, y) is shown at (a x + c y, b x + d y)."""
    matrix = frame.side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return UPRIGHT
    a, b, _, c, d = np.frombuffer(matrix, "<i4")[:5].tolist()
    transpose = abs(b) > abs(a)
    return Turn(transpose, (b if transpose else d) < 0, (c if transpose else a) < 0)


def _is_searchable(container: Any) -> bool:
    return any(name in container.format.name for name in ("mov", "matroska", "mpegts"))


def _rate(stream: Any) -> float:
    return float(stream.average_rate or stream.guessed_rate or 25)


def _stated_count(container: Any, stream: Any) -> tuple[int, bool]:
    """Frames that the file states to have, and whether it counts them or tells the duration."""
    if stream.frames and "mov" in container.format.name:  # an edit list may hide some of them
        return sum(not entry.is_discard for entry in stream.index_entries), True
    if stream.frames:
        return stream.frames, True
    if stream.duration is not None:
        return round(stream.duration * stream.time_base * _rate(stream)), False
    return round((container.duration or 0) / av.time_base * _rate(stream)), False


def _decoded(codec: Any, packets: Iterator[Any]) -> Iterator[Any]:
    """Decoded frames; None for each that is damaged, or built on a damaged one."""
    intact = True
    while True:
        try:
            packet = next(packets, None)
            cut = packet is not None and packet.is_corrupt  # then empty the decoder of what is good
            frames = codec.decode(None if cut else packet)
        except av.error.EOFError:
            return
        except av.FFmpegError:
            intact = False
            yield None
            continue
        for frame in frames:
            intact = not frame.is_corrupt and (intact or frame.key_frame)
            yield frame if intact else None
        if cut:
            codec.flush_buffers()
            intact = False
            yield None


def _time(clip: Clip, stream: Any, decoded: Any, otherwise: float) -> float:
    """Seconds since the first frame, by the presentation timestamp where there is one."""
    if decoded.pts is None or math.isnan(clip.start):
        return otherwise
    return float(decoded.pts * stream.time_base) - clip.start


def _frame(clip: Clip, decoded: Any, index: int, time: float) -> Frame:
    if (decoded.height, decoded.width) != clip.stored_size:
        raise VideoError(
            f"{clip.path}: frame {index} has {decoded.height} x {decoded.width} pixels (height x "
            f"width), the first has {clip.stored_size[0]} x {clip.stored_size[1]}; split the file"
        )
    return Frame(index, time, None, decoded, clip.turn)


def _warn_of_breaks(clip: Clip, breaks: list[str], index: int, time: float) -> None:
    found = []
    if breaks:
        more = f" and more at {len(breaks) - 1} other places" if len(breaks) > 1 else ""
        found.append(f"damaged, left out {breaks[0]}{more}")
    duration = clip.count / clip.rate
    short = index + 1 < clip.count if clip.counted else time + _hold(clip) < duration
    if short:
        found.append(
            f"breaks off after frame {index} ({time:.3f} s), "
            f"{clip.count} frames ({duration:.3f} s) were expected"
        )
    if found:
        warnings.warn(GeoaimWarning(f"{clip.path}: {'; '.join(found)}"), stacklevel=3)


def _hold(clip: Clip) -> float:
    """Seconds for which the last frame may stand without anything being amiss."""
    return max(0.25, 3 / clip.rate)


def _shown(frames: Iterable[Frame], times: list[float]) -> Iterator[Frame]:
    """Of frames in order of time, those on display at the times, which are in order too."""
    current, pending = None, deque(times)
    for following in chain(frames, [None]):
        until = math.inf if following is None else following.time - TICK
        if current is not None and pending[0] < until:
            yield current
            while pending and pending[0] < until:
                pending.popleft()
            if not pending:
                return
        current = following


def _keyframe_for(
    clip: Clip, container: Any, stream: Any, time: float, slack: float
) -> _Key | None:
    """The keyframe to decode alone or from, for the frame at a time; None where nothing is left."""
    before = _keyframe_before(clip, container, stream, time)
    if before is None or slack == 0 or time <= 0:
        return before
    after = _first_key(clip, container, stream, time, backward=False)
    near = after if after and after.time - time < time - before.time else before
    return replace(near, alone=True) if abs(near.time - time) <= slack else before


def _keyframe_before(clip: Clip, container: Any, stream: Any, time: float) -> _Key | None:
    earlier = 0.0
    while True:
        target = time - earlier if earlier <= time else -10.0  # well before the first frame
        key = _first_key(clip, container, stream, target, backward=True)
        if key is not None and (key.time <= time + TICK or earlier > time):
            return key
        if key is None and (earlier > time or "mpegts" not in container.format.name):
            return None
        earlier = 2 * earlier or 0.25  # MPEG-TS has no index: seeking lands behind the keyframe


def _first_key(
    clip: Clip, container: Any, stream: Any, time: float, *, backward: bool
) -> _Key | None:
    offset = math.floor((clip.start + time + TICK) / stream.time_base)
    try:
        container.seek(offset, stream=stream, backward=backward)
        packet = next((packet for packet in container.demux(stream) if packet.is_keyframe), None)
    except av.FFmpegError:
        return None
    if packet is None:
        return None
    stamp = packet.dts if packet.pts is None else packet.pts
    return _Key(float(stamp * stream.time_base) - clip.start, offset, backward)


def _frames_from(clip: Clip, container: Any, stream: Any, key: _Key) -> Iterator[Frame]:
    """The frames from a keyframe on, or the keyframe alone; the index is estimated from time."""
    container.seek(key.offset, stream=stream, backward=key.backward)
    packets = container.demux(stream)
    if key.alone:
        packets = islice((packet for packet in packets if packet.is_keyframe), 1)
    for decoded in _decoded(stream.codec_context, packets):
        if decoded is not None:
            time = _time(clip, stream, decoded, key.time)
            yield _frame(clip, decoded, round(time * clip.rate), time)
