"""Write shapes as GeoJSON, for tests of readers."""

import json
from pathlib import Path

import shapely
from shapely.geometry import mapping

from geoaim.base.geojson import Feature
from geoaim.base.world import World, lonlat_from_world


def write_features(features: list[Feature], world: World, path: Path) -> None:
    """Write shapes in longitude and latitude, or in metres for a world without a CRS."""
    rows = []
    for feature in features:
        geometry = feature.geometry
        if world.crs is not None:
            geometry = shapely.transform(geometry, lambda points: lonlat_from_world(world, points))
        properties = dict(feature.properties)
        rows.append({"type": "Feature", "properties": properties, "geometry": mapping(geometry)})
    path.write_text(json.dumps({"type": "FeatureCollection", "features": rows}), encoding="utf-8")
