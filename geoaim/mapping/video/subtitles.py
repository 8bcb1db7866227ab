"""Telemetry in the subtitles inside a video, as drones write it that make no .SRT."""

import re
from pathlib import Path

from geoaim.mapping.video.decoding import open_container
from geoaim.mapping.video.srt import parse_srt
from geoaim.mapping.video.telemetry import Telemetry


def read_subtitles(path: Path, start: float) -> Telemetry | None:
    """Read telemetry from the first subtitles of a video that state places; None: there are none.

    Args:
        path: the video.
        start: presentation time of the video's first frame, seconds.

    Raises:
        GeoreferenceError: as of `read_srt`.
    """
    with open_container(path) as container:
        for stream in container.streams.subtitles:
            is_mov = stream.codec_context is not None and stream.codec_context.name == "mov_text"
            entries = list[str]()
            for packet in container.demux(stream):
                if packet.size and packet.pts is not None:
                    time = float(packet.pts * packet.time_base) - start
                    entries.append(_format_entry(len(entries) + 1, time, bytes(packet), is_mov))
            text = "".join(entries)
            if re.search(r"\blatitude\b|\bGPS\s*\(", text):  # others are no telemetry
                return parse_srt(text, f"{path}, its subtitles")
            container.seek(0)
    return None


def _format_entry(number: int, time: float, content: bytes, is_mov: bool) -> str:
    """Format an entry as in an .SRT; those of MP4 begin with their length in two bytes."""
    if is_mov:
        content = content[2 : 2 + int.from_bytes(content[:2], "big")]
    milliseconds = max(0, round(time * 1000))
    minutes, milliseconds = divmod(milliseconds, 60_000)
    clock = f"{minutes // 60:02d}:{minutes % 60:02d}:{milliseconds // 1000:02d}"
    text = content.decode("utf-8", errors="replace").replace("-->", "")
    return f"{number}\n{clock},{milliseconds % 1000:03d} --> \n{text}\n\n"
