"""Describe a map for its record: when it was recorded, its grid and its files."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import av
import numpy as np

from geoaim.aim.aim import AIM
from geoaim.base.geometry import translation
from geoaim.base.world import lonlat_from_world
from geoaim.catalog.records import OutputFile
from geoaim.catalog.storage import get_modified, hash_file
from geoaim.mapping.video.video import IMAGE_SUFFIXES


def find_datetime(stated: str | None, address: str, path: Path) -> tuple[str, str]:
    """Find when a recording was made, and how that is known.

    Args:
        stated: date that the table of recordings states, ISO 8601, or None.
        address: address of the video, or of its first image.
        path: path of the same file on this machine.

    Returns:
        The time, ISO 8601; and "table", "video" or "time of the file".
    """
    if stated is not None:
        return stated, "table"
    if created := _read_creation_time(path):
        return created, "video"
    return get_modified(address).isoformat(timespec="seconds"), "time of the file"


def describe_grid(aim: AIM) -> Mapping[str, Any]:
    """Describe the grid of a map: its CRS, shape, transform, resolution and corners in degrees."""
    height, width = aim.coverage.shape
    crs_from_image = translation(*aim.world.origin) @ aim.world_from_image
    corners = None
    if aim.world.crs is not None:
        corners = np.round(lonlat_from_world(aim.world, aim.corners), 8).tolist()
    return {
        "crs": aim.world.crs,
        "shape": [height, width],
        "transform": crs_from_image[:2].ravel().tolist(),
        "resolution_m": aim.resolution,
        "corners_lonlat": corners,
    }


def describe_files(folder: Path, names: Sequence[str]) -> dict[str, OutputFile]:
    """Describe files of a folder by their sizes and checksums."""
    return {
        name: OutputFile((folder / name).stat().st_size, hash_file(folder / name)) for name in names
    }


def _read_creation_time(path: Path) -> str | None:
    """The time that a video states, ISO 8601; None for images, and where it states none."""
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return None
    try:
        with av.open(f"file:{path}", metadata_errors="replace") as container:
            stated = container.metadata.get("creation_time")
        return datetime.fromisoformat(stated).isoformat() if stated else None
    except (av.FFmpegError, ValueError):
        return None
