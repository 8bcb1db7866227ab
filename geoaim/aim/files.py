"""An AIM as one GeoTIFF file."""

import json
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from jaxtyping import Float
from numpy import ndarray as Array
from pyproj import CRS
from rasterio._err import CPLE_BaseError
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from geoaim.aim.aim import AIM
from geoaim.aim.position import bind_report
from geoaim.aim.rectification import rectify
from geoaim.base.checksums import (
    PLACEHOLDER,
    FileFormat,
    check_version,
    verify_checksum,
    write_checksum,
)
from geoaim.base.errors import AimError
from geoaim.base.files import MAP_FILE, atomic_write, find_in_folder
from geoaim.base.geometry import translation
from geoaim.base.grid import Grid
from geoaim.base.limits import check_memory, refuse_damaged
from geoaim.base.raster_files import create_raster_file, open_raster_file
from geoaim.base.world import World

FORMAT = FileFormat("AIM", 1, 2, first_checked=2, error=AimError, editable=True)
BYTES_PER_PIXEL = 12  # memory needed to read an AIM
BANDS = ("red", "green", "blue", "alpha", "contested", "coverage, low byte", "coverage, high byte")


def write_aim(aim: AIM, path: str | os.PathLike[str]) -> None:
    """Write an AIM as one GeoTIFF (cloud-optimised, lossless) that GIS programs open directly.

    Bands: red, green, blue, alpha (255 where the coverage is not 0), contested (255 or 0), and
    the low and high bytes of the coverage. The world, the exact matrix and the report are in the
    tags GEOAIM and GEOAIM_REPORT. An existing file is replaced only when the new one is complete.

    Args:
        aim: the AIM to write. It is rectified first when its transform is not affine, since a
            GeoTIFF has no perspective.
        path: the .tif file.

    Raises:
        AimError: the grid would be too large, or the file cannot be written.
        ValueError: the resolution is not positive.
    """
    if not aim.is_affine:
        aim = rectify(aim)
    profile = {**_make_profile(aim), "count": len(BANDS)}
    try:
        with atomic_write(path) as temporary:
            with _allow_identity_transform(), create_raster_file(temporary, profile) as dataset:
                _write_bands(dataset, aim)
                _write_tags(dataset, aim)
            write_checksum(temporary)
    except (RasterioError, CPLE_BaseError, OSError) as error:
        raise AimError(f"{Path(path).name} could not be written: {error}") from error


def write_rgb(aim: AIM, path: str | os.PathLike[str]) -> None:
    """Write the image of an AIM as a GeoTIFF of red, green and blue with a mask.

    It is for tools that take three bands, such as rio-tiler. The coverage, the contested pixels and
    the report are not in it: `read_aim` needs a file of `write_aim`.

    Args:
        aim: the AIM to write; rectified first when its transform is not affine.
        path: the .tif file.

    Raises:
        AimError: the grid would be too large, or the file cannot be written.
    """
    if not aim.is_affine:
        aim = rectify(aim)
    profile = {**_make_profile(aim), "count": 3}
    try:
        with (
            atomic_write(path) as temporary,
            _allow_identity_transform(),
            create_raster_file(temporary, profile) as dataset,
        ):
            dataset.write(np.moveaxis(aim.image, -1, 0))
            dataset.write_mask(aim.coverage > 0)
            dataset.colorinterp = [ColorInterp.red, ColorInterp.green, ColorInterp.blue]
    except (RasterioError, CPLE_BaseError, OSError) as error:
        raise AimError(f"{Path(path).name} could not be written: {error}") from error


def read_aim(path: str | os.PathLike[str]) -> AIM:
    """Read a file that `write_aim` wrote, or the map in a folder that `geoaim place` wrote.

    A file that a GIS program has cropped or resampled since is read with its new transform, as
    long as its CRS and bands are the same.

    Raises:
        FileNotFoundError: there is no such file.
        AimError: the file is not an AIM, is damaged, or needs too much memory.
    """
    path = find_in_folder(path, MAP_FILE)
    with open_aim(path) as (dataset, grid, report):
        assert grid.world is not None
        claim = f"{dataset.height} x {dataset.width} pixels"
        needed = BYTES_PER_PIXEL * dataset.height * dataset.width
        check_memory(path, needed, os.path.getsize(path), AimError, claim)
        return AIM(
            image=np.ascontiguousarray(np.moveaxis(dataset.read([1, 2, 3]), 0, -1)),
            world_from_image=grid.world_from_grid,
            world=grid.world,
            coverage=dataset.read(6) + dataset.read(7).astype(np.uint16) * 256,
            contested=dataset.read(5) > 0,
            report=report,
        )


@contextmanager
def open_aim(path: str | os.PathLike[str]) -> Iterator[tuple[Any, Grid, dict[str, Any]]]:
    """Open a file that `write_aim` wrote, without reading its pixels.

    Args:
        path: the file.

    Yields:
        The open rasterio dataset with the bands `BANDS`; its grid, with the world; the report.

    Raises:
        FileNotFoundError: there is no such file.
        AimError: the file is not an AIM, or is damaged.
    """
    path = find_in_folder(path, MAP_FILE)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    has_checksum = verify_checksum(path, FORMAT)
    with (
        refuse_damaged(path, AimError, "a readable GeoTIFF that is an AIM"),
        open_raster_file(path, ["GTiff"]) as dataset,
    ):
        frame = _read_frame(dataset, path, has_checksum)
        world = World(crs=frame["world"]["crs"], origin=tuple(frame["world"]["origin"]))
        transform = _read_transform(dataset, world, frame, path)
        grid = Grid((dataset.height, dataset.width), transform, world)
        report = dict(json.loads(dataset.tags().get("GEOAIM_REPORT", "{}")))
        if "place" not in report:  # written before reports were bound to their places
            written = np.array(frame["world_from_image"], np.float64)
            report = bind_report(report, replace(grid, world_from_grid=written))
        report = bind_report(report, grid)
        yield dataset, grid, report


def _make_profile(aim: AIM) -> dict[str, Any]:
    """The profile of rasterio of a cloud-optimised, lossless GeoTIFF, without its bands."""
    height, width = aim.coverage.shape
    crs_from_image = translation(*aim.world.origin) @ aim.world_from_image
    return {
        "driver": "COG",
        "height": height,
        "width": width,
        "dtype": "uint8",
        "crs": aim.world.crs,
        "transform": rasterio.Affine(*crs_from_image[:2].flat),
        "compress": "deflate",
        "level": 1,  # half the time of GDAL's 6, and files of a video's map are 6 % larger
        "predictor": "yes",
        "num_threads": "all_cpus",
    }


@contextmanager
def _allow_identity_transform() -> Iterator[None]:
    # rasterio warns of an identity transform, which an AIM with pixels of one metre has
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def _write_bands(dataset: Any, aim: AIM) -> None:
    dataset.write(np.moveaxis(aim.image, -1, 0), [1, 2, 3])
    dataset.write((aim.coverage > 0).astype(np.uint8) * 255, 4)
    dataset.write(aim.contested.astype(np.uint8) * 255, 5)
    dataset.write((aim.coverage & 255).astype(np.uint8), 6)
    dataset.write((aim.coverage >> 8).astype(np.uint8), 7)
    dataset.write_mask(aim.coverage > 0)  # GDAL reads alpha only from files with four bands
    colours = [ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha]
    dataset.colorinterp = colours + [ColorInterp.undefined] * (len(BANDS) - 4)
    dataset.descriptions = BANDS


def _write_tags(dataset: Any, aim: AIM) -> None:
    frame = {
        "format": FORMAT.newest,
        "world": {"crs": aim.world.crs, "origin": aim.world.origin},
        "world_from_image": aim.world_from_image.tolist(),
    }
    dataset.update_tags(
        GEOAIM=json.dumps(frame), GEOAIM_REPORT=json.dumps(aim.report), GEOAIM_CHECKSUM=PLACEHOLDER
    )


def _read_frame(dataset: Any, path: str | os.PathLike[str], has_checksum: bool) -> dict[str, Any]:
    """Read the tag with the world and the matrix; refuse files that are not AIMs."""
    content = f"{dataset.count} band(s) of {dataset.dtypes[0]}, CRS {dataset.crs or 'absent'}"
    tag = dataset.tags().get("GEOAIM")
    if tag is None:
        raise AimError(
            f"{path} is a {dataset.driver} with {content}, and no GEOAIM tag: it is an image "
            "without the world, coverage and report of an AIM. Give a file that `geoaim build`, "
            "`geoaim align`, `geoaim draw` or write_aim wrote"
        )
    frame: dict[str, Any] = json.loads(tag)
    check_version(path, frame.get("format"), FORMAT, has_checksum=has_checksum)
    if dataset.descriptions != BANDS or set(dataset.dtypes) != {"uint8"}:
        raise AimError(
            f"{path} was an AIM and has lost bands: found {content}, needed uint8 {BANDS}"
        )
    return frame


def _read_transform(
    dataset: Any, world: World, frame: Mapping[str, Any], path: str | os.PathLike[str]
) -> Float[Array, "3 3"]:
    """Read world_from_image: the exact matrix of the tag, unless the file was cropped since."""
    written = np.array(frame["world_from_image"], np.float64)
    crs_from_image = np.array(dataset.transform, np.float64).reshape(3, 3)
    if np.allclose(crs_from_image, translation(*world.origin) @ written, rtol=1e-12, atol=1e-9):
        return written
    crs = dataset.crs and CRS(dataset.crs.to_wkt())
    if crs != (world.crs and CRS(world.crs)):
        raise AimError(
            f"{path} was reprojected: its world is in {world.crs} and the file in {dataset.crs}; "
            "give the file that write_aim wrote, or one cropped without reprojection"
        )
    crs_from_image[:2, 2] -= world.origin
    return crs_from_image
