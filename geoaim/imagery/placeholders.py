"""Tiles that show no ground: the same picture again and again, such as "not available"."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geoaim.base.errors import warn
from geoaim.base.raster_files import open_raster_file

TileFile = tuple[int, int, Path]  # x, y and file


def leave_out_placeholders(tiles: Sequence[TileFile], name: str) -> list[TileFile]:
    """Leave out tiles whose pixels are those of another tile, with a warning.

    Ground that a camera sees never repeats to the last grey level; what does is the picture by
    which a service says that it has none, or an area without any detail.
    """
    sizes = Counter(file.stat().st_size for _, _, file in tiles)
    # A file of another size may hold the same pixels, but then it is of another encoder.
    suspects = [tile for tile in tiles if sizes[tile[2].stat().st_size] > 1]
    pictures = {tile: _hash_pixels(tile[2]) for tile in suspects}
    counts = Counter(pictures.values())
    repeated = {tile for tile, picture in pictures.items() if picture and counts[picture] > 1}
    if repeated:
        warn(
            f"{name}: {len(repeated)} of {len(tiles)} tiles are the same picture as another one, "
            "as 'no imagery here' is, or plain water; they are left out and their area stays empty"
        )
    return [tile for tile in tiles if tile not in repeated]


def _hash_pixels(file: Path) -> str:
    """Hash the pixels of a picture; "" where it is transparent, or cannot be read."""
    try:
        with open_raster_file(file) as dataset:
            pixels = np.ascontiguousarray(dataset.read())
    except Exception:  # GDAL's errors are of several kinds; the reader of the tile reports them
        return ""
    if len(pixels) in (2, 4) and not pixels[-1].any():
        return ""
    return hashlib.sha256(pixels.tobytes() + str(pixels.shape).encode()).hexdigest()
