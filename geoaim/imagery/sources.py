"""What a source of imagery names, as rasters: files, folders, tiles and tile services."""

import glob
import os
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoaimWarning, ImageryError
from geoaim.imagery.rasters import Raster, describe_raster, raster_outline
from geoaim.world import World, crs_from_world

MERCATOR = "EPSG:3857"
HALF_WORLD = 20037508.342789244  # m in that CRS, from the middle to an edge
DEEPEST = 30  # zoom level
TILE = r"(\d+){0}(\d+){0}(\d+)\.(?:png|jpe?g|webp)$"
TREE = re.compile("(?:^|/)" + TILE.format("/"), re.IGNORECASE)  # z/x/y.png
FLAT = re.compile("(?:^|[^0-9])" + TILE.format("-"), re.IGNORECASE)  # NAME-x-y-z.png
ADDRESS = re.compile("<|://|^/vsi|^[A-Z0-9_]{2,}:")  # what GDAL opens and is no file's path
SERVICE = """<GDAL_WMS>
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
</GDAL_WMS>"""


@dataclass(frozen=True)
class Tiles:
    """Square tiles in web Mercator (EPSG:3857), with what can be said about how to read them.

    Attributes:
        path: a folder of `z/x/y.png` or `NAME-x-y-z.png` (or jpg, jpeg, webp), an MBTiles file,
            or a service's address with {z}, {x} and {y}.
        zoom: the level to read; when None, the coarsest that is not coarser than the wanted
            resolution, or else the finest of those at hand.
        upside_down: whether y counts from the south, as TMS does.
        tile_size: of a service, pixels.
        cache: folder in which a service's tiles are kept for 30 days.
        timeout: of a service, seconds.
        retries: of a service, how often a failed read is tried again.
    """

    path: str | os.PathLike[str]
    zoom: int | None = None
    upside_down: bool = False
    tile_size: int = 256
    cache: str | os.PathLike[str] = "~/.cache/geoaim/tiles"
    timeout: int = 20
    retries: int = 2


@dataclass(frozen=True, eq=False)
class Area:
    """Where imagery is wanted.

    Attributes:
        world: the plane it is wanted in.
        points: (M, 2) points over all of the area, world metres.
    """

    world: World
    points: Float[Array, "m 2"]

    def within(self, crs: str) -> Float[Array, "m 2"]:
        """The points in a CRS."""
        return crs_from_world(self.world, self.points, crs)


@dataclass(frozen=True, eq=False)
class Layer:
    """What one source gives.

    Attributes:
        name: as messages and reports call it.
        rasters: all that it names, or of tiles, those in the area.
        outlines: CRS and points along the edges of all that it has, wherever it lies.
        zoom: of tiles.
        whole: it is a single file or a service, which is read or refused: of many files, those
            that cannot be read are left out with a warning.
        unreadable: names of those that were left out.
    """

    name: str
    rasters: tuple[Raster, ...]
    outlines: tuple[tuple[str, Float[Array, "m 2"]], ...]
    zoom: int | None = None
    whole: bool = False
    unreadable: tuple[str, ...] = ()


Source = str | os.PathLike[str] | Tiles


def find_layer(
    source: Source,
    area: Area | None,
    *,
    resolution: float | None = None,
    crs: str | None = None,
    bands: Sequence[int] | None = None,
) -> Layer:
    """The rasters that a source names.

    Args:
        source: a file, a folder, a pattern with `*`, tiles, a service's address with {z}, {x}
            and {y}, or anything that GDAL opens.
        area: where imagery is wanted; None means all there is.
        resolution: metres a pixel that is wanted, by which tiles choose their zoom.
        crs: of rasters that name none.
        bands: numbers of one or three bands, from 1.

    Raises:
        FileNotFoundError: no such file or folder, or nothing matches.
        ImageryError: it is no imagery, or lacks what it would need to be placed.
    """
    tiles = source if isinstance(source, Tiles) else Tiles(source)
    path = os.fspath(tiles.path)
    if "{z}" in path and "{x}" in path and "y}" in path:
        return _service(tiles, path, area, resolution)
    describe = _describer(crs, bands)
    if Path(path).is_dir():
        numbered = sorted(_numbered(Path(path), tiles.upside_down))
        if numbered:
            return _tile_layer(tiles, numbered, area, resolution, describe)
        files = [f for f in sorted(Path(path).rglob("*")) if f.suffix.lower() in {".tif", ".tiff"}]
        return _file_layer(path, [str(file) for file in files], describe)
    if not os.path.exists(path) and not ADDRESS.search(path):
        if not any(sign in path for sign in "*?["):
            raise FileNotFoundError(f"{path}: no such file")
        return _file_layer(path, sorted(glob.glob(path, recursive=True)), describe)
    return _single(tiles, path, crs, bands)


Describer = Callable[[str, "tuple[str, Float[Array, '3 3']] | None"], Raster]


def _describer(crs: str | None, bands: Sequence[int] | None) -> Describer:
    return lambda path, place: describe_raster(path, crs=crs, bands=bands, place=place)


def _single(tiles: Tiles, path: str, crs: str | None, bands: Sequence[int] | None) -> Layer:
    options = {} if tiles.zoom is None else {"ZOOM_LEVEL": tiles.zoom}
    if options and not path.lower().endswith(".mbtiles"):
        raise ImageryError(f"{path} holds no tiles by zoom levels; read it without zoom")
    raster = describe_raster(path, crs=crs, bands=bands, options=options)
    outlines = ((raster.crs, raster_outline(raster)),)
    return Layer(_shown(path), (raster,), outlines, zoom=tiles.zoom, whole=True)


def _file_layer(name: str, files: Sequence[str], describe: Describer) -> Layer:
    if not files:
        raise FileNotFoundError(
            f"{name}: no file there; needed are GeoTIFFs, tiles named z/x/y.png or NAME-x-y-z.png, "
            "or, for other files, a pattern such as folder/*.jpg"
        )
    rasters, unreadable = _describe_all(((file, None) for file in files), describe, name)
    outlines = tuple((raster.crs, raster_outline(raster)) for raster in rasters)
    return Layer(name, rasters, outlines, unreadable=unreadable)


def _describe_all(
    files: Iterable[tuple[str, tuple[str, Float[Array, "3 3"]] | None]],
    describe: Describer,
    name: str,
) -> tuple[tuple[Raster, ...], tuple[str, ...]]:
    rasters, unreadable = [], []
    for file, place in files:
        try:
            rasters.append(describe(file, place))
        except ImageryError as error:
            unreadable.append((file, error))
    if unreadable and not rasters:
        raise ImageryError(
            f"none of the {len(unreadable)} file(s) of {name} can be read: {unreadable[0][1]}"
        )
    for _, reason in unreadable:
        warnings.warn(f"left as a hole: {reason}", GeoaimWarning, stacklevel=2)
    return tuple(rasters), tuple(file for file, _ in unreadable)


def _numbered(folder: Path, upside_down: bool) -> Iterator[tuple[int, int, int, str]]:
    """Zoom, x, y from the north, and path of each tile."""
    for file in folder.rglob("*"):
        inside = file.relative_to(folder.parent).as_posix()
        tree, flat = TREE.search(inside), FLAT.search(inside)
        if tree:
            zoom, x, y = map(int, tree.groups())
        elif flat:
            x, y, zoom = map(int, flat.groups())
        else:
            continue
        if zoom <= DEEPEST and max(x, y) < 2**zoom:
            yield zoom, x, 2**zoom - 1 - y if upside_down else y, str(file)


def _tile_layer(
    tiles: Tiles,
    numbered: Sequence[tuple[int, int, int, str]],
    area: Area | None,
    resolution: float | None,
    describe: Describer,
) -> Layer:
    name = os.fspath(tiles.path)
    found = np.array([tile[:3] for tile in numbered])
    inside = _in_area(found, area)
    levels = found[inside if inside.any() else slice(None), 0]
    zoom = _choose_zoom(tiles, np.unique(levels), area, resolution)
    if zoom not in levels:
        raise ImageryError(
            f"{name} has no tile of zoom {zoom} there; it has {np.unique(levels).tolist()}"
        )
    level = found[found[:, 0] == zoom]
    edges = _bounds(zoom, level[:, 1:].min(axis=0), level[:, 1:].max(axis=0) + 1)
    chosen = [tile for tile, use in zip(numbered, inside, strict=True) if use and tile[0] == zoom]
    places = ((path, (MERCATOR, _tile_place(z, x, y))) for z, x, y, path in chosen)
    rasters, unreadable = _describe_all(places, describe, name)
    return Layer(name, rasters, ((MERCATOR, edges),), zoom=zoom, unreadable=unreadable)


def _in_area(found: Array, area: Area | None) -> Array:
    if area is None:
        return np.ones(len(found), bool)
    low, high = _tile_range(area)
    size = np.exp2(found[:, :1])
    return ((found[:, 1:] + 1 > low * size) & (found[:, 1:] < high * size)).all(axis=1)


def _tile_range(area: Area) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """The area from the world's north-western corner, in its sides: least and most x and y."""
    shares = (area.within(MERCATOR) * [1.0, -1.0] + HALF_WORLD) / (2.0 * HALF_WORLD)
    return shares.min(axis=0), shares.max(axis=0)


def _bounds(zoom: int, low: Array, high: Array) -> Float[Array, "4 2"]:
    """Corners of a range of tiles in EPSG:3857."""
    (left, top), (right, bottom) = (np.stack([low, high]) / 2.0**zoom * 2.0 - 1.0) * HALF_WORLD
    return np.array([[left, -top], [right, -top], [right, -bottom], [left, -bottom]])


def _tile_place(zoom: int, x: int, y: int) -> Float[Array, "3 3"]:
    side = 2.0 * HALF_WORLD / 2**zoom
    left, top = x * side - HALF_WORLD, HALF_WORLD - y * side
    return np.array([[side, 0.0, left], [0.0, -side, top], [0.0, 0.0, 1.0]])


def _choose_zoom(tiles: Tiles, levels: Array, area: Area | None, resolution: float | None) -> int:
    """The coarsest of the levels that is not coarser than wanted (by 1.4 % at most)."""
    if tiles.zoom is not None:
        return tiles.zoom
    if resolution is None or area is None:
        return int(levels.max())
    low, high = _tile_range(area)
    latitude = np.arctan(np.sinh(np.pi * (1.0 - low[1] - high[1])))
    pixel = 2.0 * HALF_WORLD * np.cos(latitude) / tiles.tile_size
    fine = levels[levels >= np.log2(pixel / resolution) - 0.02]
    return int(fine.min() if fine.size else levels.max())


def _service(tiles: Tiles, address: str, area: Area | None, resolution: float | None) -> Layer:
    name = _shown(address)
    if "://" not in address:
        raise ImageryError(f"{name} is no service's address, and of files the folder is needed")
    if area is None or (resolution is None and tiles.zoom is None):
        raise ImageryError(
            f"{name} is a service for all of the world, and does not say how fine it is: give the "
            "world, the corners, and a resolution or Tiles(..., zoom=...)"
        )
    zoom = _choose_zoom(tiles, np.arange(DEEPEST), area, resolution)
    low, high = (limit * 2.0**zoom for limit in _tile_range(area))
    low = np.clip(np.floor(low) - 1, 0, 2**zoom - 1).astype(int)
    high = np.clip(np.ceil(high) + 1, low + 1, 2**zoom).astype(int)
    upside_down = tiles.upside_down or "{-y}" in address
    if upside_down:  # GDAL counts from the window's lower edge
        high[1] = 2**zoom
    corners = _bounds(zoom, low, high)
    xml = SERVICE.format(
        **_where(tiles, address),
        **dict(
            zip(("left", "top", "right", "bottom"), corners[[0, 2]].ravel().tolist(), strict=True)
        ),
        width=(high - low)[0] * tiles.tile_size,
        height=(high - low)[1] * tiles.tile_size,
        zoom=zoom,
        x=low[0],
        y=0 if upside_down else low[1],
        origin="bottom" if upside_down else "top",
    )
    raster = replace(describe_raster(xml), name=name, retries=tiles.retries)
    return Layer(name, (raster,), ((MERCATOR, corners),), zoom=zoom, whole=True)


def _where(tiles: Tiles, address: str) -> dict[str, str | int]:
    address = re.sub(r"\{-?([xyz])\}", r"${\1}", address).replace("{s}", "a")
    return {
        "url": escape(address),
        "tile": tiles.tile_size,
        "timeout": tiles.timeout,
        "cache": escape(str(Path(tiles.cache).expanduser())),
    }


def _shown(address: str) -> str:
    """An address without what follows "?", where keys stand."""
    return address.split("?")[0] if "://" in address else address
