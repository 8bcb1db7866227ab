"""Web map tiles: their numbers, their places in EPSG:3857, zoom levels, and tile services."""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.imagery.region import Region

MERCATOR = "EPSG:3857"
HALF_WORLD_M = 20037508.342789244  # from the middle of that CRS to its edges
MAX_ZOOM = 30
ZOOM_TOLERANCE = 0.02  # levels by which a zoom may be too coarse: 1.4 % of the resolution
NUMBERS = r"(\d+){0}(\d+){0}(\d+)\.(?:png|jpe?g|webp)$"
NESTED = re.compile("(?:^|/)" + NUMBERS.format("/"), re.IGNORECASE)  # z/x/y.png
FLAT = re.compile("(?:^|[^0-9])" + NUMBERS.format("-"), re.IGNORECASE)  # NAME-x-y-z.png
SERVICE_XML = """<GDAL_WMS>
<Service name="TMS"><ServerUrl>{url}</ServerUrl></Service>
<DataWindow>
<UpperLeftX>{left!r}</UpperLeftX><UpperLeftY>{top!r}</UpperLeftY>
<LowerRightX>{right!r}</LowerRightX><LowerRightY>{bottom!r}</LowerRightY>
<SizeX>{width}</SizeX><SizeY>{height}</SizeY>
<TileLevel>{zoom}</TileLevel><TileX>{x}</TileX><TileY>{y}</TileY><YOrigin>{origin}</YOrigin>
</DataWindow>
<Projection>EPSG:3857</Projection><BandsCount>4</BandsCount>
<BlockSizeX>{tile}</BlockSizeX><BlockSizeY>{tile}</BlockSizeY><OverviewCount>0</OverviewCount>
<Timeout>{timeout}</Timeout><MaxConnections>4</MaxConnections><UserAgent>geoaim</UserAgent>
<ZeroBlockHttpCodes>204,404</ZeroBlockHttpCodes>
<Cache><Path>{cache}</Path><Expires>2592000</Expires><MaxSize>2000000000</MaxSize></Cache>
</GDAL_WMS>"""  # https://gdal.org/drivers/raster/wms.html


@dataclass(frozen=True)
class Tiles:
    """Square tiles in web Mercator (EPSG:3857), and how to read them.

    Attributes:
        path: a folder of `z/x/y.png` or `NAME-x-y-z.png` (or jpg, jpeg, webp), an MBTiles file,
            or a service's address with {z}, {x} and {y}.
        zoom: level to read; when None, the coarsest that is not coarser than the wanted
            resolution, or else the finest that exists.
        tms: whether y counts from the south, as in the Tile Map Service scheme.
        tile_size: of a service, pixels.
        cache: folder in which a service's tiles are kept for 30 days.
        timeout: of a service, seconds.
        retries: how often a failed read of a service is repeated.
    """

    path: str | os.PathLike[str]
    zoom: int | None = None
    tms: bool = False
    tile_size: int = 256
    cache: str | os.PathLike[str] = "~/.cache/geoaim/tiles"
    timeout: int = 20
    retries: int = 2


def number_tiles(folder: Path, tms: bool) -> Iterator[tuple[int, int, int, str]]:
    """Zoom, x, y from the north, and path of each tile in a folder."""
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
    """Which tiles (zoom, x, y) show a part of a region; None: all do."""
    if region is None:
        return np.ones(len(tiles), bool)
    low, high = compute_world_fractions(region)
    size = np.exp2(tiles[:, :1])
    return ((tiles[:, 1:] + 1 > low * size) & (tiles[:, 1:] < high * size)).all(axis=1)


def compute_world_fractions(region: Region) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Least and greatest x and y of a region, as fractions of the map from its north-west corner.

    Multiplied by 2^zoom they are tile numbers.
    """
    shares = (region.to_crs(MERCATOR) * [1.0, -1.0] + HALF_WORLD_M) / (2.0 * HALF_WORLD_M)
    return shares.min(axis=0), shares.max(axis=0)


def compute_tile_corners(zoom: int, low: Array, high: Array) -> Float[Array, "4 2"]:
    """Compute the corners of a range of tiles.

    Args:
        zoom: level of the tiles.
        low: (2,) first x and y.
        high: (2,) last x and y, plus one.

    Returns:
        (4, 2) metres in EPSG:3857: top-left, top-right, bottom-right, bottom-left.
    """
    (left, top), (right, bottom) = (np.stack([low, high]) / 2.0**zoom * 2.0 - 1.0) * HALF_WORLD_M
    return np.array([[left, -top], [right, -top], [right, -bottom], [left, -bottom]])


def georeference_tile(zoom: int, x: int, y: int) -> tuple[str, Float[Array, "3 3"]]:
    """Georeference a tile.

    Args:
        zoom: level of the tile.
        x: column, from the west.
        y: row, from the north.

    Returns:
        EPSG:3857, and the (3, 3) matrix from the unit square over the tile to metres in it.
    """
    side = 2.0 * HALF_WORLD_M / 2**zoom
    left, top = x * side - HALF_WORLD_M, HALF_WORLD_M - y * side
    return MERCATOR, np.array([[side, 0.0, left], [0.0, -side, top], [0.0, 0.0, 1.0]])


def choose_zoom(
    tiles: Tiles, levels: Int[Array, "n"], region: Region | None, resolution: float | None
) -> int:
    """Choose the coarsest zoom level that is not coarser than the wanted resolution.

    Args:
        tiles: whose zoom is taken when it is given.
        levels: that exist.
        region: where the resolution is wanted.
        resolution: metres a pixel.

    Returns:
        The level; the finest one when all are coarser, or no resolution is wanted.
    """
    if tiles.zoom is not None:
        return tiles.zoom
    if resolution is None or region is None:
        return int(levels.max())
    low, high = compute_world_fractions(region)
    latitude = np.arctan(np.sinh(np.pi * (1.0 - low[1] - high[1])))
    pixel = 2.0 * HALF_WORLD_M * np.cos(latitude) / tiles.tile_size  # metres, at zoom 0
    fine = levels[levels >= np.log2(pixel / resolution) - ZOOM_TOLERANCE]
    return int(fine.min() if fine.size else levels.max())


def describe_service(
    tiles: Tiles, address: str, zoom: int, region: Region
) -> tuple[str, Float[Array, "4 2"]]:
    """Describe the part of a tile service that shows a region as one raster for GDAL.

    Args:
        tiles: how to read the service.
        address: of the service, with {z}, {x} and {y} (or {-y}, counted from the south).
        zoom: level to read.
        region: to cover, with a tile more on each side.

    Returns:
        XML that GDAL opens as a raster, and its (4, 2) corners in EPSG:3857.
    """
    low, high = (limit * 2.0**zoom for limit in compute_world_fractions(region))
    low = np.clip(np.floor(low) - 1, 0, 2**zoom - 1).astype(int)
    high = np.clip(np.ceil(high) + 1, low + 1, 2**zoom).astype(int)
    tms = tiles.tms or "{-y}" in address
    if tms:
        high[1] = 2**zoom  # GDAL counts from the window's lower edge
    corners = compute_tile_corners(zoom, low, high)
    (left, top), (right, bottom) = corners[[0, 2]].tolist()
    width, height = (high - low) * tiles.tile_size
    xml = SERVICE_XML.format(
        url=escape(re.sub(r"\{-?([xyz])\}", r"${\1}", address).replace("{s}", "a")),
        tile=tiles.tile_size,
        timeout=tiles.timeout,
        cache=escape(str(Path(tiles.cache).expanduser())),
        left=left,
        top=top,
        right=right,
        bottom=bottom,
        width=width,
        height=height,
        zoom=zoom,
        x=low[0],
        y=0 if tms else low[1],
        origin="bottom" if tms else "top",
    )
    return xml, corners
