"""Raster files: opened without reading other files or sending requests, and written whole."""

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rasterio
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning, RasterioIOError
from rasterio.io import MemoryFile

SIGNATURES = {  # first bytes of files, by GDAL's driver
    "GTiff": (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    "JPEG": (b"\xff\xd8\xff",),
    "PNG": (b"\x89PNG",),
    "WEBP": (b"RIFF",),
    "JP2OpenJPEG": (b"\0\0\0\x0cjP  ", b"\xff\x4f\xff\x51"),
    "GIF": (b"GIF8",),
    "BMP": (b"BM",),
    "MBTiles": (b"SQLite format 3\0",),
}
IMAGE_DRIVERS = tuple(SIGNATURES)
SETTINGS = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # .ovr and .msk beside a file may name others
    "GDAL_PAM_ENABLED": "NO",  # .aux.xml files may do the same
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "none",
    "GDAL_ERROR_ON_LIBJPEG_WARNING": "YES",  # else a truncated JPEG ends in grey
}
# for the header alone, of which GDAL opens no other file
SIDE_FILE_SETTINGS = SETTINGS | {"GDAL_DISABLE_READDIR_ON_OPEN": "TRUE", "GDAL_PAM_ENABLED": "YES"}


@contextmanager
def open_raster_file(
    path: str | os.PathLike[str],
    drivers: Sequence[str] = IMAGE_DRIVERS,
    *,
    options: Mapping[str, int] | None = None,
) -> Iterator[Any]:
    """Open a raster file by one of GDAL's drivers that read a single file.

    The driver is chosen by the file's first bytes (`SIGNATURES`).

    Raises:
        FileNotFoundError: there is no such file.
        RasterioIOError: none of the drivers reads the file, or it names another file.
    """
    with warnings.catch_warnings(), rasterio.Env(**SETTINGS):
        # an AIM with pixels of one metre has an identity transform too
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        driver = _recognise(Path(path), drivers)
        if Path(f"{path}.msk").exists():
            raise RasterioIOError(f"its mask is in another file, {path}.msk; write both into one")
        with rasterio.open(Path(path), driver=driver, sharing=False, **options or {}) as dataset:
            if names := list(dataset.tags(ns="OVERVIEWS")):  # GDAL would open what they name
                raise RasterioIOError(
                    f"its tag {names[0]} (domain OVERVIEWS) names another file for its overviews; "
                    f"copy it without tags: gdal_translate -nomd {Path(path).name} copy.tif"
                )
            yield dataset


def read_georeference(
    path: str | os.PathLike[str], *, options: Mapping[str, int] | None = None
) -> tuple[rasterio.Affine | None, CRS | None]:
    """Read the transform and the CRS of a raster, or of the .aux.xml or world file beside it.

    Raises:
        FileNotFoundError: there is no such file.
        RasterioIOError: none of the drivers reads the file.
    """
    with warnings.catch_warnings(), rasterio.Env(**SIDE_FILE_SETTINGS):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        driver = _recognise(Path(path), IMAGE_DRIVERS)
        with rasterio.open(Path(path), driver=driver, sharing=False, **options or {}) as dataset:
            return None if dataset.transform.is_identity else dataset.transform, dataset.crs


@contextmanager
def create_raster_file(
    path: str | os.PathLike[str], profile: Mapping[str, object], *, append: bool = False
) -> Iterator[Any]:
    """Yield a new dataset with rasterio's profile; its file is written when the block ends.

    With `append` it is written behind what the file holds.

    It is made in memory first: on a full disk GDAL leaves a part of the file without an error.
    """
    with MemoryFile() as memory:
        with memory.open(**profile) as dataset:
            yield dataset
        with Path(path).open("ab" if append else "wb") as file:
            file.write(memory.getbuffer())


def _recognise(path: Path, drivers: Sequence[str]) -> str:
    """The driver of a file by its first bytes."""
    with path.open("rb") as file:
        head = file.read(16)
    for driver in drivers:
        named = driver != "MBTiles" or path.suffix.lower() == ".mbtiles"  # others are not checked
        if named and head.startswith(SIGNATURES[driver]):
            return driver
    raise RasterioIOError(f"not recognized as {' or '.join(drivers)}")
