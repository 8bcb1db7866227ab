"""Pictures to a file that people look at: a film or a single picture."""

import os
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import av
from jaxtyping import UInt8
from numpy import ndarray as Array
from PIL import Image

from geoaim.files import replacing

ENDINGS = (".mp4", ".gif", ".png")


def write_pictures(
    pictures: Iterable[UInt8[Array, "H W 3"]], path: str | os.PathLike[str], *, rate: float
) -> None:
    """Write .mp4 (even sides), .gif or .png (the first picture), so many pictures a second.

    Raises:
        ValueError: the name ends otherwise, or there are no pictures.
    """
    path, every = Path(path), iter(pictures)
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"{path}: the name must end in {', '.join(ENDINGS)}")
    first = next(every, None)
    if first is None:
        raise ValueError(f"no pictures to write to {path}")
    with replacing(path) as temporary:
        if path.suffix.lower() == ".mp4":
            _write_film(first, every, temporary, rate)
        elif path.suffix.lower() == ".gif":
            rest = [Image.fromarray(picture) for picture in every]
            start = Image.fromarray(first)
            start.save(temporary, save_all=True, append_images=rest, duration=1000 / rate, loop=0)
        else:
            Image.fromarray(first).save(temporary)


def _write_film(
    first: UInt8[Array, "H W 3"], rest: Iterator[UInt8[Array, "H W 3"]], path: Path, rate: float
) -> None:
    every = Fraction(rate).limit_denominator(1001)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", every)
        stream.pix_fmt, (stream.height, stream.width) = "yuv420p", first.shape[:2]
        for number, picture in enumerate((first, *rest)):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = number, 1 / every
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
