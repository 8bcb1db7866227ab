"""Commands to try geoaim, to measure it on one's own video, and to see what is missing."""

import os
import platform
import re
import shutil
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Annotated

import typer

import geoaim
from geoaim import __version__
from geoaim.cli import options
from geoaim.cli.console import console, print_result, report_errors

PACKAGE = Path(geoaim.__file__).resolve().parent
NAME = "samples"  # a link in the package, which a checkout on Windows does not follow


def sample(folder: Annotated[Path, typer.Argument(help="folder to write, new or empty")]) -> None:
    """Write a recording to try everything on: video, tracks, lights, HD map and imagery.

    It is of a made place, so that the truth of everything is known. README.md in the folder
    describes each file. The folder appears when it is complete; no existing file is replaced or
    deleted, earlier samples included.

    Example: geoaim sample place
    """
    with report_errors():
        write_sample(folder)
    console.print(f"{folder}: see {folder / 'README.md'}")


def write_sample(folder: Path) -> None:
    """Write the files of the bundled recording into a folder, which appears when it is complete."""
    from geoaim.base.files import atomic_folder

    source = find_sample()
    with atomic_folder(folder) as temporary:
        for path in sorted(source.rglob("*")):
            if path.is_file():
                target = temporary / path.relative_to(source)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, target)


def find_sample() -> Path:
    """Find the bundled recording, in the package or beside it in a checkout."""
    places = (PACKAGE / NAME, PACKAGE.parent / NAME)
    found = next((place for place in places if place.is_dir()), None)
    if found is None:
        raise FileNotFoundError(
            f"the bundled recording is missing from {PACKAGE}; install geoaim again from its wheel"
        )
    return found.resolve()


def doctor(as_json: options.AsJson = False) -> None:
    """Print versions, drivers, threads, GPU and folders: what a bug report needs.

    Example: geoaim doctor
    """
    import cv2
    import rasterio
    import torch
    from rasterio.drivers import raster_driver_extensions

    with report_errors():
        names = [re.split("[<>=]", line)[0] for line in requires("geoaim") or [] if ";" not in line]
        is_gpu = torch.cuda.is_available()
        data = os.environ.get("GEOAIM_DATA")
        folder = Path.cwd()
        lines = {
            "geoaim": f"{__version__} at {Path(__file__).parents[1]}",
            "Python": f"{platform.python_version()} on {platform.platform()}",
            **{name: _find_version(name) for name in sorted(names)},
            "GDAL": rasterio.__gdal_version__,
            "PROJ": _describe_proj(),
            "raster drivers": str(len(set(raster_driver_extensions().values()))),
            "processors": str(os.cpu_count()),
            "threads": f"OpenCV {cv2.getNumThreads()}, torch {torch.get_num_threads()}",
            "GPU": torch.cuda.get_device_name() if is_gpu else "none that torch can use",
            "GEOAIM_DATA": "not set" if data is None else _describe_folder(Path(data)),
            "working folder": _describe_folder(folder),
        }
    print_result([], lines, as_json)


def _find_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


def _describe_proj() -> str:
    """Describe PROJ, and the grids on which accurate transformations between datums depend."""
    import pyproj
    from pyproj.datadir import get_data_dir, get_user_data_dir  # type: ignore[attr-defined]
    from pyproj.network import is_network_enabled  # type: ignore[attr-defined]

    folders = {Path(part) for part in (*get_data_dir().split(os.pathsep), get_user_data_dir())}
    grids = sorted({file.name for folder in folders for file in folder.glob("*.tif")})
    listed = f"{len(grids)} ({', '.join(grids[:5])})" if grids else "none"
    network = "on" if is_network_enabled() else "off"
    return f"{pyproj.proj_version_str}; grids: {listed}; network for missing ones: {network}"


def _describe_folder(folder: Path) -> str:
    if not folder.is_dir():
        return f"{folder}: no such folder"
    return f"{folder}: {'can' if os.access(folder, os.W_OK) else 'cannot'} be written to"
