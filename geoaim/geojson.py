"""Hand-drawn shapes: GeoJSON <-> shapely geometries in the world."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import shapely
from shapely.geometry import mapping, shape
from shapely.geometry.base import BaseGeometry

from geoaim.errors import MapError
from geoaim.files import atomic_write
from geoaim.world import World, lonlat_from_world, world_from_lonlat


@dataclass(frozen=True, eq=False)
class Feature:
    """A shape and its properties.

    Attributes:
        geometry: coordinates are metres in some world.
        properties: as the file states them.
    """

    geometry: BaseGeometry
    properties: Mapping[str, Any] = field(default_factory=dict)


def read_features(path: str | os.PathLike[str], world: World) -> list[Feature]:
    """Read a GeoJSON file in longitude and latitude, or in metres for a world without a CRS.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: the file is not GeoJSON.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
        features = [
            Feature(shape(item.get("geometry", item)), item.get("properties") or {})
            for item in content.get("features", [content])
        ]
    except (ValueError, TypeError, KeyError, AttributeError, shapely.errors.ShapelyError) as error:
        raise MapError(f"{path} is not GeoJSON: {error}") from error
    if world.crs is None:
        return features
    return [
        Feature(
            shapely.transform(feature.geometry, lambda points: world_from_lonlat(world, points)),
            feature.properties,
        )
        for feature in features
    ]


def write_features(features: list[Feature], world: World, path: str | os.PathLike[str]) -> None:
    """Write a GeoJSON file in longitude and latitude, or in metres for a world without a CRS.

    Args:
        features: the shapes to write.
        world: the plane of their coordinates.
        path: the .geojson file.
    """
    rows = []
    for feature in features:
        geometry = feature.geometry
        if world.crs is not None:
            geometry = shapely.transform(geometry, lambda points: lonlat_from_world(world, points))
        properties = dict(feature.properties)
        rows.append({"type": "Feature", "properties": properties, "geometry": mapping(geometry)})
    with atomic_write(path) as temporary:
        content = {"type": "FeatureCollection", "features": rows}
        temporary.write_text(json.dumps(content), encoding="utf-8")
