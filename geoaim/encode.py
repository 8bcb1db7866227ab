"""Frames to a video file."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.files import atomic_write


def write_video(
    frames: Iterable[UInt8[Array, "H W 3"]],
    path: Path,
    *,
    frame_rate: float = 30,
    crf: int = 20,
    megabits: float | None = None,
) -> Path:
    """Encode frames to H.264, yuv420p, with a keyframe each second; the file appears when done.

    At constant quality `crf`, or at about so many megabits a second.
    """
    rate = Fraction(frame_rate).limit_denominator(1001)
    with atomic_write(path) as part, av.open(str(part), "w") as container:
        second = str(round(frame_rate))
        options = {"preset": "medium", "g": second, "keyint_min": second}
        options |= {"b": f"{megabits}M"} if megabits else {"crf": str(crf)}
        stream = container.add_stream("libx264", rate, options=options | {"sc_threshold": "0"})
        stream.pix_fmt = "yuv420p"
        for index, frame in enumerate(frames):
            if index == 0:
                stream.height, stream.width = frame.shape[:2]
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
            picture.pts, picture.time_base = index, 1 / rate
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path
