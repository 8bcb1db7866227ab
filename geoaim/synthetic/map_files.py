"""A synthetic place's HD maps and surfaces as files."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Polygon

from geoaim.geometry import transform_points
from geoaim.synthetic.place import Place
from geoaim.synthetic.roads.lanelet import make_lanelet_map
from geoaim.synthetic.roads.paving import outline_crossing
from geoaim.synthetic.sample import Sample
from geoaim.world import lonlat_from_world


def write_maps(sample: Sample, folder: Path) -> None:
    """Write `map.osm`, as HD maps often are, `map_full.osm` with everything, and all surfaces."""
    place = sample.place
    frame = place.roads, place.world_from_plan, place.world
    (folder / "map.osm").write_bytes(make_lanelet_map(*frame))
    (folder / "map_full.osm").write_bytes(make_lanelet_map(*frame, complete=True))
    paving = place.roads.paving
    surfaces = {
        "carriageway": paving.carriageway,
        "island": paving.islands,
        "pavement": shapely.union_all([paving.pavement, place.roads.footpaths.surface]),
        "drive": paving.drive,
        "car park": paving.lot,
    }
    features = [
        _make_feature(place, geometry, {"kind": kind}) for kind, geometry in surfaces.items()
    ]
    for crossing in place.roads.crossings:
        properties = {"kind": "crossing", "name": crossing.name, "marked": crossing.marked}
        features.append(_make_feature(place, outline_crossing(crossing), properties))
    features = [feature for feature in features if feature["geometry"]["coordinates"]]
    content = {"type": "FeatureCollection", "features": features}
    (folder / "surfaces.geojson").write_bytes((json.dumps(content) + "\n").encode())


def _make_feature(
    place: Place, geometry: shapely.Geometry, properties: dict[str, Any]
) -> dict[str, Any]:
    """Make a GeoJSON feature of the part of a geometry that lies within the place."""
    parts = shapely.get_parts(geometry.intersection(place.roads.extent))
    polygons = [
        Polygon(*_convert_rings(place, part))
        for part in parts
        if part.geom_type == "Polygon" and part.area
    ]
    whole = shapely.make_valid(shapely.MultiPolygon(polygons), method="structure")
    parts = shapely.get_parts(shapely.set_precision(whole, 1e-9))  # rounded, and still valid
    shape = shapely.MultiPolygon([part for part in parts if part.geom_type == "Polygon"])
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": shapely.geometry.mapping(shape),
    }


def _convert_rings(
    place: Place, part: Polygon
) -> tuple[list[list[float]], list[list[list[float]]]]:
    """Convert a polygon's outline and holes to longitude and latitude."""
    first, *holes = (
        _to_lonlat(place, np.array(ring.coords)) for ring in (part.exterior, *part.interiors)
    )
    return first, holes


def _to_lonlat(place: Place, points: Float[Array, "m 2"]) -> list[list[float]]:
    world = transform_points(place.world_from_plan, points)
    return np.round(lonlat_from_world(place.world, world), 9).tolist()
