"""A raster of any kind that GDAL opens: where it lies, and a part of it on a grid."""

import re
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rasterio
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array
from rasterio import Affine
from rasterio._err import CPLE_BaseError
from rasterio.enums import ColorInterp, MaskFlags, Resampling
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.warp import reproject
from rasterio.windows import Window

from geoaim.errors import ImageryError
from geoaim.geometry import image_corners, transform_points
from geoaim.grid import Grid

SEQUENTIAL = {"PNG", "JPEG", "WEBP", "GIF", "BMP"}  # drivers that decode a file from its start
MOST_PIXELS = 1_000_000_000  # in one piece that can only be decoded as a whole
PIXELS = rasterio.crs.CRS.from_wkt('LOCAL_CS["pixels",UNIT["metre",1]]')
HALF_SEEN = 0.5  # alpha from which a pixel is known
RIM = 6  # cells of nothing around what is read: more than the kernel's reach at twice the cells
SAMPLED = 1000  # pixels a side, of those that a stretch is found by
SETTINGS = {"GDAL_ERROR_ON_LIBJPEG_WARNING": "YES"}  # else a cut JPEG ends in grey, in silence


@dataclass(frozen=True, eq=False)
class Raster:
    """A raster that can be opened, and where it lies.

    Attributes:
        path: what GDAL opens: a file, a connection string, or XML.
        name: what messages and reports call it.
        crs: of its coordinates.
        grid: its pixels, in coordinates of that CRS, x first.
        bands: the band for grey, or the three for red, green and blue, from 1.
        dtype: of these bands.
        options: for opening it.
        retries: how often a failed read is tried again.
    """

    path: str
    name: str
    crs: str
    grid: Grid
    bands: tuple[int, ...]
    dtype: str
    options: Mapping[str, Any] = field(default_factory=dict)
    retries: int = 0


@dataclass(frozen=True)
class Stretch:
    """Values that become 0 and 255 in the image."""

    low: float
    high: float


def describe_raster(
    path: str,
    *,
    crs: str | None = None,
    bands: Sequence[int] | None = None,
    place: tuple[str, Float[Array, "3 3"]] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Raster:
    """What a raster is and where it lies, from its header.

    Args:
        path: what GDAL opens.
        crs: used where the raster names none.
        bands: one or three band numbers, from 1; by colour interpretation when None.
        place: CRS and crs_from_raster for the unit square, in place of the raster's own.
        options: for opening it.

    Raises:
        ImageryError: it is no raster, lies nowhere, names no CRS and none was given, has not
            these bands, or would be decoded in one piece of more than a gigapixel.
    """
    options = dict(options or {})
    with _opened(path, path, options) as dataset:
        _refuse_bombs(dataset, path)
        chosen = _choose_bands(dataset, bands, path)
        found, matrix = place or _find_place(dataset, crs, path)
        if place is not None:
            matrix = matrix @ np.diag([1.0 / dataset.width, 1.0 / dataset.height, 1.0])
        return Raster(
            path=path,
            name=path,
            crs=found,
            grid=Grid((dataset.height, dataset.width), matrix),
            bands=chosen,
            dtype=dataset.dtypes[chosen[0] - 1],
            options=options,
        )


def raster_outline(raster: Raster) -> Float[Array, "m 2"]:
    """Points along the raster's edges, in its CRS."""
    corners = image_corners(*raster.grid.shape)
    shares = np.linspace(0.0, 1.0, 9)[:, None]
    edges = [a + (b - a) * shares for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    return transform_points(raster.grid.world_from_grid, np.concatenate(edges))


def touches(raster: Raster, points: Float[Array, "m 2"]) -> bool:
    """Whether the raster has a pixel between points in its CRS."""
    pixels = transform_points(raster.grid.grid_from_world, points)
    inside = (pixels.max(axis=0) > 0) & (pixels.min(axis=0) < raster.grid.shape[::-1])
    return bool(inside.all())


def find_stretch(
    rasters: Sequence[Raster], points: Mapping[str, Float[Array, "m 2"]]
) -> Stretch | None:
    """What 8 bits make of rasters that have more: the 1st to 99th percentile of their values.

    Jointly over rasters and bands, of about a million pixels between the points (given in each
    CRS). None when all have 8 bits, or nothing valid can be read there.
    """
    wide = [raster for raster in rasters if raster.dtype != "uint8"]
    samples = [np.empty(0, np.float32)]
    most = max(1, int(SAMPLED / max(len(wide), 1) ** 0.5))
    for raster in wide:
        pixels = transform_points(raster.grid.grid_from_world, points[raster.crs])
        window = _clip(raster, np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0)))
        if window is not None:
            size = min(most, int(window.height)), min(most, int(window.width))
            with suppress(ImageryError):  # place_raster will tell
                values, weights = _read(raster, window, size, Resampling.nearest)
                samples.append(values[:, weights > 0].ravel())
    found = np.concatenate(samples)
    if found.size == 0:
        return None
    low, high = np.percentile(found, [1.0, 99.0])
    if high <= low:
        low, high = found.min(), found.max()
    return Stretch(float(low), float(high))


def colours_of(total: Float32[Array, "4 h w"]) -> UInt8[Array, "h w 3"]:
    """Colours of summed colours and alpha, as `place_raster` gives; black where half is unseen."""
    colours = np.clip(np.rint(total[:3] / np.maximum(total[3], HALF_SEEN)), 0, 255)
    return np.moveaxis(np.where(total[3] >= HALF_SEEN, colours, 0), 0, -1).astype(np.uint8)


def place_raster(
    raster: Raster,
    raster_from_block: Float[Array, "3 3"],
    shape: tuple[int, int],
    stretch: Stretch | None,
) -> tuple[slice, slice, Float32[Array, "4 h w"]] | None:
    """Draw a raster as a block of the image would show it; None when it does not reach there.

    Returns the rows and columns reached, and there colours in [0, 255] times alpha, and alpha in
    [0, 1]: sums of a cubic kernel over valid pixels, so that rasters that abut add up to what one
    raster would have given. What is finer than the block is first read as means over whole
    cells, through its overviews.

    Raises:
        ImageryError: the raster cannot be read.
    """
    pixels = transform_points(raster_from_block, image_corners(*shape))
    steps = np.linalg.norm(raster_from_block[:2, :2], axis=1)  # its pixels for one of the block
    cell = np.maximum(1.0, np.floor(steps + 1e-3))
    low, high = np.floor(pixels.min(axis=0) - RIM * cell), np.ceil(pixels.max(axis=0) + RIM * cell)
    window = _clip(raster, low, low + np.ceil((high - low) / cell) * cell)
    if window is None:
        return None
    across, down = (int(n) for n in np.ceil(np.array([window.width, window.height]) / cell))
    method = Resampling.average if cell.max() > 1 else Resampling.nearest
    source = _premultiplied(*_read(raster, window, (down, across), method), stretch)
    size = np.array([window.width / across, window.height / down])
    raster_from_source = np.diag([*size, 1.0])
    raster_from_source[:2, 2] = [window.col_off, window.row_off] - RIM * size
    block_from_source = np.linalg.inv(raster_from_block) @ raster_from_source
    return _resample(source, block_from_source, shape, np.maximum(steps / size, 1.0))


def _resample(
    source: Float32[Array, "4 h w"],
    block_from_source: Float[Array, "3 3"],
    shape: tuple[int, int],
    finer: Float[Array, "2"],
) -> tuple[slice, slice, Float32[Array, "4 h2 w2"]] | None:
    """Cubic convolution (Keys, a = -1/2), widened by what the source is finer than the block."""
    reached = transform_points(block_from_source, image_corners(*source.shape[1:]))
    left, top = np.clip(np.floor(reached.min(axis=0)), 0, shape[::-1]).astype(int).tolist()
    right, bottom = np.clip(np.ceil(reached.max(axis=0)), 0, shape[::-1]).astype(int).tolist()
    if right <= left or bottom <= top:
        return None
    part = np.zeros((4, bottom - top, right - left), np.float32)
    reproject(
        source,
        part,
        src_transform=Affine(*block_from_source[:2].flat),
        dst_transform=Affine.translation(left, top),
        src_crs=PIXELS,
        dst_crs=PIXELS,
        resampling=Resampling.cubic,
        XSCALE=1.0 / finer[0],  # GDAL else guesses it from what it happens to see
        YSCALE=1.0 / finer[1],
    )
    return slice(top, bottom), slice(left, right), part


def _clip(raster: Raster, low: Float[Array, "2"], high: Float[Array, "2"]) -> Window | None:
    size = np.array(raster.grid.shape[::-1])
    (left, top), (right, bottom) = np.clip(low, 0, size), np.clip(high, 0, size)
    if right <= left or bottom <= top:
        return None
    return Window(left, top, right - left, bottom - top)


def _premultiplied(
    values: Float32[Array, "C h w"], weights: Float32[Array, "h w"], stretch: Stretch | None
) -> Float32[Array, "4 H W"]:
    """Colours in [0, 255] times alpha, and alpha, with a rim of nothing."""
    if stretch is not None:
        span = stretch.high - stretch.low
        values = (values - stretch.low) * (255.0 / span if span > 0 else 0.0)
        np.clip(values, 0.0, 255.0, out=values)
    height, width = weights.shape
    source = np.zeros((4, height + 2 * RIM, width + 2 * RIM), np.float32)
    inner = source[:, RIM:-RIM, RIM:-RIM]
    inner[:3], inner[3] = values * weights, weights
    return source


def _read(
    raster: Raster, window: Window, shape: tuple[int, int], method: Resampling
) -> tuple[Float32[Array, "C h w"], Float32[Array, "h w"]]:
    """Values of a window in so many rows and columns, and how valid each is in [0, 1]."""
    for attempt in range(raster.retries + 1):
        try:
            with _opened(raster.path, raster.name, raster.options) as dataset:
                return _read_window(dataset, raster, window, shape, method)
        except ImageryError:
            if attempt == raster.retries:
                raise
            time.sleep(0.2 * 2**attempt)
    raise AssertionError


def _read_window(
    dataset: Any, raster: Raster, window: Window, shape: tuple[int, int], method: Resampling
) -> tuple[Float32[Array, "C h w"], Float32[Array, "h w"]]:
    bands = list(raster.bands)
    part = {"window": window, "out_shape": (len(bands), *shape)}
    if dataset.colorinterp[bands[0] - 1] == ColorInterp.palette:
        method = Resampling.nearest  # the mean of two places in a palette is a third colour
    values = dataset.read(bands, **part, resampling=method, out_dtype="float32")
    weights = _weigh(dataset, values, bands, part, method)
    if dataset.colorinterp[bands[0] - 1] == ColorInterp.palette:
        colours = np.zeros((256, 4), np.float32)
        for index, colour in dataset.colormap(bands[0]).items():
            colours[index & 255] = colour
        expanded = colours[values[0].astype(int) & 255]
        values, weights = np.moveaxis(expanded[..., :3], -1, 0), weights * expanded[..., 3] / 255
    bad = ~np.isfinite(values).all(axis=0)
    return np.where(bad, np.float32(0), values), np.where(bad, np.float32(0), weights)


def _weigh(
    dataset: Any,
    values: Float32[Array, "C h w"],
    bands: Sequence[int],
    part: Mapping[str, Any],
    method: Resampling,
) -> Float32[Array, "h w"]:
    """Alpha in [0, 1]; of nodata and of nothing without GDAL's masks, which it makes at length."""
    flags = {flag for band in bands for flag in dataset.mask_flag_enums[band - 1]}
    if flags == {MaskFlags.all_valid}:
        return np.ones(values.shape[1:], np.float32)
    if flags == {MaskFlags.nodata}:
        nodata = np.array([dataset.nodatavals[band - 1] for band in bands], np.float32)
        return (values != nodata[:, None, None]).any(axis=0).astype(np.float32)
    masks = dataset.read_masks(list(bands), **part, resampling=method)
    return masks.max(axis=0) / np.float32(255)


@contextmanager
def _opened(path: str, name: str, options: Mapping[str, Any]) -> Iterator[Any]:
    try:
        with warnings.catch_warnings(), rasterio.Env(**SETTINGS):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path, sharing=False, **options) as dataset:
                yield dataset
    except (RasterioError, CPLE_BaseError) as error:
        raise ImageryError(
            f"{name} cannot be read as imagery: {_reasons(error)}. Needed is a whole file that "
            "GDAL opens, or a service that answers, with tiles of its tile_size"
        ) from error


def _reasons(error: BaseException | None) -> str:
    """All that GDAL said, once; without what stands behind "?", where keys are."""
    said = []
    while error is not None:
        said.append(re.sub(r"\?\S*", "?...", str(error)).strip().rstrip("."))
        error = error.__cause__ or error.__context__
    said = list(dict.fromkeys(said))[said[0].startswith("Read failed") :]
    return "; ".join(one for one in said if sum(one in other for other in set(said)) == 1)


def _refuse_bombs(dataset: Any, name: str) -> None:
    rows, columns = dataset.block_shapes[0] if dataset.count else (0, 0)
    if dataset.driver in SEQUENTIAL:
        rows, columns = dataset.shape
    if rows * columns > MOST_PIXELS:
        raise ImageryError(
            f"{name} holds {rows} x {columns} pixels in one piece, and at most {MOST_PIXELS:.0e} "
            "are decoded at once: convert it to a tiled GeoTIFF with overviews (gdal_translate "
            "-of COG), if it is what it claims"
        )


def _choose_bands(dataset: Any, bands: Sequence[int] | None, name: str) -> tuple[int, ...]:
    if bands is None:
        kinds = list(dataset.colorinterp)
        rgb = [ColorInterp.red, ColorInterp.green, ColorInterp.blue]
        plain = [i + 1 for i, kind in enumerate(kinds) if kind != ColorInterp.alpha]
        if all(kind in kinds for kind in rgb):
            bands = [kinds.index(kind) + 1 for kind in rgb]
        else:
            bands = plain[:3] if len(plain) >= 3 else plain[:1]
    if not bands or not all(1 <= band <= dataset.count for band in bands):
        raise ImageryError(
            f"{name} has {dataset.count} band(s), and bands {list(bands)} were wanted: give the "
            "numbers of one or three that exist, counted from 1"
        )
    if dataset.dtypes[bands[0] - 1].startswith("complex"):
        raise ImageryError(f"{name} holds complex numbers; give their magnitude as a raster")
    return tuple(bands)


def _find_place(dataset: Any, crs: str | None, name: str) -> tuple[str, Float[Array, "3 3"]]:
    if dataset.transform.is_identity:
        points = f"{len(dataset.gcps[0])} control points and " if dataset.gcps[0] else ""
        raise ImageryError(
            f"{name} has {points}no transform from pixels to coordinates: warp it first "
            "(gdalwarp), lay a world file beside it, or georeference it with control points"
        )
    if dataset.crs is None and crs is None:
        raise ImageryError(
            f"{name} names no coordinate reference system; say which its coordinates are in, "
            "for example crs='EPSG:32635'"
        )
    found = crs if dataset.crs is None else dataset.crs.to_string()
    return str(found), np.array(dataset.transform, np.float64).reshape(3, 3)
