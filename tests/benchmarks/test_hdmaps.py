"""The benchmarks of HD maps on tiny input."""

import numpy as np
from shapely import MultiPolygon, box

from benchmarks.simulation import drivable


def test_share_of_positions_on_the_drivable_area():
    area = MultiPolygon([box(0, 0, 10, 4)])
    positions = np.array([[1.0, 1], [5, 2], [5, 4.5], [5, 6]])
    row = drivable._measure_share("a", area, positions)
    assert row["places"] == 4
    assert row["on the drivable area, %"] == 50
    assert row["within 0.7 m of it, %"] == 75
    assert row["furthest, m"] == 2
