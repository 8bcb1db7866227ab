"""Sources of imagery as rasters: files, folders, patterns, tiles and tile services."""

import glob
import os
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeGuard, runtime_checkable
from xml.etree import ElementTree

import numpy as np
import rasterio
from jaxtyping import Float
from numpy import ndarray as Array
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT

from geoaim.base.errors import GeoaimWarning, ImageryError, name_option, warn
from geoaim.base.limits import open_sqlite, refuse_damaged
from geoaim.base.raster_files import IMAGE_DRIVERS
from geoaim.imagery.addresses import (
    ask_where,
    find_kind,
    hide_keys,
    is_address,
    name_address,
    normalise_address,
)
from geoaim.imagery.collars import leave_out_placeholders
from geoaim.imagery.rasters import Outline, Raster, Region, describe_raster, outline_raster
from geoaim.imagery.remote import FINEST_RESOLUTION_M, copy_part, open_remote
from geoaim.imagery.tile_schemes import check_mbtiles, read_scheme
from geoaim.imagery.tile_service import MAX_TILE_BYTES, Service, fetch_tiles
from geoaim.imagery.tiles import (
    MAX_ZOOM,
    MERCATOR,
    Georeference,
    Tiles,
    choose_zoom,
    compute_tile_corners,
    compute_world_fractions,
    georeference_tile,
    intersect_tiles,
    list_tiles,
)

GEOTIFF_SUFFIXES = {".tif", ".tiff"}
ZOOMS_TRIED = 6  # zoom levels, from that resolution on, at which a service may have imagery
Source = str | os.PathLike[str] | Tiles
Describer = Callable[[str, Georeference | None], Raster]


@dataclass(frozen=True, eq=False)
class Layer:
    """The rasters of one source."""

    name: str  # the source's name in messages and reports
    rasters: tuple[Raster, ...]  # all of them, or the tiles that show the region
    outlines: tuple[Outline, ...]  # outlines of all data of the source, wherever they lie
    zoom: int | None = None  # zoom level of tiles
    single: bool = False  # whether it is one file or service, which must be readable
    # names of those of many files that were left out with a warning
    unreadable: tuple[str, ...] = ()


def describe_source(
    source: Source,
    region: Region | None,
    *,
    resolution: float | None = None,
    crs: str | None = None,
    bands: Sequence[int] | None = None,
    nodata: float | None = None,
) -> Layer:
    """List the rasters of a source.

    Args:
        source: a file, folder, pattern, address of a service, or `Tiles`.
        region: the ground for which imagery is wanted; None: all of it, which a tile service
            refuses.
        resolution: wanted metres per pixel, which chooses the zoom level of tiles if a region is
            given; None: the finest there is, of a tile service from 0.1 m on.
        crs: CRS of rasters that name none; None: such rasters are refused.
        bands: numbers, from 1, of a grey band or of the red, green and blue bands; None: by the
            file's colour interpretation.
        nodata: value of pixels that show nothing, of rasters that do not tell.

    Returns:
        The rasters; of tiles, only those that show the region.

    Raises:
        FileNotFoundError: there is no such file or folder, or nothing matches the pattern.
        ImageryError: it is not imagery, or is not georeferenced.
    """
    tiles = source if isinstance(source, Tiles) else Tiles(source)
    path = os.fspath(tiles.path)
    if is_address(path) and not os.path.exists(path):
        return _describe_service(tiles, path, region, resolution)

    def describe(file: str, georeference: Georeference | None) -> Raster:
        return describe_raster(file, crs=crs, bands=bands, georeference=georeference, nodata=nodata)

    if Path(path).is_dir():
        numbered = sorted(list_tiles(Path(path), tiles.tms or bool(read_scheme(Path(path)))))
        if numbered:
            return _describe_tiles(tiles, numbered, region, resolution, describe)
        files = [f for f in sorted(Path(path).rglob("*")) if f.suffix.lower() in GEOTIFF_SUFFIXES]
        return _describe_files(path, [str(file) for file in files], describe)
    if not os.path.exists(path):
        if not any(sign in path for sign in "*?["):
            raise FileNotFoundError(f"{path}: no such file")
        return _describe_files(path, sorted(glob.glob(path, recursive=True)), describe)
    if path.lower().endswith(".vrt"):
        return _describe_files(path, _list_files_of_vrt(path), describe)
    return _describe_single(tiles, path, crs, bands, nodata)


def _list_files_of_vrt(path: str) -> list[str]:
    """The files that a VRT puts side by side, topmost first; GDAL would open whatever it names."""
    with refuse_damaged(path, ImageryError, "a VRT"):
        content = Path(path).read_bytes()
        if b"<!ENTITY" in content or b"<!DOCTYPE" in content:
            raise ValueError("it defines XML entities")
        root = ElementTree.fromstring(content)
    bands = root.findall("VRTRasterBand")
    sources = [(band, part) for band in bands for part in band if part.tag.endswith("Source")]
    is_plain = root.get("subClass") is None and all(
        part.tag in ("SimpleSource", "ComplexSource")
        and part.findtext("SourceBand", "1").split(",")[-1] == band.get("band")
        and part.find("ScaleRatio") is None
        and part.find("LUT") is None
        for band, part in sources
    )
    folder = Path(path).resolve().parent
    files = [(folder / part.findtext("SourceFilename", "")).resolve() for _, part in sources]
    if not files or not all(file.is_file() and file.is_relative_to(folder) for file in files):
        raise ImageryError(
            f"{path} names files that do not lie beside or below it: name these files themselves"
        )
    if not is_plain:
        raise ImageryError(
            f"{path} does more than putting files side by side: write what it shows with "
            "gdal_translate -of COG"
        )
    return [str(file) for file in dict.fromkeys(reversed(files))]


def number_parts(layers: Sequence[Layer]) -> tuple[dict[str, int], tuple[str, ...]]:
    """Number the parts that were placed each for itself: files, or all tiles of a layer."""
    numbers, names = dict[str, int](), list[str]()
    for layer in layers:
        tiled = layer.zoom is not None
        if tiled:
            names.append(layer.name)
        for raster in layer.rasters:
            if raster.path not in numbers:
                if not tiled:
                    names.append(Path(raster.path).name)
                numbers[raster.path] = len(names)
    return numbers, tuple(names)


def _describe_single(
    tiles: Tiles, path: str, crs: str | None, bands: Sequence[int] | None, nodata: float | None
) -> Layer:
    options = {} if tiles.zoom is None else {"ZOOM_LEVEL": tiles.zoom}
    if options and not path.lower().endswith(".mbtiles"):
        raise ImageryError(f"{path} is not an .mbtiles file; omit {name_option('--zoom', 'zoom=')}")
    is_mbtiles = path.lower().endswith(".mbtiles")
    corners = _outline_mbtiles(path, tiles.zoom) if is_mbtiles else None  # before GDAL opens it
    raster = describe_raster(path, crs=crs, bands=bands, options=options, nodata=nodata)
    outline = raster.crs, outline_raster(raster)
    if corners is not None:
        check_mbtiles(path, corners)
        outline = MERCATOR, corners
    return Layer(path, (raster,), (outline,), zoom=tiles.zoom, single=True)


def _outline_mbtiles(path: str, zoom: int | None) -> Float[Array, "4 2"]:
    """Corners of the tiles that a file has, whatever bounds it states."""
    query = (
        "SELECT zoom_level, MIN(tile_column), MIN(tile_row), MAX(tile_column), MAX(tile_row) "
        "FROM tiles WHERE ? IS NULL OR zoom_level = ? GROUP BY zoom_level ORDER BY zoom_level"
    )
    with refuse_damaged(path, ImageryError, "an MBTiles file"), open_sqlite(path) as database:
        # GDAL reads without a limit what may be a view that never ends or makes a tile of any size
        (longest,) = database.execute("SELECT max(length(tile_data)) FROM tiles").fetchone()
        if (longest or 0) > MAX_TILE_BYTES:
            raise ImageryError(f"{path} has a tile of {longest / 1e6:.0f} MB")
        rows = database.execute(query, (zoom, zoom)).fetchall()
        if not rows:
            raise ImageryError(f"{path} has no tiles{'' if zoom is None else f' of zoom {zoom}'}")
        level, left, bottom, right, top = map(int, rows[-1])
        if not 0 <= level <= MAX_ZOOM or min(left, bottom) < 0 or max(right, top) >= 2**level:
            raise ImageryError(
                f"{path} has tile {right}/{top} at zoom {level}, which has none such"
            )
        low, high = np.array([left, 2**level - 1 - top]), np.array([right, 2**level - 1 - bottom])
        return compute_tile_corners(level, low, high + 1)


def _describe_files(name: str, files: Sequence[str], describe: Describer) -> Layer:
    if not files:
        raise FileNotFoundError(
            f"{name}: no files match; expected GeoTIFFs, tiles named z/x/y.png or NAME-x-y-z.png, "
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
        warn(f"file skipped, its area stays empty: {reason}")
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
    kept = leave_out_placeholders([(x, y, Path(path)) for _, x, y, path in chosen], name)
    if chosen and not kept:
        raise ImageryError(
            f"{name}: all of its {len(chosen)} tiles of zoom {zoom} there are the same picture, "
            "and no imagery; choose another zoom"
        )
    files = ((str(path), georeference_tile(zoom, x, y)) for x, y, path in kept)
    rasters, unreadable = _describe_all(files, describe, name)
    return Layer(name, rasters, ((MERCATOR, corners),), zoom=zoom, unreadable=unreadable)


def _describe_service(
    tiles: Tiles, address: str, region: Region | None, resolution: float | None
) -> Layer:
    name = hide_keys(address)
    address = normalise_address(address, name)
    if region is None:
        raise ask_where(name)
    service = Service(
        address=address.replace("{y}", "{-y}") if tiles.tms else address,
        name=name,
        tile_size=tiles.tile_size,
        cache=Path(tiles.cache),
    )
    if resolution is None and tiles.zoom is None:
        zoom = _find_finest_zoom(tiles, service, region)
    else:
        zoom = choose_zoom(tiles, np.arange(MAX_ZOOM), region, resolution)
    low, high = (limit * 2.0**zoom for limit in compute_world_fractions(region))
    low = np.clip(np.floor(low) - 1, 0, 2**zoom - 1).astype(int)
    high = np.clip(np.ceil(high) + 1, low + 1, 2**zoom).astype(int)
    numbers = [(x, y) for x in range(low[0], high[0]) for y in range(low[1], high[1])]
    fetched = list(fetch_tiles(service, zoom, numbers))
    kept = leave_out_placeholders(fetched, name)
    if not kept:
        found = f"{len(fetched)} tiles that are all the same picture" if fetched else "no tile"
        raise ImageryError(
            f"{name} has {found} there at zoom {zoom}, and no imagery; choose a coarser one: "
            + name_option("--zoom or --resolution", "Tiles(..., zoom=) or resolution=")
        )
    rasters = tuple(
        describe_raster(str(file), georeference=georeference_tile(zoom, x, y))
        for x, y, file in kept
    )
    outlines = ((MERCATOR, compute_tile_corners(zoom, low, high)),)
    return Layer(name, rasters, outlines, zoom=zoom, single=True)


def _find_finest_zoom(tiles: Tiles, service: Service, region: Region) -> int:
    """Find the finest zoom level of which a service has imagery about the middle of a region."""
    finest = choose_zoom(tiles, np.arange(MAX_ZOOM), region, FINEST_RESOLUTION_M)
    middle = np.mean(compute_world_fractions(region), axis=0)
    for zoom in range(finest, finest - ZOOMS_TRIED, -1):
        x, y = np.clip(np.floor(middle * 2.0**zoom - 0.5), 0, 2**zoom - 2).astype(int).tolist()
        four = [(x + i, y + j) for i in range(2) for j in range(2)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GeoaimWarning)  # of placeholders, which are expected
            if leave_out_placeholders(list(fetch_tiles(service, zoom, four)), service.name):
                return zoom
    raise ImageryError(
        f"{service.name} has no imagery there at the zooms {finest - ZOOMS_TRIED + 1} to {finest}; "
        f"choose another one: {name_option('--zoom', 'Tiles(..., zoom=)')}"
    )


RGB = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)


@runtime_checkable
class RasterArray(Protocol):
    """An array of xarray, which is not imported here."""

    dims: Any
    coords: Any


ImageryObject: TypeAlias = DatasetReader | WarpedVRT | RasterArray


def is_object(source: Any) -> TypeGuard[ImageryObject]:
    """Whether a source is an open dataset of rasterio or an array of xarray."""
    return isinstance(source, ImageryObject)


def list_sources(
    sources: Source | ImageryObject | Sequence[Source | ImageryObject],
) -> Sequence[Source | ImageryObject]:
    """Make a list of one source or of several."""
    one = isinstance(sources, str | os.PathLike | Tiles) or is_object(sources)
    return [sources] if one else list(sources)  # type: ignore[arg-type]


def fetch_parts(
    sources: Iterable[Any], folder: Path, region: Region | None, resolution: float | None
) -> list[Any]:
    """Write of sources that are objects or remote what is needed as GeoTIFFs; others stay."""
    listed = []
    for number, source in enumerate(sources, 1):
        own = folder / str(number)
        own.mkdir()
        if isinstance(source, str) and find_kind(source) is not None:
            name = name_address(source)
            path = own / f"{name.removesuffix('.tif')}.tif"
            with open_remote(source, region, resolution) as dataset:
                copy_part(dataset, path, region, resolution, name)
            source = str(path)
        elif is_object(source):
            source = _write_object(source, own / f"source {number}.tif", region, resolution)
        listed.append(source)
    return listed


def _write_object(source: Any, path: Path, region: Region | None, resolution: float | None) -> str:
    if isinstance(source, DatasetReader | WarpedVRT):
        plain = isinstance(source, DatasetReader) and source.driver in IMAGE_DRIVERS
        if plain and os.path.isfile(source.name):
            return str(source.name)
        copy_part(source, path, region, resolution, hide_keys(source.name))
        return str(path)
    try:
        import rioxarray  # noqa: F401, which adds .rio to arrays
    except ImportError as error:
        raise ImageryError("arrays of xarray need rioxarray: pip install rioxarray") from error
    if source.rio.crs is None:
        raise ImageryError("the array has no CRS: give it one with .rio.write_crs('EPSG:n')")
    source.rio.to_raster(path)
    if "alpha" in np.atleast_1d(source.coords.get("band", [])):  # as `AIM.to_xarray` names it
        with rasterio.open(path, "r+") as dataset:
            dataset.colorinterp = [*RGB, ColorInterp.alpha]
    return str(path)
