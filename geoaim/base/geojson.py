"""Hand-drawn shapes: GeoJSON -> shapely geometries in the world."""

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely.geometry import shape
from shapely.geometry.base import BaseGeometry

from geoaim.base.errors import GeoreferenceError, MapError, warn
from geoaim.base.limits import name_file, refuse_damaged
from geoaim.base.world import (
    LONLAT,
    World,
    find_operation,
    lonlat_from_world,
    parse_crs,
    warn_of_operation,
    world_from_crs,
)

NEEDED = "GeoJSON"
OTHERS = (".kml", ".kmz", ".gpkg", ".shp", ".fgb")  # suffixes of other formats of shapes
GEOMETRIES = ("Point", "LineString", "Polygon", "MultiPoint", "MultiLineString", "MultiPolygon")
TYPES = ("FeatureCollection", "Feature", *GEOMETRIES, "GeometryCollection")
NEAR_DEGREES = 2.0  # between shapes and the map that they are drawn on


@dataclass(frozen=True, eq=False)
class Feature:
    """A shape and its properties in the file."""

    geometry: BaseGeometry  # in metres of a world, or not placed yet
    properties: Mapping[str, Any] = field(default_factory=dict)


def read_features(path: str | os.PathLike[str], world: World) -> list[Feature]:
    """Read the shapes of a GeoJSON file as metres of the world.

    Coordinates are longitude and latitude, or those of the CRS that a member `crs` names, as files
    of before 2016 do. For a world without a CRS the file is in metres, too, and names none.
    Features without a geometry are left out, with a warning.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: the file is not GeoJSON, has no geometry, or lies elsewhere than the world.
    """
    with refuse_damaged(path, MapError, NEEDED, reads_once=True):
        crs, features = _load_features(path)
    if world.crs is None:
        if crs is not None:
            raise MapError(
                f"{path} names the CRS {crs}, and the world is a local plane without one; remove "
                "the member crs if its numbers are metres of that plane"
            )
        return features
    points = shapely.get_coordinates([feature.geometry for feature in features])
    _check_place(path, points, crs or LONLAT, world)

    def place(points: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
        return world_from_crs(world, points, crs or LONLAT)

    if crs is not None and len(points):
        warn_of_operation(find_operation(crs, world.crs, points), crs, world.crs)
    with name_file(path):
        return [
            replace(feature, geometry=shapely.transform(feature.geometry, place))
            for feature in features
        ]


def list_features(path: str | os.PathLike[str]) -> list[Feature]:
    """List the shapes of a GeoJSON file, with their properties, in its own coordinates.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: the file is not GeoJSON, or has no geometry.
    """
    with refuse_damaged(path, MapError, NEEDED, reads_once=True):
        return _load_features(path)[1]


def _load_features(path: str | os.PathLike[str]) -> tuple[str | None, list[Feature]]:
    """Load the CRS that a file names, if any, and its features in the file's coordinates."""
    if (given := Path(path)).suffix.lower() in OTHERS:
        raise MapError(
            f"{path} is not GeoJSON, as which shapes are read: make it by "
            f"ogr2ogr -f GeoJSON {given.stem}.geojson {given.name}, or by QGIS's Save Features As"
        )
    content = json.loads(Path(path).read_text(encoding="utf-8-sig"))
    if content.get("type") not in TYPES:
        raise ValueError(f"its type is {content.get('type')!r}; {', '.join(TYPES)} are known")
    items = content["features"] if content["type"] == "FeatureCollection" else [content]
    shapes = [item.get("geometry") if item.get("type") == "Feature" else item for item in items]
    crs = _parse_crs_member(content["crs"]) if content.get("crs") is not None else None
    if any(part.get("crs") for part in (*items, *filter(None, shapes)) if part is not content):
        raise ValueError("a feature has a member crs of its own; name one for the whole file")
    features = [
        Feature(shape(found), dict(item.get("properties") or {}))
        for item, found in zip(items, shapes, strict=True)
        if found is not None
    ]
    for feature in features:
        if not np.isfinite(shapely.get_coordinates(feature.geometry)).all():
            raise ValueError("a coordinate is not a finite number")
    if empty := len(items) - len(features):
        if not features:
            raise ValueError(f"none of its {empty} features has a geometry")
        warn(f"{path}: {empty} of {len(items)} features have no geometry and are left out")
    return crs, features


def _parse_crs_member(member: Any) -> str:
    """Parse the member `crs` of GeoJSON 2008 (geojson.org/geojson-spec.html, section 3)."""
    if member.get("type") not in ("name", "EPSG"):
        raise ValueError(f"its crs is of type {member.get('type')!r}; one with a name is needed")
    properties = member["properties"]
    name = str(properties.get("name") or f"EPSG:{properties.get('code')}")
    if re.search(r"CRS:?84$", name):  # longitude first; coordinates are so in any CRS
        return LONLAT
    try:
        epsg = parse_crs(name).to_epsg()
    except GeoreferenceError as error:
        raise ValueError(str(error)) from error
    return name if epsg is None else f"EPSG:{epsg}"


def _check_place(
    path: str | os.PathLike[str], points: Float[Array, "m 2"], crs: str, world: World
) -> None:
    """Refuse coordinates that are no degrees, or with latitude first."""
    if not len(points) or not parse_crs(crs).is_geographic:
        return
    largest = float(np.abs(points).max())
    if largest > 360.0:
        raise MapError(
            f"{path} has coordinates up to {largest:.7g}, which are no degrees of longitude and "
            'latitude; transform it to EPSG:4326, or name its CRS: "crs": {"type": "name", '
            '"properties": {"name": "EPSG:..."}}'
        )
    lon, lat = lonlat_from_world(world, np.zeros((1, 2)))[0]
    middle = points.mean(axis=0)
    if _is_near(middle[::-1], lon, lat) and not _is_near(middle, lon, lat):
        raise MapError(
            f"{path} lies about {middle[0]:g}, {middle[1]:g}, and the map about longitude {lon:g}, "
            f"latitude {lat:g}: latitude stands first. Write longitude first"
        )


def _is_near(place: Float[Array, "2"], lon: float, lat: float) -> bool:
    return bool(np.abs(place - [lon, lat]).max() < NEAR_DEGREES)
