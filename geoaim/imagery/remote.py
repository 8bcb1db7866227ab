"""Imagery where it lives: files by address, STAC items, WMS, WMTS, and open datasets.

GDAL reads the part and the resolution that are needed into a file of its own, which is then read as
any other.
"""

import json
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urljoin, urlsplit

import numpy as np
import rasterio
import rasterio.shutil
from rasterio._err import CPLE_BaseError
from rasterio.enums import MaskFlags, Resampling
from rasterio.errors import RasterioError
from rasterio.windows import Window

from geoaim.base.errors import ImageryError, name_option
from geoaim.base.geometry import transform_points
from geoaim.base.grid import Grid
from geoaim.base.raster_files import SETTINGS
from geoaim.imagery.addresses import (
    FILES,
    JOSM_PREFIX,
    ask_where,
    find_kind,
    hide_keys,
    name_address,
)
from geoaim.imagery.rasters import Raster, Region, describe_extent, measure_resolution
from geoaim.imagery.tile_service import RETRIES, TIMEOUT_S, TOTAL_S, request

FINEST_RESOLUTION_M = 0.1  # of a service, where none is asked for
STRIP_PX = 512  # rows that are read between two looks at the clock
MARGIN_PX = 8  # of the needed part, for resampling at its edge
MAX_WHOLE_PX = 4_000_000_000  # a dataset that is larger is no image, but a service of the Earth
CACHE = Path("~/.cache/geoaim/gdal")
IMAGE_TYPES = ("image/tiff", "image/jp2")


@contextmanager
def open_remote(address: str, region: Region | None, resolution: float | None) -> Iterator[Any]:
    """Open a remote source as a dataset of rasterio, of which nothing is read yet.

    Raises:
        ImageryError: it does not answer, or is no imagery.
    """
    name, kind = name_address(address), find_kind(address)
    if kind == "item":
        address = _find_asset(address)
    is_jp2 = urlsplit(address).path.lower().endswith(".jp2")
    target, driver = f"/vsicurl/{address}", "JP2OpenJPEG" if is_jp2 else "GTiff"
    if kind == "wms":
        target, driver = _describe_wms(address, name, region, resolution), "WMS"
    elif kind == "wmts":
        target, driver = _name_wmts(address), "WMTS"
    settings = SETTINGS | {
        "GDAL_HTTP_TIMEOUT": TIMEOUT_S,
        "GDAL_HTTP_CONNECTTIMEOUT": TIMEOUT_S,
        "GDAL_HTTP_MAX_RETRY": 2,
        "GDAL_HTTP_RETRY_DELAY": 0.5,
        "GDAL_HTTP_USERAGENT": "geoaim",
        "CPL_VSIL_CURL_ALLOWED_FILENAME": target,
        "GDAL_DEFAULT_WMS_CACHE_PATH": str(CACHE.expanduser()),
    }
    try:
        with rasterio.Env(**settings), rasterio.open(target, driver=driver, sharing=False) as data:
            yield data
    except (RasterioError, CPLE_BaseError, OSError) as error:
        reason = _explain(str(error.__cause__ or error))
        raise ImageryError(f"{name} cannot be read: {reason}") from error


def _explain(message: str) -> str:
    """Say what a message of GDAL means for an address."""
    if "not recognized as" in message:
        return (
            "it is no GeoTIFF, or its server sends no parts of files (HTTP ranges): download it, "
            "and give the file"
        )
    if "Missing Capabilities" in message or "doesn't have matching" in message:
        return "it does not answer with the capabilities of a WMTS; is the address right?"
    found = re.search(r"HTTP status code: (\d+), error: (.*)", message)
    if found is not None:
        message = found[2] if found[1] == "0" else f"it answers with the code {found[1]}"
    return hide_keys(message.rpartition("GDALWMS: ")[2])


def copy_part(
    dataset: Any, path: Path, region: Region | None, resolution: float | None, name: str
) -> None:
    """Copy the part of a dataset that shows a region, no finer than is wanted, into a GeoTIFF.

    Raises:
        ImageryError: it does not show the region, or takes too long.
    """
    if region is None or dataset.crs is None:
        if dataset.width * dataset.height > MAX_WHOLE_PX:
            raise ask_where(name)
        rasterio.shutil.copy(dataset, path, driver="GTiff")
        return
    window = _find_window(dataset, region, name)
    transform = np.array(dataset.transform).reshape(3, 3)
    grid = Grid(dataset.shape, transform)
    own = measure_resolution(Raster("", str(dataset.crs), grid, (1,), "uint8", False), region)
    coarser = max(1.0, (resolution or (FINEST_RESOLUTION_M if _is_service(dataset) else own)) / own)
    width, height = (max(1, round(side / coarser)) for side in (window.width, window.height))
    masked = dataset.mask_flag_enums[0] == [MaskFlags.per_dataset]  # with alpha there are two
    profile = {
        "driver": "GTiff",
        "height": height,
        "width": width,
        "count": dataset.count,
        "dtype": dataset.dtypes[0],
        "crs": dataset.crs,
        "nodata": dataset.nodata,
        "transform": dataset.window_transform(window)
        @ rasterio.Affine.scale(window.width / width, window.height / height),
    }
    end = time.monotonic() + TOTAL_S
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "w", **profile) as part:
        part.colorinterp, part.descriptions = dataset.colorinterp, dataset.descriptions
        for top in range(0, height, STRIP_PX):
            rows = min(STRIP_PX, height - top)
            scale = window.height / height
            strip = Window(window.col_off, window.row_off + top * scale, window.width, rows * scale)
            shape = {"window": strip, "resampling": Resampling.average}
            target = Window(0, top, width, rows)
            values = _read_again(dataset, out_shape=(dataset.count, rows, width), **shape)
            part.write(values, range(1, dataset.count + 1), window=target)
            if masked:
                mask = dataset.dataset_mask(out_shape=(rows, width), window=strip)
                part.write_mask(mask, window=target)
            if time.monotonic() > end and top + rows < height:
                raise ImageryError(
                    f"{name} took over {TOTAL_S:.0f} s for {(top + rows) / height:.0%} of what is "
                    "needed: ask for less, " + name_option("--resolution", "resolution=")
                )


def _read_again(dataset: Any, **part: Any) -> Any:
    """Read a part, again where requests fail now and then: what came is in GDAL's cache."""
    for _ in range(RETRIES if _is_service(dataset) else 0):
        with suppress(RasterioError, CPLE_BaseError):
            return dataset.read(**part)
        time.sleep(0.5)
    return dataset.read(**part)


def _is_service(dataset: Any) -> bool:
    return dataset.driver in ("WMS", "WMTS")


def _find_window(dataset: Any, region: Region, name: str) -> Window:
    """The pixels of a dataset about a region."""
    pixel_from_crs = np.linalg.inv(np.array(dataset.transform).reshape(3, 3))
    pixels = transform_points(pixel_from_crs, region.to_crs(str(dataset.crs)))
    low = np.maximum(np.floor(pixels.min(axis=0)) - MARGIN_PX, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)) + MARGIN_PX, [dataset.width, dataset.height])
    if (low >= high).any():
        west, south, east, north = dataset.bounds
        own = str(dataset.crs), np.array([[west, south], [east, north]])
        wanted = str(region.world.crs), region.points + region.world.origin
        raise ImageryError(
            f"{name} covers {describe_extent([own])}; imagery is needed in "
            f"{describe_extent([wanted])}"
        )
    return Window(*low, *(high - low))


def _name_wmts(address: str) -> str:
    """What GDAL opens of the address of a WMTS, with its `layer`, if it names one."""
    address = JOSM_PREFIX.sub("", address)
    layer = re.search(r"[?&,]layer=([^&,]+)", address, re.I)
    kept = re.sub(r"[?&](layer|request)=[^&]*", "", address, flags=re.I).split(",")[0]
    if "service=wmts" in kept.lower():
        base, _, query = kept.replace("?", "&", 1).partition("&")
        kept = f"{base}?{query}&REQUEST=GetCapabilities"
    return f"WMTS:{kept}" + (f",layer={layer[1]}" if layer else "")


def _describe_wms(address: str, name: str, region: Region | None, resolution: float | None) -> str:
    """Describe a WMS for GDAL: just the region, at the resolution that is needed."""
    address = JOSM_PREFIX.sub("", address)
    query = {key.lower(): value for key, value in parse_qsl(urlsplit(address).query)}
    if "layers" not in query:
        raise ImageryError(
            f"{name} is a WMS: name its layer, https://host/wms?service=WMS&layers=NAME"
        )
    if region is None:
        raise ask_where(name)
    crs = query.get("crs") or query.get("srs") or "EPSG:3857"
    points = region.to_crs(crs)
    (west, south), (east, north) = points.min(axis=0), points.max(axis=0)
    metres = np.ptp(region.points, axis=0)
    width, height = np.ceil(metres / (resolution or FINEST_RESOLUTION_M)).astype(int) + 1
    own = ("service", "request", "layers", "crs", "srs", "version", "format", "styles")
    kept = "&".join(f"{key}={value}" for key, value in query.items() if key not in own)
    base = f"{address.split('?')[0]}?{kept}{'&' if kept else ''}"
    values = {
        "ServerUrl": base,
        "Version": "1.1.1",  # whose order of axes is x, y in every CRS
        "SRS": crs,
        "Layers": query["layers"],
        "Styles": query.get("styles", ""),
        "ImageFormat": query.get("format", "image/jpeg"),
    }
    service = "".join(f"<{key}>{escape(value)}</{key}>" for key, value in values.items())
    return (
        f'<GDAL_WMS><Service name="WMS">{service}</Service><DataWindow>'
        f"<UpperLeftX>{west}</UpperLeftX><UpperLeftY>{north}</UpperLeftY>"
        f"<LowerRightX>{east}</LowerRightX><LowerRightY>{south}</LowerRightY>"
        f"<SizeX>{width}</SizeX><SizeY>{height}</SizeY></DataWindow><Projection>{crs}</Projection>"
        f"<BandsCount>3</BandsCount><OverviewCount>0</OverviewCount><Timeout>{TIMEOUT_S}</Timeout>"
        "<Cache/></GDAL_WMS>"
    )


def _find_asset(address: str) -> str:
    """Find the image of a STAC item: what is shown (`visual`), or else its data."""
    name = name_address(address)
    content = request(address, name)
    if not content:
        raise ImageryError(f"{name} has no STAC item at this address")
    try:
        item = json.loads(content)
        assets = [
            (key != "visual", "data" not in asset.get("roles", []), asset["href"])
            for key, asset in item["assets"].items()
            if asset.get("type", "").startswith(IMAGE_TYPES)
            or asset["href"].lower().endswith(FILES)
        ]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ImageryError(f"{name} cannot be read as a STAC item: {error}") from error
    if not assets:
        raise ImageryError(f"{name} is no STAC item with a GeoTIFF among its assets")
    href = urljoin(address, min(assets)[2])
    here, there = urlsplit(address), urlsplit(href)
    if there.scheme != "https" and (there.scheme, there.hostname) != (here.scheme, here.hostname):
        raise ImageryError(f"{name} names {href}: give that address, if you trust it")
    return href


def outline_dataset(dataset: Any) -> tuple[str, Any]:
    """CRS and corners of a dataset."""
    west, south, east, north = dataset.bounds
    corners: Sequence[Any] = [(west, north), (east, north), (east, south), (west, south)]
    return str(dataset.crs), np.array(corners)
