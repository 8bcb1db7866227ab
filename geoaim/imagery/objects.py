"""Imagery that Python already holds: datasets of rasterio, and arrays of xarray with .rio."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeGuard, runtime_checkable

import numpy as np
import rasterio.shutil
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT

from geoaim.base.errors import ImageryError
from geoaim.base.raster_files import IMAGE_DRIVERS
from geoaim.imagery.sources import Source
from geoaim.imagery.tiles import Tiles

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


def write_objects(sources: Iterable[Any], folder: Path) -> list[Any]:
    """Write sources that are objects as GeoTIFFs; others, and datasets of plain files, stay."""
    return [
        _write_object(source, folder / f"source {number}.tif") if is_object(source) else source
        for number, source in enumerate(sources, 1)
    ]


def _write_object(source: Any, path: Path) -> str:
    if isinstance(source, DatasetReader | WarpedVRT):
        plain = isinstance(source, DatasetReader) and source.driver in IMAGE_DRIVERS
        if plain and os.path.isfile(source.name):
            return str(source.name)
        rasterio.shutil.copy(source, path, driver="GTiff")
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
