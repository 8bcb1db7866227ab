"""Decode video files with FFmpeg: all frames in order, or frames at given times by seeking."""

import math
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, dropwhile, groupby, islice
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import av
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import VideoError, warn
from geoaim.base.limits import MAX_RECORDING_S, check_regular
from geoaim.mapping.video.frames import Frame

SKIPPING_FRAMES = 2.0  # frames of slack, from which frames that no other needs are not decoded
MAX_FAILURES_AT_END = 64  # frames that a decoder holds at the end; some repeat errors for ever
MIN_END_TOLERANCE_S = 0.25  # a file may last so much longer than its last frame


@dataclass(frozen=True)
class VideoFile:
    """A video file that can be decoded, and the properties that it states."""

    path: Path
    threads: int | None  # threads for decoding; None leaves the number to the decoder
    stored_size: tuple[int, int]  # (height, width) of decoded frames, before they are turned
    quarter_turns: int  # counter-clockwise, that turn a decoded frame upright
    start: float  # presentation time of the first frame, seconds; NaN where frames carry none
    rate: float  # frames per second, on average
    count: int  # number of frames that the file states; 0 when it states none
    count_is_exact: bool  # whether `count` is a count of frames, not duration times rate
    seekable: bool  # whether frames can be found by time; not in raw streams and AVI
    keyframe_interval: float = math.inf  # seconds in the middle of the file; inf if not seekable
    lists_frames: bool = False  # whether an index tells every frame, damaged ones too

    @cached_property
    def frame_times(self) -> Float[Array, " N"]:
        """Seconds of all frames since the first; without time stamps by their number and rate."""
        if math.isnan(self.start):
            return np.arange(self.count) / self.rate
        return read_frame_times(self.path, self.start)

    def find_number(self, time: float) -> int:
        """Find the number of the frame at a time (s), from 0 in order of presentation."""
        times = self.frame_times
        if not len(times):
            return round(time * self.rate)
        after = int(np.searchsorted(times, time))
        near = [number for number in (after - 1, after) if 0 <= number < len(times)]
        return min(near, key=lambda number: abs(float(times[number]) - time))


@dataclass(frozen=True)
class _Keyframe:
    """A keyframe: its time (s), and how to seek to it."""

    time: float
    offset: int = field(compare=False)  # several offsets lead to the same keyframe
    backward: bool = field(compare=False)


@dataclass(frozen=True)
class _Run:
    """Frames at some times (s) to decode from a keyframe on, or only that; None past the end."""

    keyframe: _Keyframe | None
    times: list[float]
    alone: bool


def open_video_file(path: Path, threads: int | None) -> VideoFile:
    """Decode the first frame of a video file, and read the properties that the file states."""
    with open_container(path) as container:
        stream = select_stream(container, path, threads)
        decoded = _decode(stream.codec_context, container.demux(stream))
        first = next((frame for frame in decoded if frame is not None), None)
        if first is None:
            raise VideoError(f"{path}: no frame can be decoded; it has none, or is damaged")
        _warn_of_shape(path, stream, first)
        rate = float(stream.average_rate or stream.guessed_rate or 25)
        count, count_is_exact = read_frame_count(container, stream, rate)
        stamped = first.pts is not None and container.format.name != "avi"  # AVI has none
        by_time = any(name in container.format.name for name in ("mov", "matroska", "mpegts"))
        file = VideoFile(
            path=path,
            threads=threads,
            stored_size=(first.height, first.width),
            quarter_turns=round(first.rotation / 90),
            start=float(first.pts * stream.time_base) if stamped else math.nan,
            rate=rate,
            count=count,
            count_is_exact=count_is_exact,
            seekable=stamped and count > 0 and by_time,
            lists_frames=stamped and "mov" in container.format.name,
        )
        interval = _measure_keyframe_interval(file, container, stream)
        return replace(file, keyframe_interval=interval)


def _warn_of_shape(path: Path, stream: Any, first: Any) -> None:
    """Warn where frames are stored otherwise than they are to be shown, but for quarter turns."""
    shape = stream.sample_aspect_ratio
    if shape not in (None, 0, 1):
        warn(
            f"{path}: its pixels are {float(shape):.3g} times as wide as high, and are taken as "
            "square, so that ground and vehicles are stretched: convert it (ffmpeg -i IN -vf "
            "scale=iw*sar:ih,setsar=1 OUT)"
        )
    matrices = [data for data in first.side_data if data.type.name == "DISPLAYMATRIX"]
    for a, b, _, c, d in (np.frombuffer(data, np.int32)[:5].tolist() for data in matrices):
        if a * d < b * c:
            warn(
                f"{path} says that it is shown as in a mirror, which is left undone, since a camera"
                " sees the ground unmirrored; if its frames are mirrored, convert it (ffmpeg -vf "
                "hflip)"
            )


def read_frames(file: VideoFile) -> Iterator[Frame]:
    """Yield every frame in presentation order; `GeoaimWarning` at the end if some were missing."""
    index, time, missing = -1, -1 / file.rate, 0
    gaps: list[str] = []
    with open_container(file.path) as container:
        stream = select_stream(container, file.path, file.threads)
        for decoded in _decode(stream.codec_context, container.demux(stream)):
            if decoded is None:
                missing += 1
                continue
            now = _compute_time(file, stream, decoded, time + (missing + 1) / file.rate)
            if missing:  # the decoder may drop more than it reports; the timestamps tell how many
                lost = max(_count_frames_between(file, time, now), 0)
                gaps.append(f"{lost} frame(s) after frame {index} ({time:.3f} s)")
                index += lost
            index, time, missing = index + 1, now, 0
            yield _make_frame(file, decoded, index, time)
    if missing:
        gaps.append(f"{missing} frame(s) after frame {index} ({time:.3f} s)")
    _warn_of_gaps(file, gaps, index, time)


def read_frames_at(file: VideoFile, times: list[float], slack: float) -> Iterator[Frame]:
    """Yield the frames displayed at given times, each once."""
    if not file.seekable:
        yield from _select_shown(read_frames(file), times)
        return
    unread: list[float] = []
    last = -math.inf
    with open_container(file.path) as container:
        stream = select_stream(container, file.path, file.threads)
        runs = _plan_runs(file, container, stream, times, slack)
        for run, frames in _decode_runs(file, container, stream, runs):
            any_read = False
            for frame in _select_shown(frames, run.times):
                any_read = True
                if frame.time > last:
                    last = frame.time
                    yield frame
                    if slack * file.rate >= SKIPPING_FRAMES:  # not before the first frame
                        stream.codec_context.skip_frame = "NONREF"
            ended = not run.alone and next(frames, None) is None
            end = last + _compute_end_tolerance(file) if ended else math.inf
            unread += [time for time in run.times if not any_read or time > end]
    if unread:
        warn(
            f"{file.path}: {len(unread)} of {len(times)} requested frames cannot be read, the "
            f"first at {unread[0]:.3f} s: the file ends earlier, or is damaged"
        )


def _decode(codec: Any, packets: Iterator[Any]) -> Iterator[Any]:
    """Yield decoded frames; None for each that is damaged or predicted from a damaged one."""
    intact, failed_at_end, packet = True, 0, None
    while failed_at_end < MAX_FAILURES_AT_END:
        try:
            packet = next(packets, None)
            corrupt = packet is not None and packet.is_corrupt
            frames = codec.decode(None if corrupt else packet)  # None: the intact frames so far
        except av.error.EOFError:
            return
        except av.FFmpegError:
            intact = False
            failed_at_end += packet is None
            yield None
            continue
        for frame in frames:
            intact = not frame.is_corrupt and (intact or frame.key_frame)
            yield frame if intact else None
        if corrupt:
            codec.flush_buffers()
            intact = False
            yield None


def _compute_time(file: VideoFile, stream: Any, decoded: Any, default: float) -> float:
    """Seconds since the first frame by the presentation timestamp, or `default` without one."""
    if decoded.pts is None or math.isnan(file.start):
        return default
    return float(decoded.pts * stream.time_base) - file.start


def _count_frames_between(file: VideoFile, before: float, after: float) -> int:
    """Count the frames that a file lost between two times (s)."""
    if not file.lists_frames or before < 0:
        return round((after - before) * file.rate) - 1
    return file.find_number(after) - file.find_number(before) - 1


def _make_frame(file: VideoFile, decoded: Any, index: int, time: float) -> Frame:
    if (decoded.height, decoded.width) != file.stored_size:
        raise VideoError(
            f"{file.path}: frame {index} has {decoded.height} x {decoded.width} pixels (height x "
            f"width), the first has {file.stored_size[0]} x {file.stored_size[1]}; split the file"
        )
    if not abs(time) <= MAX_RECORDING_S:
        raise VideoError(
            f"{file.path}: frame {index} is at {time:.3g} s, {MAX_RECORDING_S:g} s at most are "
            "plausible; the file's times are damaged: copy it again, or convert it"
        )
    return Frame(index, time, None, decoded, file.quarter_turns)


def _warn_of_gaps(file: VideoFile, gaps: list[str], index: int, time: float) -> None:
    """Warn of missing frames inside a file, and at its end, after the last frame that was read."""
    problems = []
    if gaps:
        more = f" and more at {len(gaps) - 1} other places" if len(gaps) > 1 else ""
        problems.append(f"damaged, left out {gaps[0]}{more}")
    duration = file.count / file.rate
    ends_early = time + _compute_end_tolerance(file) < duration
    if index + 1 < file.count if file.count_is_exact else ends_early:
        problems.append(
            f"breaks off after frame {index} ({time:.3f} s), "
            f"{file.count} frames ({duration:.3f} s) were expected"
        )
    if problems:
        warn(f"{file.path}: {'; '.join(problems)}")


def _compute_end_tolerance(file: VideoFile) -> float:
    """Seconds that an intact file may last after the time of its last frame."""
    return max(MIN_END_TOLERANCE_S, 3 / file.rate)


def _select_shown(frames: Iterable[Frame], times: list[float]) -> Iterator[Frame]:
    """Yield those of the frames, in order of time, that are displayed at the ordered times."""
    current, pending = None, deque(times)
    for following in chain(frames, [None]):
        until = math.inf if following is None else following.time - TIMESTAMP_STEP_S
        if current is not None and pending[0] < until:
            yield current
            while pending and pending[0] < until:
                pending.popleft()
            if not pending:
                return
        current = following


def _measure_keyframe_interval(file: VideoFile, container: Any, stream: Any) -> float:
    """Seconds between the keyframes about the middle of a file; inf where none follows."""
    if not file.seekable:
        return math.inf
    middle = file.count / file.rate / 2
    before = _find_keyframe_before(file, container, stream, middle)
    after = _seek_keyframe(file, container, stream, middle, backward=False)
    return after.time - before.time if before and after and after != before else math.inf


def _plan_runs(
    file: VideoFile, container: Any, stream: Any, times: list[float], slack: float
) -> list[_Run]:
    """Group times by the keyframe with which their frames are decoded."""
    choices: list[tuple[_Keyframe | None, float, bool]] = []
    before = after = None
    for time in times:
        if before is None or time < before.time or (after and time >= after.time):
            before = _find_keyframe_before(file, container, stream, time)
            after = _seek_keyframe(file, container, stream, time, backward=False)
        nearest = after if before and after and after.time - time < time - before.time else before
        if nearest and time > 0 and 0 < slack >= abs(nearest.time - time):
            choices.append((nearest, nearest.time, True))
        else:
            choices.append((before, time, False))
    runs = []
    for keyframe, group in groupby(choices, itemgetter(0)):
        _, shown, replaced = zip(*group, strict=True)
        runs.append(_Run(keyframe, list(shown), all(replaced)))
    return runs


def _find_keyframe_before(
    file: VideoFile, container: Any, stream: Any, time: float
) -> _Keyframe | None:
    earlier = 0.0
    while True:
        target = time - earlier if earlier <= time else -10.0  # well before the first frame
        keyframe = _seek_keyframe(file, container, stream, target, backward=True)
        if keyframe is not None and (keyframe.time <= time + TIMESTAMP_STEP_S or earlier > time):
            return keyframe
        if keyframe is None and (earlier > time or "mpegts" not in container.format.name):
            return None
        earlier = 2 * earlier or 0.25  # MPEG-TS has no index: a seek may end after the keyframe


def _seek_keyframe(
    file: VideoFile, container: Any, stream: Any, time: float, *, backward: bool
) -> _Keyframe | None:
    offset = math.floor((file.start + time + TIMESTAMP_STEP_S) / stream.time_base)
    try:
        container.seek(offset, stream=stream, backward=backward)
        packet = next((packet for packet in container.demux(stream) if packet.is_keyframe), None)
    except av.FFmpegError:
        return None
    if packet is None:
        return None
    stamp = packet.dts if packet.pts is None else packet.pts
    return _Keyframe(float(stamp * stream.time_base) - file.start, offset, backward)


def _decode_runs(
    file: VideoFile, container: Any, stream: Any, runs: list[_Run]
) -> Iterator[tuple[_Run, Iterator[Frame]]]:
    """Yield each run with its frames."""
    for alone, group in groupby(runs, attrgetter("alone")):
        if alone:
            while some := list(islice(group, 8)):  # keyframes whose packets are read in one go
                keyframes = [run.keyframe for run in some if run.keyframe]
                frames = _decode_keyframes(file, container, stream, keyframes)
                yield from zip(some, frames, strict=True)
            continue
        for run in group:
            if run.keyframe is None:
                yield run, iter(())
            else:
                packets = _demux_from(container, stream, run.keyframe)
                yield run, _decode_frames(file, stream, packets, run.keyframe.time)


def _decode_keyframes(
    file: VideoFile, container: Any, stream: Any, keyframes: list[_Keyframe]
) -> Iterator[Iterator[Frame]]:
    """Decode keyframes one after another; the decoder's threads work on the next ones meanwhile."""
    packets = [next(_demux_from(container, stream, keyframe), None) for keyframe in keyframes]
    frames = _decode_frames(file, stream, filter(None, packets), math.nan)
    decoded: dict[float, Frame] = {}
    for keyframe in keyframes:
        if keyframe.time not in decoded:
            decoded |= {frame.time: frame for frame in islice(frames, 1)}
        if keyframe.time in decoded:
            yield iter([decoded.pop(keyframe.time)])
        else:  # frames of an open group of pictures are decoded only after a seek
            decoded |= {frame.time: frame for frame in frames}  # kept: the seek drops them
            packet = islice(_demux_from(container, stream, keyframe), 1)
            yield _decode_frames(file, stream, packet, keyframe.time)


def _demux_from(container: Any, stream: Any, keyframe: _Keyframe) -> Iterator[Any]:
    """Seek to a keyframe, which resets the decoder, and read packets from it on."""
    container.seek(keyframe.offset, stream=stream, backward=keyframe.backward)
    return dropwhile(lambda packet: not packet.is_keyframe, container.demux(stream))


def _decode_frames(
    file: VideoFile, stream: Any, packets: Iterator[Any], default_time: float
) -> Iterator[Frame]:
    """Decode packets to frames, whose numbers follow from their times."""
    for decoded in _decode(stream.codec_context, packets):
        if decoded is not None:
            time = _compute_time(file, stream, decoded, default_time)
            yield _make_frame(file, decoded, file.find_number(time), time)


# FFmpeg's containers and raw streams; playlists and lists of files would name others
FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc,av1,obu,ivf,"
    "flv,live_flv,asf,ogg,mjpeg,mxf,gif,dv,wtv,nut"
)


def open_container(path: Path) -> Any:
    """Open a video file, as PyAV's container."""
    check_regular(path, VideoError)
    try:
        options = {"format_whitelist": FORMATS, "protocol_whitelist": "file"}
        return av.open(f"file:{path}", options=options, metadata_errors="replace")
    except av.FFmpegError as error:
        with path.open("rb") as opened:
            head = opened.read(8)
        if not head:
            raise VideoError(f"{path}: the file is empty") from error
        if head[4:] == b"ftyp":
            raise VideoError(
                f"{path}: an MP4 or MOV whose index (moov atom) cannot be read: the recording or "
                "the copy was interrupted; copy it again, or repair it (untrunc)"
            ) from error
        raise VideoError(f"{path}: not a video that FFmpeg can read ({error.strerror})") from error


def select_stream(container: Any, path: Path, threads: int | None) -> Any:
    """Select the video stream of a container: the longest, then the default, then the largest."""
    cover = av.stream.Disposition.attached_pic
    streams = [stream for stream in container.streams.video if not stream.disposition & cover]
    if not streams:
        kinds = ", ".join(sorted({one.type for one in container.streams})) or "no stream at all"
        raise VideoError(f"{path}: no video in this file, but {kinds}; give a video file")
    stream = max(streams, key=_rate_stream)
    if stream.codec_context is None:
        raise VideoError(f"{path}: its codec is unknown to FFmpeg; convert the file to H.264")
    stream.thread_type = "AUTO"
    if threads is not None:
        stream.thread_count = threads
    return stream


def _rate_stream(stream: Any) -> tuple[int, bool, int]:
    """Rate a stream: whole seconds, whether it is the default, and pixels; a thumbnail has few."""
    seconds = 0 if stream.duration is None else round(stream.duration * stream.time_base)
    codec = stream.codec_context
    pixels = 0 if codec is None else codec.width * codec.height
    return seconds, bool(stream.disposition & av.stream.Disposition.default), pixels


def read_frame_count(container: Any, stream: Any, rate: float) -> tuple[int, bool]:
    """Read the number of frames that a file states."""
    if stream.frames and "mov" in container.format.name:  # an edit list may hide some of them
        return sum(not entry.is_discard for entry in stream.index_entries), True
    if stream.frames:
        return stream.frames, True
    if stream.duration is not None:
        return round(stream.duration * stream.time_base * rate), False
    return round((container.duration or 0) / av.time_base * rate), False


MAX_UNEVENNESS = 0.01  # of steps between evenly spaced frames, as a share
TIMESTAMP_STEP_S = 1e-3  # Matroska rounds timestamps to milliseconds


def read_frame_times(path: Path, start: float) -> Float[Array, " N"]:
    """Read the times of all frames without decoding one."""
    with open_container(path) as container:
        stream = select_stream(container, path, None)
        unit = float(stream.time_base)
        if "mov" in container.format.name:
            entries = [entry.timestamp for entry in stream.index_entries if not entry.is_discard]
            times = (np.sort(np.array(entries, np.float64)) - min(entries, default=0)) * unit
            steps = np.diff(times)
            is_even = not len(steps) or np.ptp(steps) <= MAX_UNEVENNESS * steps.mean()
            if len(times) and (is_even or not stream.codec_context.has_b_frames):
                return times
        stamps: list[int] = []
        with suppress(av.FFmpegError):  # a damaged file: its frames up to there
            stamps.extend(
                packet.pts
                for packet in container.demux(stream)
                if packet.pts is not None and not packet.is_discard
            )
    times = np.unique(np.array(stamps, np.float64)) * unit - start
    return times[times > -TIMESTAMP_STEP_S]
