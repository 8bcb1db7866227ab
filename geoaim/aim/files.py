"""An AIM as one GeoTIFF file."""

import json
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from mmap import mmap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rasterio
from jaxtyping import Bool, Float, UInt8, UInt16
from numpy import ndarray as Array
from pyproj import CRS
from rasterio._err import CPLE_BaseError
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError, RasterioIOError

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
from geoaim.base.errors import AimError, warn
from geoaim.base.files import MAP_FILE, atomic_write, find_in_folder
from geoaim.base.geometry import translation
from geoaim.base.grid import Grid
from geoaim.base.limits import check_memory, refuse_damaged
from geoaim.base.raster_files import create_raster_file, open_raster_file
from geoaim.base.world import World

FORMAT = FileFormat("AIM", 3, 3, first_checked=3, error=AimError, editable=True)
BYTES_PER_PIXEL = 12  # memory needed to read an AIM
BANDS = ("red", "green", "blue")
DOUBT_BANDS = ("coverage", "contested")  # of the second GeoTIFF
DOUBT_ADDRESS = "/vsisubfile/{:012d},"  # GDAL's name of what follows that many bytes of a file
DOUBT_PLACEHOLDER = DOUBT_ADDRESS.format(0)


class OpenAIM(NamedTuple):
    """An open file of `write_aim`, whose pixels are read when they are wanted.

    The readers take rasterio's options of a part and its size, `window` and `out_shape` (h, w).
    """

    dataset: Any  # of rasterio: the image
    doubt: Any  # of rasterio: coverage and contested; None: another program left it out
    grid: Grid  # with the world
    report: dict[str, Any]

    def read_image(self, **part: Any) -> UInt8[Array, "h w 3"]:
        """Read the colours."""
        size = part.pop("out_shape", None)
        bands = self.dataset.read([1, 2, 3], out_shape=size and (3, *size), **part)
        return np.ascontiguousarray(np.moveaxis(bands, 0, -1))

    def read_mask(self, **part: Any) -> Bool[Array, "h w"]:
        """Read where a frame saw the ground."""
        return np.asarray(self.dataset.dataset_mask(**part) > 0)

    def read_coverage(self, **part: Any) -> UInt16[Array, "h w"]:
        """Read the number of frames behind each pixel."""
        if self.doubt is None:
            return self.read_mask(**part).astype(np.uint16)
        return np.asarray(self.doubt.read(1, **part))

    def read_contested(self, **part: Any) -> Bool[Array, "h w"]:
        """Read where the frames do not determine the ground."""
        if self.doubt is None:
            return np.zeros_like(self.read_mask(**part))
        return np.asarray(self.doubt.read(2, **part) > 0)


def write_aim(aim: AIM, path: str | os.PathLike[str]) -> None:
    """Write an AIM as one GeoTIFF (cloud-optimised, lossless) that GIS programs open directly.

    It holds red, green and blue with a mask of where the coverage is not 0. The coverage and the
    contested pixels are a second GeoTIFF at the end of the same file. The world, the exact matrix
    and the report are in the tags GEOAIM and GEOAIM_REPORT. An existing file is replaced only when
    the new one is complete.

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
    try:
        with atomic_write(path) as temporary:
            with (
                _allow_identity_transform(),
                create_raster_file(temporary, _make_profile(aim, "uint8", len(BANDS))) as dataset,
            ):
                _write_bands(dataset, aim)
                _write_tags(dataset, aim)
            _append_doubt(temporary, aim)
            write_checksum(temporary)
    except (RasterioError, CPLE_BaseError, OSError) as error:
        raise AimError(f"{Path(path).name} could not be written: {error}") from error


def read_aim(path: str | os.PathLike[str]) -> AIM:
    """Read a file that `write_aim` wrote, or the map in a folder that `geoaim place` wrote.

    A file that a GIS program has cropped or resampled since is read with its new transform, as
    long as its CRS and bands are the same. Such programs keep the picture alone: its coverage is
    then 1 where the mask is, and nothing is contested, with a warning.

    Raises:
        FileNotFoundError: there is no such file.
        AimError: the file is not an AIM, is damaged, or needs too much memory.
    """
    path = find_in_folder(path, MAP_FILE)
    with open_aim(path) as file:
        height, width = file.grid.shape
        claim = f"{height} x {width} pixels"
        check_memory(path, BYTES_PER_PIXEL * height * width, os.path.getsize(path), AimError, claim)
        if file.doubt is None:
            warn(
                f"{path} was written anew by another program, which leaves out how many frames are "
                "behind each pixel and which ones are contested: it is read as if every pixel were "
                "of one frame and sure"
            )
        assert file.grid.world is not None
        return AIM(
            image=file.read_image(),
            world_from_image=file.grid.world_from_grid,
            world=file.grid.world,
            coverage=file.read_coverage(),
            contested=file.read_contested(),
            report=file.report,
        )


@contextmanager
def open_aim(path: str | os.PathLike[str]) -> Iterator[OpenAIM]:
    """Open a file that `write_aim` wrote, without reading its pixels.

    Args:
        path: the file.

    Yields:
        The open file.

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
        report = bind_report(dict(json.loads(dataset.tags().get("GEOAIM_REPORT", "{}"))), grid)
        with _open_doubt(dataset, path) as doubt:
            yield OpenAIM(dataset, doubt, grid, report)


@contextmanager
def _open_doubt(dataset: Any, path: str | os.PathLike[str]) -> Iterator[Any]:
    """Open the second GeoTIFF of an open file; None where it has none any more."""
    with ExitStack() as stack:
        try:
            start = int(dataset.tags()["GEOAIM_DOUBT"].rstrip(",").rpartition("/")[2])
            address = DOUBT_ADDRESS.format(start) + os.fspath(path)
            doubt = stack.enter_context(rasterio.open(address, driver="GTiff", sharing=False))
        except (KeyError, ValueError, RasterioIOError):
            doubt = None
        is_whole = doubt and doubt.shape == dataset.shape and doubt.descriptions == DOUBT_BANDS
        yield doubt if is_whole else None


def _make_profile(aim: AIM, dtype: str, count: int) -> dict[str, Any]:
    """The profile of rasterio of a cloud-optimised, lossless GeoTIFF."""
    height, width = aim.coverage.shape
    return {
        "driver": "COG",
        "height": height,
        "width": width,
        "dtype": dtype,
        "count": count,
        "crs": aim.world.crs,
        "transform": rasterio.Affine(*aim.grid.crs_from_grid[:2].flat),
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
    dataset.write(np.moveaxis(aim.image, -1, 0))
    dataset.write_mask(aim.coverage > 0)
    dataset.colorinterp = [ColorInterp.red, ColorInterp.green, ColorInterp.blue]
    dataset.descriptions = BANDS


def _append_doubt(path: Path, aim: AIM) -> None:
    """Append coverage and contested pixels as a second GeoTIFF; a tag of the first says where.

    Tile servers take all bands for the picture, and an internal second image makes QGIS ask which
    one is meant.
    """
    start = path.stat().st_size
    profile = _make_profile(aim, "uint16", len(DOUBT_BANDS))
    with _allow_identity_transform(), create_raster_file(path, profile, append=True) as dataset:
        dataset.write(np.stack([aim.coverage, aim.contested * np.uint16(255)]))
        dataset.descriptions = DOUBT_BANDS
    with path.open("r+b") as file, mmap(file.fileno(), start) as data:
        place = data.find(DOUBT_PLACEHOLDER.encode())
        data[place : place + len(DOUBT_PLACEHOLDER)] = DOUBT_ADDRESS.format(start).encode()


def _write_tags(dataset: Any, aim: AIM) -> None:
    frame = {
        "format": FORMAT.newest,
        "world": {"crs": aim.world.crs, "origin": aim.world.origin},
        "world_from_image": aim.world_from_image.tolist(),
    }
    dataset.update_tags(
        GEOAIM=json.dumps(frame),
        GEOAIM_DOUBT=DOUBT_PLACEHOLDER,
        GEOAIM_REPORT=json.dumps(aim.report),
        GEOAIM_CHECKSUM=PLACEHOLDER,
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
    found = dataset.descriptions[: len(BANDS)]  # programs make an alpha band of a mask
    if found != BANDS or set(dataset.dtypes) != {"uint8"}:
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
