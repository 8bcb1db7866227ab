import json
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely import MultiPolygon, Polygon, box
from shapely.geometry import mapping

from geoaim.errors import GeoaimWarning, MapError
from geoaim.geometry import transform_points
from geoaim.hdmap import drivable
from geoaim.hdmap.drivable import (
    drivable_area,
    lane_directions,
    read_area,
    signed_distance,
    write_area,
)
from geoaim.hdmap.lanelet2 import HDMap, Lanelet, MapLine, read_hdmap
from geoaim.hdmap.rasterize import GROUND, LINES, draw_hdmap
from geoaim.track_files import read_tracks
from geoaim.world import World

LANE = Lanelet("road", True, np.array([[0.0, 3], [30, 3]]), np.array([[0.0, 0], [30, 0]]))
NEXT = Lanelet("road", True, np.array([[30.0, 6.2], [0, 6.2]]), np.array([[30.0, 3.2], [0, 3.2]]))
WALK = Lanelet("walkway", False, np.array([[0.0, 9], [30, 9]]), np.array([[0.0, 7], [30, 7]]))


def _map(*lanelets):
    lines = tuple(MapLine("curbstone", "low", side) for x in lanelets for side in (x.left, x.right))
    return HDMap(lines, lanelets, (), (), World(None))


def test_lanes_are_driven_and_narrow_gaps_between_them():
    area = drivable_area(_map(LANE, NEXT, WALK))
    assert area.area == pytest.approx(30 * 6.2)
    assert area.contains(shapely.Point(10, 3.1))
    assert not area.contains(shapely.Point(10, 8))
    with pytest.raises(MapError, match="only walkway"):
        drivable_area(_map(WALK))


def test_directions_are_those_of_the_lanes():
    places, directions, reaches = lane_directions(_map(LANE, NEXT, WALK))
    assert np.allclose(np.cos(directions[places[:, 1] < 3]), 1)
    assert np.allclose(np.cos(directions[places[:, 1] > 3]), -1)
    assert places[:, 1].max() < 5
    assert np.allclose(reaches, np.hypot(1.5, 0.5))


def test_distance_is_negative_on_the_road():
    distance, grid = signed_distance(MultiPolygon([box(0, 0, 30, 6)]), resolution=0.5)
    [[column, row]] = transform_points(grid.grid_from_world, np.array([[10.0, 2.0]])).astype(int)
    assert distance[row, column] == pytest.approx(-2, abs=0.3)
    assert distance.max() > 18


def test_distance_of_nothing_is_refused():
    for nothing in (MultiPolygon(), MultiPolygon([box(0.01, 0, 0.02, 30)])):
        with pytest.raises(MapError, match=r"is empty|narrower than 0\.05 m"):
            signed_distance(nothing)


def test_distance_of_a_large_area_is_coarser(monkeypatch):
    monkeypatch.setattr(drivable, "MOST", 1000)
    with pytest.warns(GeoaimWarning, match=r"70 x 46 m are too large.*told every 1\.8 m"):
        distance, _ = signed_distance(MultiPolygon([box(0, 0, 30, 6)]))
    assert distance.size < 1200


@pytest.mark.parametrize("world", [World(None), World("EPSG:32635", (583200.0, 6062200.0))])
def test_drawn_area_comes_back(tmp_path, world):
    hole = box(4, 4, 6, 6).exterior.coords
    area = MultiPolygon([Polygon(box(0, 0, 10, 10).exterior, [hole]), box(20, 0, 25, 5)])
    write_area(area, world, tmp_path / "area.geojson")
    again = read_area(tmp_path / "area.geojson", world)
    assert again.symmetric_difference(area).area < 1e-3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("nonsense", "is not GeoJSON"),
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
        read_area(path, World(None))


def test_bundled_vehicles_drive_where_the_map_says():
    tracks = read_tracks("samples/tracks.csv")
    area = drivable_area(read_hdmap("samples/map_full.osm", tracks.world))
    wheels = [kind in ("car", "van", "truck", "bus") for kind in tracks.types]
    places = tracks.states[wheels][tracks.present[wheels]][:, :2]
    assert shapely.contains_xy(area, places[:, 0], places[:, 1]).mean() > 0.99


def test_drawn_map_lies_where_its_lines_are():
    """Stop lines, within a fifth of a pixel of the truth of the place."""
    truth = json.loads(Path("samples/truth.json").read_text())
    hdmap = read_hdmap("samples/map.osm", World(truth["crs"], tuple(truth["origin"])))
    aim = draw_hdmap(hdmap, resolution=0.2)
    red = (np.abs(aim.image.astype(int) - LINES["stop_line"][0]).sum(axis=2) < 90).astype(float)
    v, u = np.nonzero(red)
    places = transform_points(aim.world_from_image, np.column_stack([u, v]) + 0.5)
    for line in (stop.ends for stop in hdmap.stop_lines):
        along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
        apart = places - line.mean(axis=0)
        near = apart[np.linalg.norm(apart, axis=1) < np.linalg.norm(line[1] - line[0])]
        across = near @ [-along[1], along[0]]
        assert len(near) > 10
        assert abs(across.mean()) < 0.04
    assert (aim.image[0, 0] == GROUND).all()


def test_absurd_resolution_is_refused():
    with pytest.raises(ValueError, match="would have"):
        draw_hdmap(_map(LANE), resolution=0.0005)
