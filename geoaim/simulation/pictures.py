"""Pictures to a file that people look at: a film or a single picture."""

import os
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

from jaxtyping import UInt8
from numpy import ndarray as Array
from PIL import Image

from geoaim.encode import write_video
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
    if path.suffix.lower() == ".mp4":
        write_video(chain([first], every), path, frame_rate=rate)
        return
    with replacing(path) as temporary:
        if path.suffix.lower() == ".gif":
            rest = [Image.fromarray(picture) for picture in every]
            start = Image.fromarray(first)
            start.save(temporary, save_all=True, append_images=rest, duration=1000 / rate, loop=0)
        else:
            Image.fromarray(first).save(temporary)
