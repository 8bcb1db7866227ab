import numpy as np
import pytest
from shapely import MultiPolygon, box

from geoaim.base.errors import GeoaimWarning, MapError
from geoaim.base.geometry import transform_points
from geoaim.hdmap import drivable
from geoaim.hdmap.drivable import compute_signed_distance


def test_distance_is_negative_on_the_road():
    distance, grid = compute_signed_distance(MultiPolygon([box(0, 0, 30, 6)]), resolution=0.5)
    [[column, row]] = transform_points(grid.grid_from_world, np.array([[10.0, 2.0]])).astype(int)
    assert distance[row, column] == pytest.approx(-2, abs=0.3)
    assert distance.max() > 18


def test_distance_of_nothing_is_refused():
    for nothing in (MultiPolygon(), MultiPolygon([box(0.01, 0, 0.02, 30)])):
        with pytest.raises(MapError, match=r"is empty|narrower than 0\.05 m"):
            compute_signed_distance(nothing, resolution=0.2)


def test_distance_of_a_large_area_is_coarser(monkeypatch):
    monkeypatch.setattr(drivable, "MAX_CELLS", 1000)
    with pytest.warns(GeoaimWarning, match=r"70 x 46 m are too large.*computed every 1\.8 m"):
        distance, _ = compute_signed_distance(MultiPolygon([box(0, 0, 30, 6)]), resolution=0.2)
    assert distance.size < 1200
