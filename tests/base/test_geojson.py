"""GeoJSON as GIS programs write it: CRS members, empty geometries, swapped axes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from shapely.geometry import mapping

from geoaim.base.errors import GeoaimWarning, MapError
from geoaim.base.geojson import list_features, read_features
from geoaim.base.world import World, lonlat_from_world, transform_crs

WORLD = World("EPSG:32635", (583_000.0, 6_062_000.0))
SHAPE = shapely.box(100.0, 200.0, 180.0, 260.0)
LONLAT_SHAPE = shapely.transform(SHAPE, lambda points: lonlat_from_world(WORLD, points))


def write(
    path: Path, shape: Any = LONLAT_SHAPE, *, more: tuple[Any, ...] = (), **members: Any
) -> Path:
    features = [
        {"type": "Feature", "properties": None, "geometry": part and mapping(part)}
        for part in (shape, *more)
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features} | members))
    return path


def name_crs(name: str) -> dict[str, Any]:
    return {"type": "name", "properties": {"name": name}}


def find_error(path: Path) -> float:
    """Largest distance of the corners from where they should be, m."""
    found = shapely.get_coordinates(read_features(path, WORLD)[0].geometry)
    return float(np.abs(found - shapely.get_coordinates(SHAPE)).max())


@pytest.mark.parametrize(
    "name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "EPSG:4326", "urn:ogc:def:crs:EPSG::4326"]
)
def test_degrees_with_a_crs_member_are_longitude_first(tmp_path: Path, name: str) -> None:
    assert find_error(write(tmp_path / "a.geojson", crs=name_crs(name))) < 1e-3


@pytest.mark.parametrize("crs", ["EPSG:32635", "EPSG:3857", "EPSG:4284"])
def test_coordinates_of_another_crs_are_transformed(tmp_path: Path, crs: str) -> None:
    def place(points: np.ndarray) -> np.ndarray:
        return transform_crs("EPSG:4326", crs, points)

    shape = shapely.transform(LONLAT_SHAPE, place)
    path = write(tmp_path / "a.geojson", shape, crs=name_crs(f"urn:ogc:def:crs:EPSG::{crs[5:]}"))
    assert find_error(path) < 0.01


def test_a_feature_without_geometry_is_left_out_with_a_warning(tmp_path: Path) -> None:
    path = write(tmp_path / "a.geojson", more=(None,))
    with pytest.warns(GeoaimWarning, match="1 of 2 features have no geometry"):
        assert len(read_features(path, WORLD)) == 1


@pytest.mark.parametrize(
    ("members", "shape", "message"),
    [
        ({}, None, "none of its 1 features has a geometry"),
        ({"crs": {"type": "link", "properties": {"href": "a"}}}, LONLAT_SHAPE, "of type 'link'"),
        ({"crs": name_crs("EPSG:999999")}, LONLAT_SHAPE, "not a known coordinate reference"),
        ({"type": "Topology"}, LONLAT_SHAPE, "its type is 'Topology'"),
        ({}, SHAPE.buffer(1e6), "no degrees"),
    ],
)
def test_what_tells_no_place_is_refused(
    tmp_path: Path, members: dict[str, Any], shape: Any, message: str
) -> None:
    with pytest.raises(MapError, match=message):
        read_features(write(tmp_path / "a.geojson", shape, **members), WORLD)


def test_latitude_first_is_named(tmp_path: Path) -> None:
    swapped = shapely.transform(LONLAT_SHAPE, lambda points: points[:, ::-1])
    with pytest.raises(MapError, match="latitude stands first"):
        read_features(write(tmp_path / "a.geojson", swapped), WORLD)


def test_a_crs_contradicts_a_local_plane(tmp_path: Path) -> None:
    path = write(tmp_path / "a.geojson", crs=name_crs("EPSG:4326"))
    with pytest.raises(MapError, match="names the CRS EPSG:4326, and the world is a local plane"):
        read_features(path, World(None))
    assert [feature.geometry.geom_type for feature in list_features(path)] == ["Polygon"]


@pytest.mark.parametrize("suffix", [".kml", ".kmz", ".gpkg", ".shp"])
def test_shapes_of_other_formats_are_told_how_to_become_geojson(tmp_path, suffix):
    path = tmp_path / f"drive{suffix}"
    path.write_bytes(b"\xa0")
    with pytest.raises(MapError, match=rf"ogr2ogr -f GeoJSON drive\.geojson drive\{suffix}"):
        read_features(path, WORLD)
