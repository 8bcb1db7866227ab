"""Parts of rasters on the grid of an image: read, stretched to 8 bits, and resampled."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import rasterio
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array
from rasterio import Affine
from rasterio.enums import ColorInterp, MaskFlags, Resampling
from rasterio.warp import reproject
from rasterio.windows import Window

from geoaim.base.errors import ImageryError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.imagery.rasters import Raster, open_raster

MIN_ALPHA = 0.5  # a pixel of at least this alpha counts as covered
KERNEL_PAD_PX = 6  # empty cells around what is read: beyond the kernel's reach at twice the cells
STRETCH_SAMPLES_PX = 1000  # a side, of the pixels whose percentiles give the stretch
MAX_WHOLE_PX = 1_000_000  # of a raster that is read as a whole: as many as of a block
PIXEL_CRS = rasterio.crs.CRS.from_wkt('LOCAL_CS["pixels",UNIT["metre",1]]')


class Stretch(NamedTuple):
    """Values of a raster that become 0 (low) and 255 (high) in the image."""

    low: float
    high: float


def estimate_stretch(
    rasters: Sequence[Raster], points: Mapping[str, Float[Array, "m 2"]]
) -> Stretch | None:
    """Estimate the 1st and 99th percentile of rasters of more than 8 bits, over all bands."""
    deep = [raster for raster in rasters if raster.dtype != "uint8"]
    samples = [np.empty(0, np.float32)]
    side = max(1, int(STRETCH_SAMPLES_PX / max(len(deep), 1) ** 0.5))
    for raster in deep:
        pixels = transform_points(raster.grid.grid_from_world, points[raster.crs])
        window = _clip_window(raster, np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0)))
        if window is not None:
            shape = min(side, int(window.height)), min(side, int(window.width))
            with suppress(ImageryError):  # resample_raster reports it
                values, alpha = _read(raster, window, shape, Resampling.nearest)
                samples.append(values[:, alpha > 0].ravel())
    values = np.concatenate(samples)
    if values.size == 0:
        return None
    low, high = np.percentile(values, [1.0, 99.0])
    if high <= low:
        low, high = values.min(), values.max()
    return Stretch(float(low), float(high))


def unpremultiply(rgba: Float32[Array, "4 h w"]) -> UInt8[Array, "h w 3"]:
    """Divide the colours of `resample_raster` by alpha; black where alpha is below `MIN_ALPHA`."""
    colours = np.clip(np.rint(rgba[:3] / np.maximum(rgba[3], MIN_ALPHA)), 0, 255)
    return np.moveaxis(np.where(rgba[3] >= MIN_ALPHA, colours, 0), 0, -1).astype(np.uint8)


def resample_raster(
    raster: Raster,
    raster_from_block: Float[Array, "3 3"],
    shape: tuple[int, int],
    stretch: Stretch | None,
) -> tuple[slice, slice, Float32[Array, "4 h w"]] | None:
    """Resample a raster to a block of the image by cubic convolution over its valid pixels."""
    pixels = transform_points(raster_from_block, image_corners(*shape))
    steps = np.linalg.norm(raster_from_block[:2, :2], axis=1)  # raster pixels per block pixel
    cell = np.maximum(1.0, np.floor(steps + 1e-3))
    low = np.floor(pixels.min(axis=0) - KERNEL_PAD_PX * cell)
    high = np.ceil(pixels.max(axis=0) + KERNEL_PAD_PX * cell)
    window = _clip_window(raster, low, low + np.ceil((high - low) / cell) * cell)
    if window is None:
        return None
    across, down = (int(n) for n in np.ceil(np.array([window.width, window.height]) / cell))
    method = Resampling.average if cell.max() > 1 else Resampling.nearest
    source = _premultiply(*_read(raster, window, (down, across), method), stretch)
    size = np.array([window.width / across, window.height / down])
    raster_from_source = np.diag([*size, 1.0])
    raster_from_source[:2, 2] = [window.col_off, window.row_off] - KERNEL_PAD_PX * size
    block_from_source = np.linalg.inv(raster_from_block) @ raster_from_source
    return _convolve(source, block_from_source, shape, np.maximum(steps / size, 1.0))


def _convolve(
    source: Float32[Array, "4 h w"],
    block_from_source: Float[Array, "3 3"],
    shape: tuple[int, int],
    reduction: Float[Array, "2"],
) -> tuple[slice, slice, Float32[Array, "4 h2 w2"]] | None:
    """Cubic convolution (Keys 1981, a = -1/2), its kernel widened by the reduction in x and y."""
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
        src_crs=PIXEL_CRS,
        dst_crs=PIXEL_CRS,
        resampling=Resampling.cubic,
        XSCALE=1.0 / reduction[0],  # otherwise GDAL estimates it from the part it warps
        YSCALE=1.0 / reduction[1],
    )
    return slice(top, bottom), slice(left, right), part


def _clip_window(raster: Raster, low: Float[Array, "2"], high: Float[Array, "2"]) -> Window | None:
    size = np.array(raster.grid.shape[::-1])
    (left, top), (right, bottom) = np.clip(low, 0, size), np.clip(high, 0, size)
    if right <= left or bottom <= top:
        return None
    return Window(left, top, right - left, bottom - top)


def _premultiply(
    values: Float32[Array, "C h w"], alpha: Float32[Array, "h w"], stretch: Stretch | None
) -> Float32[Array, "4 H W"]:
    """Stretched colours in [0, 255] times alpha, and alpha, padded with zeros for the kernel."""
    if stretch is not None:
        span = stretch.high - stretch.low
        values = (values - stretch.low) * (255.0 / span if span > 0 else 0.0)
        np.clip(values, 0.0, 255.0, out=values)
    height, width = alpha.shape
    source = np.zeros((4, height + 2 * KERNEL_PAD_PX, width + 2 * KERNEL_PAD_PX), np.float32)
    inner = source[:, KERNEL_PAD_PX:-KERNEL_PAD_PX, KERNEL_PAD_PX:-KERNEL_PAD_PX]
    inner[:3], inner[3] = values * alpha, alpha
    return source


def _read(
    raster: Raster, window: Window, shape: tuple[int, int], method: Resampling
) -> tuple[Float32[Array, "C h w"], Float32[Array, "h w"]]:
    """Values and alpha in [0, 1] of a window, resampled to (rows, columns)."""
    height, width = raster.grid.shape
    if shape != (window.height, window.width) or height * width > MAX_WHOLE_PX:
        return _read_file(raster, window, shape, method)
    values, alpha = read_whole(raster)
    part = tuple(slice(*map(int, ends)) for ends in window.toranges())
    return values[:, *part], alpha[part]


@lru_cache(maxsize=4)
def read_whole(raster: Raster) -> tuple[Float32[Array, "C h w"], Float32[Array, "h w"]]:
    """Read all of a small raster once, of which hundreds of blocks may show a part each."""
    height, width = raster.grid.shape
    return _read_file(raster, Window(0, 0, width, height), (height, width), Resampling.nearest)


def _read_file(
    raster: Raster, window: Window, shape: tuple[int, int], method: Resampling
) -> tuple[Float32[Array, "C h w"], Float32[Array, "h w"]]:
    """Read a window of the file."""
    bands = list(raster.bands)
    part = {"window": window, "out_shape": (len(bands), *shape)}
    with open_raster(raster.path, raster.options) as dataset:
        palette = dataset.colorinterp[bands[0] - 1] == ColorInterp.palette
        if palette:
            method = Resampling.nearest  # the mean of two indices is a third colour
        values = dataset.read(bands, **part, resampling=method, out_dtype="float32")
        alpha = _read_alpha(dataset, values, bands, part, method)
        named = dataset.colormap(bands[0]) if palette else {}
    if raster.nodata is not None and not raster.masked:
        alpha = alpha * (values != _round([raster.nodata])).any(axis=0)
    if palette:
        colours = np.zeros((256, 4), np.float32)
        for index, colour in named.items():
            colours[index & 255] = colour
        expanded = colours[values[0].astype(int) & 255]
        values, alpha = np.moveaxis(expanded[..., :3], -1, 0), alpha * expanded[..., 3] / 255
    bad = ~np.isfinite(values).all(axis=0)
    alpha = np.where(bad, np.float32(0), alpha)
    if raster.inverted:
        values = np.iinfo(raster.dtype).max - values
    return np.where(alpha > 0, values, np.float32(0)), alpha  # nodata may be as large as can be


def _round(nodata: Sequence[float]) -> Float32[Array, "c 1 1"]:
    """Values of nodata as they are read; beyond the range of 32 bits they are infinite."""
    with np.errstate(over="ignore"):
        return np.array(nodata, np.float32)[:, None, None]


def _read_alpha(
    dataset: Any,
    values: Float32[Array, "C h w"],
    bands: Sequence[int],
    part: Mapping[str, Any],
    method: Resampling,
) -> Float32[Array, "h w"]:
    """Alpha in [0, 1], without GDAL's masks where they would be slow: all valid, or nodata."""
    flags = {flag for band in bands for flag in dataset.mask_flag_enums[band - 1]}
    if flags == {MaskFlags.all_valid}:
        return np.ones(values.shape[1:], np.float32)
    if flags == {MaskFlags.nodata}:
        nodata = _round([dataset.nodatavals[band - 1] for band in bands])
        return (values != nodata).any(axis=0).astype(np.float32)
    masks = dataset.read_masks(list(bands), **part, resampling=method)
    return masks.max(axis=0) / np.float32(255)
