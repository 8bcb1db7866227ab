"""Hand-drawn shapes: GeoJSON -> shapely geometries in the world."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import shape
from shapely.geometry.base import BaseGeometry

from geoaim.base.errors import MapError
from geoaim.base.limits import refuse_damaged
from geoaim.base.world import World, world_from_lonlat


@dataclass(frozen=True, eq=False)
class Feature:
    """A shape and its properties in the file."""

    geometry: BaseGeometry  # in metres of a world
    properties: Mapping[str, Any] = field(default_factory=dict)


def read_features(path: str | os.PathLike[str], world: World) -> list[Feature]:
    """Read the shapes of a GeoJSON file in longitude and latitude, as metres of the world.

    For a world without a CRS the file is in metres, too.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: the file is not GeoJSON.
    """

    def place(geometry: BaseGeometry) -> BaseGeometry:
        if world.crs is None:
            return geometry
        return shapely.transform(geometry, lambda points: world_from_lonlat(world, points))

    with refuse_damaged(path, MapError, "GeoJSON", reads_once=True):
        content = json.loads(Path(path).read_text(encoding="utf-8-sig"))
        features = [
            (shape(item.get("geometry", item)), dict(item.get("properties") or {}))
            for item in content.get("features", [content])
        ]
        for geometry, _ in features:
            if not np.isfinite(shapely.get_coordinates(geometry)).all():
                raise ValueError("a coordinate is not a finite number")
        return [Feature(place(geometry), properties) for geometry, properties in features]
