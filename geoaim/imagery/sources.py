"""Sources of imagery as rasters: files, folders, patterns, tiles and tile services."""

import glob
import os
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoaimWarning, ImageryError
from geoaim.imagery.rasters import Raster, describe_raster, outline_raster
from geoaim.imagery.region import Outline, Region
from geoaim.imagery.tiles import (
    MAX_ZOOM,
    MERCATOR,
    Tiles,
    choose_zoom,
    compute_tile_corners,
    describe_service,
    georeference_tile,
    intersect_tiles,
    number_tiles,
)

GDAL_STRING = re.compile("<|://|^/vsi|^[A-Z0-9_]{2,}:")  # what GDAL opens that is not a file
GEOTIFF_SUFFIXES = {".tif", ".tiff"}

Source = str | os.PathLike[str] | Tiles
Georeference = tuple[str, Float[Array, "3 3"]]  # CRS, and the unit square to coordinates in it
Describer = Callable[[str, Georeference | None], Raster]


@dataclass(frozen=True, eq=False)
class Layer:
    """The rasters of one source.

    Attributes:
        name: of the source in messages and reports.
        rasters: all of them, or the tiles that show the region.
        outlines: of all that the source has, wherever it lies.
        zoom: of tiles.
        single: whether it is one file or service. That one must be readable; of many files, those
            that cannot be read are left out with a warning.
        unreadable: names of the files that were left out.
    """

    name: str
    rasters: tuple[Raster, ...]
    outlines: tuple[Outline, ...]
    zoom: int | None = None
    single: bool = False
    unreadable: tuple[str, ...] = ()


def describe_source(
    source: Source,
    region: Region | None,
    *,
    resolution: float | None = None,
    crs: str | None = None,
    bands: Sequence[int] | None = None,
) -> Layer:
    """List the rasters of a source.

    Args:
        source: a file, a folder, a pattern with `*`, tiles, a service's address with {z}, {x}
            and {y}, or anything that GDAL opens.
        region: where imagery is wanted; everywhere when None.
        resolution: wanted metres a pixel, for the zoom level of tiles.
        crs: for rasters that name no CRS.
        bands: numbers of one or three bands, from 1.

    Returns:
        The rasters; of tiles, only those that show the region.

    Raises:
        FileNotFoundError: there is no such file or folder, or nothing matches the pattern.
        ImageryError: it is not imagery, or is not georeferenced.
    """
    tiles = source if isinstance(source, Tiles) else Tiles(source)
    path = os.fspath(tiles.path)
    if "{z}" in path and "{x}" in path and "y}" in path:
        return _describe_service(tiles, path, region, resolution)

    def describe(file: str, georeference: Georeference | None) -> Raster:
        return describe_raster(file, crs=crs, bands=bands, georeference=georeference)

    if Path(path).is_dir():
        numbered = sorted(number_tiles(Path(path), tiles.tms))
        if numbered:
            return _describe_tiles(tiles, numbered, region, resolution, describe)
        files = [f for f in sorted(Path(path).rglob("*")) if f.suffix.lower() in GEOTIFF_SUFFIXES]
        return _describe_files(path, [str(file) for file in files], describe)
    if not os.path.exists(path) and not GDAL_STRING.search(path):
        if not any(sign in path for sign in "*?["):
            raise FileNotFoundError(f"{path}: no such file")
        return _describe_files(path, sorted(glob.glob(path, recursive=True)), describe)
    return _describe_single(tiles, path, crs, bands)


def _describe_single(
    tiles: Tiles, path: str, crs: str | None, bands: Sequence[int] | None
) -> Layer:
    options = {} if tiles.zoom is None else {"ZOOM_LEVEL": tiles.zoom}
    if options and not path.lower().endswith(".mbtiles"):
        raise ImageryError(f"{path} holds no tiles by zoom levels; read it without zoom")
    raster = describe_raster(path, crs=crs, bands=bands, options=options)
    outlines = ((raster.crs, outline_raster(raster)),)
    return Layer(_hide_query(path), (raster,), outlines, zoom=tiles.zoom, single=True)


def _describe_files(name: str, files: Sequence[str], describe: Describer) -> Layer:
    if not files:
        raise FileNotFoundError(
            f"{name}: no file there; needed are GeoTIFFs, tiles named z/x/y.png or NAME-x-y-z.png, "
            "or, for other files, a pattern such as folder/*.jpg"
        )
    rasters, unreadable = _describe_all(((file, None) for file in files), describe, name)
    outlines = tuple((raster.crs, outline_raster(raster)) for raster in rasters)
    return Layer(name, rasters, outlines, unreadable=unreadable)


def _describe_all(
    files: Iterable[tuple[str, Georeference | None]], describe: Describer, name: str
) -> tuple[tuple[Raster, ...], tuple[str, ...]]:
    """The rasters, and the names of files that cannot be read, with a warning for each."""
    rasters, errors = [], dict[str, ImageryError]()
    for file, georeference in files:
        try:
            rasters.append(describe(file, georeference))
        except ImageryError as error:
            errors[file] = error
    if errors and not rasters:
        first = next(iter(errors.values()))
        raise ImageryError(f"none of the {len(errors)} file(s) of {name} can be read: {first}")
    for reason in errors.values():
        warnings.warn(f"left as a hole: {reason}", GeoaimWarning, stacklevel=2)
    return tuple(rasters), tuple(errors)


def _describe_tiles(
    tiles: Tiles,
    numbered: Sequence[tuple[int, int, int, str]],
    region: Region | None,
    resolution: float | None,
    describe: Describer,
) -> Layer:
    name = os.fspath(tiles.path)
    numbers = np.array([tile[:3] for tile in numbered])
    inside = intersect_tiles(numbers, region)
    levels = np.unique(numbers[inside if inside.any() else slice(None), 0])
    zoom = choose_zoom(tiles, levels, region, resolution)
    if zoom not in levels:
        raise ImageryError(f"{name} has no tile of zoom {zoom} there; it has {levels.tolist()}")
    level = numbers[numbers[:, 0] == zoom, 1:]
    corners = compute_tile_corners(zoom, level.min(axis=0), level.max(axis=0) + 1)
    chosen = [tile for tile, use in zip(numbered, inside, strict=True) if use and tile[0] == zoom]
    files = ((path, georeference_tile(z, x, y)) for z, x, y, path in chosen)
    rasters, unreadable = _describe_all(files, describe, name)
    return Layer(name, rasters, ((MERCATOR, corners),), zoom=zoom, unreadable=unreadable)


def _describe_service(
    tiles: Tiles, address: str, region: Region | None, resolution: float | None
) -> Layer:
    name = _hide_query(address)
    if "://" not in address:
        raise ImageryError(f"{name} is no service's address; for files give the folder")
    if region is None or (resolution is None and tiles.zoom is None):
        raise ImageryError(
            f"{name} is a service for all of the world, and does not say how fine it is: give the "
            "world, the corners, and a resolution or Tiles(..., zoom=...)"
        )
    zoom = choose_zoom(tiles, np.arange(MAX_ZOOM), region, resolution)
    xml, corners = describe_service(tiles, address, zoom, region)
    raster = replace(describe_raster(xml), name=name, retries=tiles.retries)
    return Layer(name, (raster,), ((MERCATOR, corners),), zoom=zoom, single=True)


def _hide_query(address: str) -> str:
    """An address without what follows "?", where keys stand."""
    return address.split("?")[0] if "://" in address else address
