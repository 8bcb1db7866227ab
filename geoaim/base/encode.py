"""Frames -> video file."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.base.files import atomic_write


def write_video(
    frames: Iterable[UInt8[Array, "H W 3"]],
    path: Path,
    *,
    frame_rate: float = 30,
    crf: int = 20,
    megabits: float | None = None,
    keyframe_interval: int | None = None,
) -> Path:
    """Encode RGB frames of one size with even sides as H.264 (yuv420p); returns `path`.

    The quality is a constant rate factor (`crf`, 0 to 51, lower is better) or a bit rate
    (`megabits`, Mbit/s); None for `keyframe_interval` are the frames of one second.
    """
    rate = Fraction(frame_rate).limit_denominator(1001)
    with atomic_write(path) as temporary, av.open(str(temporary), "w") as container:
        interval = str(keyframe_interval or round(frame_rate))
        options = {"preset": "medium", "g": interval, "keyint_min": interval, "sc_threshold": "0"}
        options |= {"b": f"{megabits}M"} if megabits else {"crf": str(crf)}
        stream = container.add_stream("libx264", rate, options=options)
        stream.pix_fmt = "yuv420p"
        # with two x264 gives other bytes in most runs, with as many as cores on each machine
        stream.thread_count = 1
        for index, frame in enumerate(frames):
            if index == 0:
                stream.height, stream.width = frame.shape[:2]
                if stream.height % 4:  # else x264 reads beyond its picture of half the size
                    stream.codec_context.options = options | {"mbtree": "0"}
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
            picture.pts, picture.time_base = index, 1 / rate
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path
