"""What an MBTiles file says of its tiles: whether its rows count from the south."""

import sqlite3
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import ImageryError
from geoaim.base.sqlite_files import open_sqlite
from geoaim.base.world import LONLAT, transform_crs

MIN_BOUNDS_OVERLAP = 0.5  # share of the tiles' extent that lies within the bounds stated


def check_mbtiles(path: str, outline: Float[Array, "4 2"]) -> None:
    """Refuse an MBTiles file whose rows count from the north, against its specification.

    Args:
        path: the file.
        outline: corners of its tiles, as the specification counts them: EPSG:3857, metres.

    Raises:
        ImageryError: its scheme is xyz and its bounds do not show that this is a slip, or its
            bounds show that its rows count from the north.
    """
    try:
        with open_sqlite(path) as database:
            metadata = dict(database.execute("SELECT name, value FROM metadata").fetchall())
    except sqlite3.Error:
        return  # without metadata it states nothing
    bounds = _parse_bounds(metadata.get("bounds"))
    flipped = outline * [1.0, -1.0]
    is_xyz = str(metadata.get("scheme", "tms")).lower() == "xyz"
    agrees, agrees_flipped = (
        bounds is not None and _overlap(bounds, corners) > MIN_BOUNDS_OVERLAP
        for corners in (outline, flipped)
    )
    if (is_xyz and not agrees) or (agrees_flipped and not agrees):
        stated = "its scheme is xyz" if is_xyz else "its bounds lie where they would be then"
        raise ImageryError(
            f"{path}: its rows count from the north ({stated}), and MBTiles count from the south. "
            "Convert it (mb-util --scheme=xyz to a folder, which is read), or correct its metadata"
        )


def _parse_bounds(text: Any) -> Float[Array, "2 2"] | None:
    """Parse bounds (west, south, east, north in degrees) to metres; None where there are none."""
    try:
        west, south, east, north = (float(part) for part in str(text).split(","))
        corners = np.clip([[west, south], [east, north]], [-180, -85.05], [180, 85.05])
        return transform_crs(LONLAT, "EPSG:3857", corners)
    except ValueError:
        return None


def _overlap(bounds: Float[Array, "2 2"], corners: Float[Array, "4 2"]) -> float:
    """Share of the tiles' extent that lies within the bounds, or of the bounds in the extent."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    common = np.prod(np.clip(np.minimum(high, bounds[1]) - np.maximum(low, bounds[0]), 0, None))
    smaller = min(float(np.prod(high - low)), float(np.prod(bounds[1] - bounds[0])))
    return float(common) / smaller if smaller > 0 else 0.0
