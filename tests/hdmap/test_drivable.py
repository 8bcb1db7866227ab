import json

import numpy as np
import pytest
import shapely
from shapely import MultiPolygon, Polygon, box
from shapely.geometry import mapping

from geoaim.base.errors import MapError
from geoaim.base.geojson import Feature
from geoaim.base.world import World
from geoaim.hdmap.drivable import find_drivable_area, read_drivable_area, sample_lane_directions
from geoaim.hdmap.lanelet2 import HDMap, Lanelet, MapLine, read_hdmap
from geoaim.tracks.formats import read_tracks
from tests.geojson_files import write_features

LANE = Lanelet("road", True, np.array([[0.0, 3], [30, 3]]), np.array([[0.0, 0], [30, 0]]))
NEXT = Lanelet("road", True, np.array([[30.0, 6.2], [0, 6.2]]), np.array([[30.0, 3.2], [0, 3.2]]))
WALK = Lanelet("walkway", False, np.array([[0.0, 9], [30, 9]]), np.array([[0.0, 7], [30, 7]]))


def _map(*lanelets):
    lines = tuple(MapLine("curbstone", "low", side) for x in lanelets for side in (x.left, x.right))
    return HDMap(lines, lanelets, (), (), World(None))


def test_lanes_are_driven_and_narrow_gaps_between_them():
    area = find_drivable_area(_map(LANE, NEXT, WALK))
    assert area.area == pytest.approx(30 * 6.2)
    assert area.contains(shapely.Point(10, 3.1))
    assert not area.contains(shapely.Point(10, 8))
    with pytest.raises(MapError, match="only walkway"):
        find_drivable_area(_map(WALK))


def test_directions_are_those_of_the_lanes():
    places, directions, reaches = sample_lane_directions(_map(LANE, NEXT, WALK))
    assert np.allclose(np.cos(directions[places[:, 1] < 3]), 1)
    assert np.allclose(np.cos(directions[places[:, 1] > 3]), -1)
    assert places[:, 1].max() < 5
    assert np.allclose(reaches, np.hypot(1.5, 0.5))


@pytest.mark.parametrize("world", [World(None), World("EPSG:32635", (583200.0, 6062200.0))])
def test_drawn_area_comes_back(tmp_path, world):
    hole = box(4, 4, 6, 6).exterior.coords
    area = MultiPolygon([Polygon(box(0, 0, 10, 10).exterior, [hole]), box(20, 0, 25, 5)])
    write_features([Feature(area)], world, tmp_path / "area.geojson")
    again = read_drivable_area(tmp_path / "area.geojson", world)
    assert again.symmetric_difference(area).area < 1e-3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<kml/>", "is not GeoJSON, or is damaged"),
        (json.dumps({"type": "Point", "coordinates": [1, 2]}), "holds Point; polygons are needed"),
        (json.dumps({"type": "FeatureCollection", "features": []}), "holds nothing"),
        (json.dumps(mapping(Polygon())), "encloses 0 m².*for metres"),
        (json.dumps(mapping(box(27.5, 53.9, 27.502, 53.901))), "encloses 2e-06 m².*for metres"),
    ],
)
def test_what_is_no_area_is_refused(tmp_path, content, message):
    path = tmp_path / "area.geojson"
    path.write_text(content)
    with pytest.raises(MapError, match=message):
        read_drivable_area(path, World(None))


def test_bundled_vehicles_drive_where_the_map_says():
    tracks = read_tracks("samples/tracks.csv")
    area = find_drivable_area(read_hdmap("samples/map_full.osm", tracks.world))
    wheels = [kind in ("car", "van", "truck", "bus") for kind in tracks.types]
    places = tracks.states[wheels][tracks.present[wheels]][:, :2]
    assert shapely.contains_xy(area, places[:, 0], places[:, 1]).mean() > 0.99
