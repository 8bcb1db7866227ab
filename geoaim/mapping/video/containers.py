"""Containers of video files: open them, choose the video stream, count its frames."""

from pathlib import Path
from typing import Any

import av

from geoaim.base.errors import VideoError
from geoaim.base.limits import check_regular

# FFmpeg's containers and raw streams; playlists and lists of files would name others
FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc,av1,obu,ivf,"
    "flv,live_flv,asf,ogg,mjpeg,mxf,gif,dv,wtv,nut"
)
READ_OPTIONS = {"format_whitelist": FORMATS, "protocol_whitelist": "file"}


def open_container(path: Path) -> Any:
    """Open a video file, as PyAV's container."""
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
    """Select the video stream of a container."""
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
    """Read the number of frames that a file states."""
    if stream.frames and "mov" in container.format.name:  # an edit list may hide some of them
        return sum(not entry.is_discard for entry in stream.index_entries), True
    if stream.frames:
        return stream.frames, True
    if stream.duration is not None:
        return round(stream.duration * stream.time_base * rate), False
    return round((container.duration or 0) / av.time_base * rate), False
