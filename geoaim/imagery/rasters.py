"""Rasters as the headers of their files describe them, and the region to read."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from rasterio._err import CPLE_BaseError
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.errors import RasterioError

from geoaim.base.errors import GeoreferenceError, ImageryError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.grid import Grid
from geoaim.base.limits import check_regular
from geoaim.base.raster_files import IMAGE_DRIVERS, open_raster_file, read_georeference
from geoaim.base.world import (
    LONLAT,
    World,
    choose_world,
    crs_from_world,
    describe_misplacement,
    parse_crs,
    transform_crs,
    world_from_crs,
)

SEQUENTIAL_DRIVERS = {"PNG", "JPEG", "WEBP", "GIF", "BMP"}  # decode a file from its start
LOSSY = ("JPEG", "WEBP", "JXL")  # compressions that blur nodata with what is beside it
MAX_PRJ_BYTES = 1_000_000
MAX_BLOCK_PIXELS = 1_000_000_000  # largest block; a block can only be decoded as a whole
# smallest area of a pixel in units of the CRS; in degrees, pixels of 0.003 mm
MIN_PIXEL_AREA = 1e-15
MIN_EXTENT_M = 0.1  # of a raster; one in degrees that are taken for metres has less
# largest extent of longitude or latitude that is read without a region: the width of a UTM zone
MAX_EXTENT_DEGREES = 6.0

Outline = tuple[str, Float[Array, "m 2"]]  # a CRS, and points along an outline in it


@dataclass(frozen=True, eq=False)
class Raster:
    """A raster and where it lies."""

    path: str  # its file
    crs: str  # CRS of its coordinates
    grid: Grid  # its pixels, mapped to coordinates in that CRS, x first
    bands: tuple[int, ...]  # number of the grey band, or of the red, green and blue ones, from 1
    dtype: str  # data type of these bands
    # whether the file tells pixels that show nothing: alpha, a mask, or nodata that lossy
    # compression has not blurred
    masked: bool
    nodata: float | None = None  # value of pixels that show nothing, where the file tells none
    options: Mapping[str, int] = field(default_factory=dict)  # options of GDAL's driver
    inverted: bool = False  # whether 0 is white, and the largest value black


def describe_raster(
    path: str,
    *,
    crs: str | None = None,
    bands: Sequence[int] | None = None,
    georeference: tuple[str, Float[Array, "3 3"]] | None = None,
    options: Mapping[str, int] | None = None,
    nodata: float | None = None,
) -> Raster:
    """Read the header of a raster; no pixel is read.

    Args:
        path: the file.
        crs: CRS of a raster that names none.
        bands: one or three band numbers, from 1; None: by colour interpretation.
        georeference: CRS, and a (3, 3) matrix that maps the unit square, (0, 0) at the raster's
            top left and (1, 1) at its bottom right, to coordinates in that CRS, x first. None: the
            file's own, or that of the world file beside it.
        options: options of GDAL's driver.
        nodata: value of pixels that show nothing, for a raster that does not tell; in all bands.

    Returns:
        The raster: its size, bands, data type and CRS, and the map from its pixels to the CRS.

    Raises:
        FileNotFoundError: there is no such file.
        ImageryError: the file is no raster, lacks bands, georeference or CRS, or is too large.
    """
    options = dict(options or {})
    with open_raster(path, options) as dataset:
        _refuse_decompression_bombs(dataset, path)
        chosen = _choose_bands(dataset, bands, path)
        raster_crs, matrix = georeference or _read_georeference(dataset, crs, path, options)
        if georeference is not None:
            matrix = matrix @ np.diag([1.0 / dataset.width, 1.0 / dataset.height, 1.0])
        else:
            _check_place(path, raster_crs, Grid(dataset.shape, matrix).corners)
        return Raster(
            path=path,
            crs=raster_crs,
            grid=Grid((dataset.height, dataset.width), matrix),
            bands=chosen,
            dtype=dataset.dtypes[chosen[0] - 1],
            masked=_tells_empty(dataset, chosen),
            nodata=nodata,
            options=options,
            inverted=dataset.tags(ns="IMAGE_STRUCTURE").get("MINISWHITE") == "YES"
            and np.dtype(dataset.dtypes[chosen[0] - 1]).kind == "u",
        )


def _tells_empty(dataset: Any, bands: Sequence[int]) -> bool:
    """Whether a file tells the pixels that show nothing, to the last one."""
    flags = {flag for band in bands for flag in dataset.mask_flag_enums[band - 1]}
    compression = dataset.tags(ns="IMAGE_STRUCTURE").get("COMPRESSION", "")
    if flags == {MaskFlags.nodata} and any(name in compression for name in LOSSY):
        return False
    return flags != {MaskFlags.all_valid}


def _check_place(path: str, crs: str, corners: Float[Array, "4 2"]) -> None:
    """Refuse a raster outside the area of its CRS, or whose metres seem to be degrees."""
    problem = describe_misplacement(crs, corners)
    extent = float(np.ptp(corners, axis=0).max())
    if not problem and parse_crs(crs).is_projected and extent < MIN_EXTENT_M:
        x, y = corners[0].tolist()
        problem = f"all of it lies within {extent:.2g} m at {x:g}, {y:g} in {crs}: are they degrees"
        problem += "? Then name their CRS, such as EPSG:4326 (gdal_edit.py -a_srs)"
    if problem:
        raise ImageryError(f"{path}: {problem}")


def outline_raster(raster: Raster) -> Float[Array, "m 2"]:
    """Sample 36 points along the four edges of a raster, in its CRS."""
    corners = image_corners(*raster.grid.shape)
    shares = np.linspace(0.0, 1.0, 9)[:, None]
    edges = [a + (b - a) * shares for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    return transform_points(raster.grid.world_from_grid, np.concatenate(edges))


def intersects_bounds(raster: Raster, points: Float[Array, "m 2"]) -> bool:
    """Tell whether a raster has a pixel within the bounds of points (x, y in its CRS)."""
    pixels = transform_points(raster.grid.grid_from_world, points)
    inside = (pixels.max(axis=0) > 0) & (pixels.min(axis=0) < raster.grid.shape[::-1])
    return bool(inside.all())


@contextmanager
def open_raster(path: str, options: Mapping[str, int]) -> Iterator[Any]:
    """Open a raster as rasterio's dataset, with options of GDAL's driver."""
    check_regular(path, ImageryError)
    try:
        with open_raster_file(path, options=options) as dataset:
            yield dataset
    except (RasterioError, CPLE_BaseError) as error:
        raise ImageryError(
            f"{path} cannot be read as imagery: {_join_reasons(error)}. Give a complete "
            f"{', '.join(IMAGE_DRIVERS)}; convert other formats (gdal_translate -of COG)"
        ) from error


def _join_reasons(error: BaseException | None) -> str:
    """GDAL's chain of messages, each once."""
    reasons = []
    while error is not None:
        reasons.append(str(error).strip().rstrip("."))
        error = error.__cause__ or error.__context__
    reasons = list(dict.fromkeys(reasons))[reasons[0].startswith("Read failed") :]
    return "; ".join(one for one in reasons if sum(one in other for other in set(reasons)) == 1)


def _refuse_decompression_bombs(dataset: Any, name: str) -> None:
    rows, columns = dataset.block_shapes[0] if dataset.count else (0, 0)
    if dataset.driver in SEQUENTIAL_DRIVERS:
        rows, columns = dataset.shape
    if rows * columns > MAX_BLOCK_PIXELS:
        raise ImageryError(
            f"{name} holds {rows} x {columns} pixels in one piece, and at most "
            f"{MAX_BLOCK_PIXELS:.0e} are decoded at once: convert it to a tiled GeoTIFF with "
            "overviews (gdal_translate -of COG), if you trust it"
        )


def _choose_bands(dataset: Any, bands: Sequence[int] | None, name: str) -> tuple[int, ...]:
    if bands is None:
        kinds = list(dataset.colorinterp)
        rgb = [ColorInterp.red, ColorInterp.green, ColorInterp.blue]
        opaque = [i + 1 for i, kind in enumerate(kinds) if kind != ColorInterp.alpha]
        # names come from who made the file; the interpretation may be a program's default
        names = [(name or "").strip().lower() for name in dataset.descriptions]
        if all(kind.name in names for kind in rgb):
            bands = [names.index(kind.name) + 1 for kind in rgb]
        elif all(kind in kinds for kind in rgb):
            bands = [kinds.index(kind) + 1 for kind in rgb]
        else:
            bands = opaque[:3] if len(opaque) >= 3 else opaque[:1]
    if not bands or not all(1 <= band <= dataset.count for band in bands):
        raise ImageryError(
            f"{name} has {dataset.count} band(s), and bands {list(bands)} were wanted: give the "
            "numbers of one or three that exist, counted from 1"
        )
    if dataset.dtypes[bands[0] - 1].startswith("complex"):
        raise ImageryError(f"{name} holds complex numbers; give their magnitude as a raster")
    return tuple(bands)


def _read_georeference(
    dataset: Any, crs: str | None, name: str, options: Mapping[str, int]
) -> tuple[str, Float[Array, "3 3"]]:
    transform, own_crs = read_georeference(name, options=options)
    if transform is None:
        points = f"{len(dataset.gcps[0])} control points and " if dataset.gcps[0] else ""
        raise ImageryError(
            f"{name} has {points}no transform from pixels to coordinates: warp it first "
            "(gdalwarp), put a world file (six numbers) beside it, or georeference it with control "
            "points"
        )
    # a CRS of a site by itself lies nowhere on the Earth
    if own_crs is not None and not (own_crs.is_projected or own_crs.is_geographic):
        own_crs = None
    stated = (own_crs and own_crs.to_string()) or _read_prj(Path(name)) or crs
    if stated is None:
        raise ImageryError(
            f"{name} names no coordinate reference system; say which its coordinates are in, "
            "for example crs='EPSG:32635' (--crs), or put a .prj beside it"
        )
    matrix = np.array(transform, np.float64).reshape(3, 3)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < MIN_PIXEL_AREA:
        raise ImageryError(f"{name} has the transform {list(transform)[:6]}, which has no inverse")
    return str(stated), matrix


def _read_prj(path: Path) -> str | None:
    """Read the CRS in the .prj beside an image, which GDAL does not."""
    for file in (path.with_suffix(".prj"), path.with_suffix(".PRJ")):
        if file.is_file() and file.stat().st_size < MAX_PRJ_BYTES:
            text = file.read_text(encoding="utf-8", errors="replace").strip()
            if text:  # programs write the same CRS in many ways
                epsg = parse_crs(text).to_epsg()
                return text if epsg is None else f"EPSG:{epsg}"
    return None


@dataclass(frozen=True, eq=False)
class Region:
    """The region that imagery is wanted for."""

    world: World  # plane of the wanted image
    points: Float[Array, "m 2"]  # points spread over the region, world metres

    def to_crs(self, crs: str) -> Float[Array, "m 2"]:
        """The points in a CRS, x first."""
        return crs_from_world(self.world, self.points, crs)


def make_region(world: World, corners: Float[Array, "n 2"]) -> Region:
    """Make a region of 9 x 9 points spread over the bounds of points in world metres."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    shares = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)), axis=-1)
    return Region(world, low + (high - low) * shares.reshape(-1, 2))


def enclose_outlines(outlines: Sequence[Outline], world: World | None) -> Region:
    """Make the region around outlines; `world` None chooses their UTM zone."""
    lonlat = np.concatenate([transform_crs(crs, LONLAT, points) for crs, points in outlines])
    spans = np.ptp(lonlat, axis=0)
    if spans.max() > MAX_EXTENT_DEGREES:
        raise ImageryError(
            f"the imagery spans {spans[0]:.3g} by {spans[1]:.3g} degrees (longitude, latitude), "
            f"and at most {MAX_EXTENT_DEGREES:g} are read as a whole: name a world and corners"
        )
    world = world or choose_world(lonlat)
    corners = np.concatenate([world_from_crs(world, points, crs) for crs, points in outlines])
    return make_region(world, corners)


def describe_extent(outlines: Sequence[Outline]) -> str:
    """Describe the longitudes and latitudes of outlines in words, for a message."""
    try:
        lonlat = np.concatenate([transform_crs(crs, LONLAT, points) for crs, points in outlines])
    except GeoreferenceError as error:
        return f"a place that has no longitude and latitude ({error})"
    (west, south), (east, north) = lonlat.min(axis=0), lonlat.max(axis=0)
    return f"longitude {west:.6f} to {east:.6f}, latitude {south:.6f} to {north:.6f}"


def measure_resolution(raster: Raster, region: Region) -> float:
    """Measure metres per pixel of a raster in the middle of a region: root of a pixel's area."""
    middle = (region.points.min(axis=0) + region.points.max(axis=0)) / 2.0
    cross = middle + 5.0 * np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
    points = Region(region.world, cross).to_crs(raster.crs)
    pixels = transform_points(raster.grid.grid_from_world, points)
    steps = (pixels[1::2] - pixels[::2]) / 10.0
    return float(1.0 / np.sqrt(abs(np.linalg.det(steps))))
