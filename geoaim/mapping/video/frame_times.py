"""The times of all frames of a video file, read without decoding one."""

from contextlib import suppress
from pathlib import Path

import av
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.mapping.video.containers import open_container, select_stream

MAX_UNEVENNESS = 0.01  # of steps between evenly spaced frames, as a share
TIMESTAMP_STEP_S = 1e-3  # Matroska rounds timestamps to milliseconds


def read_frame_times(path: Path, start: float) -> Float[Array, " N"]:
    """Read the times of all frames without decoding one.

    MP4 and MOV have an index of decoding times, which are as far apart as presentation times where
    frames are evenly spaced or are not reordered; otherwise the packets of the file are read.
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
