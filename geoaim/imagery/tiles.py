"""XYZ tiles in web Mercator: their names, numbers, corners and zoom levels."""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.imagery.rasters import Region

MERCATOR = "EPSG:3857"
HALF_WORLD_M = 20037508.342789244  # distance from the origin of that CRS to its edges
MAX_ZOOM = 30
ZOOM_TOLERANCE = 0.02  # levels by which a zoom may be too coarse: 1.4 % of the resolution
NUMBERS = r"(\d+){0}(\d+){0}(\d+)\.(?:png|jpe?g|webp)$"
NESTED = re.compile("(?:^|/)" + NUMBERS.format("/"), re.IGNORECASE)  # z/x/y.png
FLAT = re.compile("(?:^|[^0-9])" + NUMBERS.format("-"), re.IGNORECASE)  # NAME-x-y-z.png
Georeference = tuple[str, Float[Array, "3 3"]]  # CRS, and the unit square to coordinates in it


@dataclass(frozen=True)
class Tiles:
    """Square tiles in web Mercator (EPSG:3857), and how to read them."""

    # a folder of `z/x/y.png` or `NAME-x-y-z.png` (or jpg, jpeg, webp), an MBTiles file, or a
    # service's address with {z}, {x} and {y}
    path: str | os.PathLike[str]
    # level to read; when None, the coarsest that is not coarser than the wanted resolution, or else
    # the finest that exists
    zoom: int | None = None
    tms: bool = False  # whether y counts from the south, as in the Tile Map Service scheme
    tile_size: int = 256  # side of a service's tile, pixels
    # folder in which a service's tiles are kept for 30 days
    cache: str | os.PathLike[str] = "~/.cache/geoaim/tiles"


def list_tiles(folder: Path, tms: bool) -> Iterator[tuple[int, int, int, str]]:
    """Yield zoom, x, y and path of each tile in a folder; y counts from the north.

    `tms` says that y counts from the south in the files' names.
    """
    for file in folder.rglob("*"):
        name = file.relative_to(folder.parent).as_posix()
        nested, flat = NESTED.search(name), FLAT.search(name)
        if nested:
            zoom, x, y = map(int, nested.groups())
        elif flat:
            x, y, zoom = map(int, flat.groups())
        else:
            continue
        if zoom <= MAX_ZOOM and max(x, y) < 2**zoom:
            yield zoom, x, 2**zoom - 1 - y if tms else y, str(file)


def intersect_tiles(tiles: Int[Array, "n 3"], region: Region | None) -> Bool[Array, "n"]:
    """Mark the tiles (zoom, x, y) that show a part of a region; all of them if it is None."""
    if region is None:
        return np.ones(len(tiles), bool)
    low, high = compute_world_fractions(region)
    size = np.exp2(tiles[:, :1])
    return ((tiles[:, 1:] + 1 > low * size) & (tiles[:, 1:] < high * size)).all(axis=1)


def compute_world_fractions(region: Region) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Compute the least and greatest (x, y) of a region, from 0 to 1 over web Mercator."""
    shares = (region.to_crs(MERCATOR) * [1.0, -1.0] + HALF_WORLD_M) / (2.0 * HALF_WORLD_M)
    return shares.min(axis=0), shares.max(axis=0)


def compute_tile_corners(zoom: int, low: Array, high: Array) -> Float[Array, "4 2"]:
    """Compute the corners of a block of tiles."""
    (left, top), (right, bottom) = (np.stack([low, high]) / 2.0**zoom * 2.0 - 1.0) * HALF_WORLD_M
    return np.array([[left, -top], [right, -top], [right, -bottom], [left, -bottom]])


def georeference_tile(zoom: int, x: int, y: int) -> Georeference:
    """Georeference a tile."""
    side = 2.0 * HALF_WORLD_M / 2**zoom
    left, top = x * side - HALF_WORLD_M, HALF_WORLD_M - y * side
    return MERCATOR, np.array([[side, 0.0, left], [0.0, -side, top], [0.0, 0.0, 1.0]])


def choose_zoom(
    tiles: Tiles, levels: Int[Array, "n"], region: Region | None, resolution: float | None
) -> int:
    """Choose the coarsest zoom level that is not coarser than wanted, or else the finest."""
    if tiles.zoom is not None:
        return tiles.zoom
    if resolution is None or region is None:
        return int(levels.max())
    low, high = compute_world_fractions(region)
    latitude = np.arctan(np.sinh(np.pi * (1.0 - low[1] - high[1])))
    pixel = 2.0 * HALF_WORLD_M * np.cos(latitude) / tiles.tile_size  # metres, at zoom 0
    fine = levels[levels >= np.log2(pixel / resolution) - ZOOM_TOLERANCE]
    return int(fine.min() if fine.size else levels.max())


def make_quadkey(zoom: int, x: int, y: int) -> str:
    """Make the quadkey of a tile: a digit for each zoom level, of the bits of x and y.

    >>> make_quadkey(3, 3, 5)
    '213'
    """
    digits = (
        ((x >> level) & 1) + 2 * ((y >> level) & 1) for level in reversed(range(max(zoom, 0)))
    )
    return "".join(map(str, digits))
