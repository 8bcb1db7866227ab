"""Hand-drawn shapes: GeoJSON to shapely geometries in the world, and back."""

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
    """A shape, metres in some world, and what its file says about it."""

    geometry: BaseGeometry
    properties: Mapping[str, Any] = field(default_factory=dict)


def read_features(path: str | os.PathLike[str], world: World) -> list[Feature]:
    """Read GeoJSON; its numbers are longitude and latitude, or metres of a plane of its own.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: it is no GeoJSON.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
        parts = [
            (shape(part.get("geometry", part)), part.get("properties") or {})
            for part in content.get("features", [content])
        ]
    except (ValueError, TypeError, KeyError, AttributeError, shapely.errors.ShapelyError) as error:
        raise MapError(f"{path} is no GeoJSON: {error}") from error
    if world.crs is not None:
        parts = [
            (shapely.transform(found, lambda points: world_from_lonlat(world, points)), said)
            for found, said in parts
        ]
    return [Feature(found, said) for found, said in parts]


def write_features(features: list[Feature], world: World, path: str | os.PathLike[str]) -> None:
    """Write GeoJSON, in longitude and latitude, or in metres of a plane of its own."""
    rows = []
    for feature in features:
        found = feature.geometry
        if world.crs is not None:
            found = shapely.transform(found, lambda points: lonlat_from_world(world, points))
        rows.append(
            {"type": "Feature", "properties": dict(feature.properties), "geometry": mapping(found)}
        )
    with atomic_write(Path(path)) as temporary:
        content = {"type": "FeatureCollection", "features": rows}
        Path(temporary).write_text(json.dumps(content), encoding="utf-8")
