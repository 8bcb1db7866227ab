"""What files beside tiles say of them: from where y is counted, and in which projection."""

import json
import sqlite3
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import ImageryError
from geoaim.base.limits import open_sqlite, refuse_damaged
from geoaim.base.world import LONLAT, transform_crs
from geoaim.imagery.tiles import HALF_WORLD_M, compute_tile_corners, list_tiles

RESOURCE = "tilemapresource.xml"  # of the Tile Map Service, as gdal2tiles writes it
DESCRIPTIONS = ("metadata.json", "tilejson.json", "tiles.json")  # as mbutil and others write them
MERCATOR_NAMES = ("3857", "900913", "3785", "102100", "102113", "OSGEO:41001")
BOX_KEYS = ("minx", "miny", "maxx", "maxy")
BOX_ORDERS = (0, 1, 2, 3), (1, 0, 3, 2)
MAX_ORIGIN_ERROR_M = 1000.0  # of the south-west corner of web Mercator


def read_scheme(folder: Path) -> bool | None:
    """Read from the files beside tiles whether y counts from the south."""
    found = {file: scheme for file, scheme in _list_schemes(folder) if scheme is not None}
    if len(set(found.values())) > 1:
        raise ImageryError(
            f"{', '.join(file.name for file in found)} of {folder} differ in whether y counts from "
            "the south; remove the wrong one"
        )
    return next(iter(found.values()), None)


def _list_schemes(folder: Path) -> list[tuple[Path, bool | None]]:
    resource = folder / RESOURCE
    schemes: list[tuple[Path, bool | None]] = []
    if resource.is_file():
        schemes.append((resource, _read_resource(resource)))
    for name in DESCRIPTIONS:
        file = folder / name
        if file.is_file():
            with refuse_damaged(file, ImageryError, "a description of tiles"):
                content = json.loads(file.read_text("utf-8-sig"))
                schemes.append((file, _parse_scheme(content.get("scheme"), file)))
    return schemes


def _parse_scheme(text: Any, file: Path) -> bool | None:
    if text is None:
        return None
    if str(text).lower() not in ("tms", "xyz"):
        raise ImageryError(f"{file} has the scheme {text!r}; tms and xyz are known")
    return str(text).lower() == "tms"


def _read_resource(file: Path) -> bool:
    """Read a tilemapresource.xml: tiles of web Mercator whose y counts from the south."""
    with refuse_damaged(file, ImageryError, "a description of tiles"):
        content = file.read_bytes()
        if b"<!ENTITY" in content or b"<!DOCTYPE" in content:
            raise ValueError("it defines XML entities")
        root = ElementTree.fromstring(content)
        srs = (root.findtext("SRS") or "").strip().upper()
        sets = root.find("TileSets")
        profile = ("" if sets is None else sets.get("profile", "")).lower()
        origin = root.find("Origin")
        corner = [float(origin.get(axis, "nan")) for axis in "xy"] if origin is not None else []
    is_mercator = not srs or any(srs.endswith(name) for name in MERCATOR_NAMES)
    if not is_mercator or profile not in ("mercator", "global-mercator", ""):
        raise ImageryError(
            f"{file}: its tiles are of the profile {profile or 'unknown'!r} in {srs or 'no CRS'}; "
            "those of web Mercator are read: gdal2tiles --profile=mercator"
        )
    box = root.find("BoundingBox")
    sides = [float((box.attrib if box is not None else {}).get(key, "nan")) for key in BOX_KEYS]
    # of the data, as gdal2tiles writes it
    if corner and all(abs(value) <= 180 for value in (*corner, *sides)):
        return _counts_from_south(file.parent, sides)
    if corner and max(abs(value + HALF_WORLD_M) for value in corner) > MAX_ORIGIN_ERROR_M:
        raise ImageryError(
            f"{file}: its tiles count from {corner[0]:g}, {corner[1]:g}; those that count from the "
            "south-west corner of web Mercator are read"
        )
    return True


def _counts_from_south(folder: Path, sides: list[float]) -> bool:
    """Whether tiles lie in a box of degrees if y counts from the south; --xyz writes the other."""
    tiles = np.array([tile[:3] for tile in list_tiles(folder, tms=True)]).reshape(-1, 3)
    if not len(tiles):
        return True
    level = tiles[tiles[:, 0] == tiles[:, 0].max()]
    corners = compute_tile_corners(
        int(level[0, 0]), level[:, 1:].min(axis=0), level[:, 1:].max(axis=0) + 1
    )
    # old versions exchanged longitude and latitude
    boxes = [_parse_bounds(",".join(str(sides[i]) for i in order)) for order in BOX_ORDERS]
    fits, fits_flipped = (
        any(box is not None and _overlap(box, shape) > MIN_BOUNDS_OVERLAP for box in boxes)
        for shape in (corners, corners * [1.0, -1.0])
    )
    return fits or not fits_flipped


MIN_BOUNDS_OVERLAP = 0.5  # share of the tiles' extent that lies within the bounds stated


def check_mbtiles(path: str, outline: Float[Array, "4 2"]) -> None:
    """Refuse an MBTiles file whose rows count from the north, against its specification."""
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
