"""A synthetic place's orthophoto and tiles as files."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import rasterio
from jaxtyping import UInt8
from numpy import ndarray as Array
from rasterio.enums import ColorInterp

from geoaim.synthetic.imagery import (
    WEB,
    Imagery,
    cut_tiles,
    draw_offset,
    georeference_photo,
    make_other_day,
    photograph,
)
from geoaim.synthetic.readme import ZOOM
from geoaim.synthetic.sample import Sample, tracks_of


def write_imagery(sample: Sample, folder: Path) -> tuple[float, float]:
    """Write an orthophoto and tiles of another day; return their offset, metres east and north."""
    place = sample.place
    tracks = tracks_of(sample, len(sample.recordings) - 1)
    last = replace(
        tracks,
        times=tracks.times[-1:],
        states=tracks.states[:, -1:],
        present=tracks.present[:, -1:],
    )
    offset = draw_offset(place)
    photo = photograph(place, make_other_day(place), last, resolution=sample.resolution)
    _write_geotiff(
        georeference_photo(place, photo, "EPSG:3035", offset=offset), folder / "ortho.tif"
    )
    web = georeference_photo(place, photo, WEB, offset=offset)
    for column, row, tile in cut_tiles(web, ZOOM):
        write_jpeg(tile, folder / "tiles" / str(ZOOM) / str(column) / f"{row}.jpg", quality=85)
    return offset


def _write_geotiff(imagery: Imagery, path: Path) -> None:
    """Write RGB and alpha, as map services deliver them."""
    height, width = imagery.covered.shape
    profile = {
        "driver": "GTiff",
        "height": height,
        "width": width,
        "count": 4,
        "dtype": "uint8",
        "crs": imagery.crs,
        "transform": rasterio.Affine(*imagery.crs_from_image[:2].flat),
        "compress": "deflate",
        "predictor": 2,
        "tiled": True,
        "blockxsize": 256,
        "blockysize": 256,
    }
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(np.moveaxis(imagery.image, -1, 0), [1, 2, 3])
        dataset.write(np.where(imagery.covered, 255, 0).astype(np.uint8), 4)
        names = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha)
        dataset.colorinterp = names


def write_jpeg(image: UInt8[Array, "H W 3"], path: Path, *, quality: int) -> None:
    """Write an image as JPEG.

    Args:
        image: the image.
        path: file to write; its folders are made.
        quality: 0 to 100.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    bgr = np.ascontiguousarray(image[..., ::-1])
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise OSError(f"{path}: the image could not be encoded")
    path.write_bytes(data.tobytes())
