"""The benchmarks of HD maps on tiny input."""

import cv2
import numpy as np
import pytest
from shapely import MultiPolygon, box

from geoaim.aim import AIM
from geoaim.bench import drivable, overlay
from geoaim.hdmap.lanelet2 import HDMap, Lanelet, MapLine
from geoaim.world import World


def test_share_of_positions_on_the_drivable_area():
    area = MultiPolygon([box(0, 0, 10, 4)])
    positions = np.array([[1.0, 1], [5, 2], [5, 4.5], [5, 6]])
    row = drivable._measure_share("a", area, positions)
    assert row["places"] == 4
    assert row["on the drivable area, %"] == 50
    assert row["within 0.7 m of it, %"] == 75
    assert row["furthest, m"] == 2


def test_paint_is_located_beside_its_line():
    image = np.full((200, 400, 3), 90, np.uint8)  # 0.1 m a pixel
    cv2.line(image, (0, 98), (399, 98), (230, 230, 230), 2)
    matrix = np.array([[0.1, 0, 0], [0, -0.1, 10], [0, 0, 1.0]])
    aim = AIM.from_image(image, matrix, World(None), "a test")
    points = np.array([[1.0, 0.0], [39.5, 0.0]])
    below, side = points - np.array([0.0, 0.1]), np.array([0.0, 4.0])
    np.testing.assert_allclose(
        overlay.measure_paint_offsets(aim, below), np.full(38, 0.25), atol=0.02
    )
    line = MapLine("line_thin", "solid", points)
    hdmap = HDMap(
        (line,), (Lanelet("road", True, points + side, points - side),), (), (), World(None)
    )
    row = overlay._measure_overlay("a", aim, hdmap)
    assert (row["m a pixel"], row["places"]) == (pytest.approx(0.1), 38)
    assert row["median, px"] == pytest.approx(1.5, abs=0.2)
