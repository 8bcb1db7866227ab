"""Containers of video files: open them, choose the video stream, list the times of its frames."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import av
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import VideoError
from geoaim.base.limits import check_regular

# FFmpeg's containers and raw streams; playlists and lists of files would name others
FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc,av1,obu,ivf,"
    "flv,live_flv,asf,ogg,mjpeg,mxf,gif,dv,wtv,nut"
)
READ_OPTIONS = {"format_whitelist": FORMATS, "protocol_whitelist": "file"}
MAX_UNEVENNESS = 0.01  # of steps between evenly spaced frames, as a share
TIMESTAMP_STEP_S = 1e-3  # Matroska rounds timestamps to milliseconds


def open_container(path: Path) -> Any:
    """Open a video file, as PyAV's container.

    Raises:
        VideoError: FFmpeg cannot read it.
    """
    check_regular(path, VideoError)
    try:
        return av.open(f"file:{path}", options=READ_OPTIONS, metadata_errors="replace")
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
    """Select the video stream of a container, which `threads` decode.

    Raises:
        VideoError: it has no video, or an unknown codec.
    """
    cover = av.stream.Disposition.attached_pic
    streams = [stream for stream in container.streams.video if not stream.disposition & cover]
    if not streams:
        kinds = ", ".join(sorted({one.type for one in container.streams})) or "no stream at all"
        raise VideoError(f"{path}: no video in this file, but {kinds}; give a video file")
    if streams[0].codec_context is None:
        raise VideoError(f"{path}: its codec is unknown to FFmpeg; convert the file to H.264")
    streams[0].thread_type = "AUTO"
    if threads is not None:
        streams[0].thread_count = threads
    return streams[0]


def read_frame_count(container: Any, stream: Any, rate: float) -> tuple[int, bool]:
    """Number of frames that the file states, and whether it is a count, not a duration."""
    if stream.frames and "mov" in container.format.name:  # an edit list may hide some of them
        return sum(not entry.is_discard for entry in stream.index_entries), True
    if stream.frames:
        return stream.frames, True
    if stream.duration is not None:
        return round(stream.duration * stream.time_base * rate), False
    return round((container.duration or 0) / av.time_base * rate), False


def read_frame_times(path: Path, start: float) -> Float[Array, " N"]:
    """Read the times of all frames without decoding one.

    MP4 and MOV have an index of decoding times, which are as far apart as presentation times where
    frames are evenly spaced or are not reordered; otherwise the packets of the file are read.

    Args:
        path: the file.
        start: presentation time of the first frame, seconds.

    Returns:
        (N) seconds since the first frame, increasing.
    """
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
