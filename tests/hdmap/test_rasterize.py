import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geoaim.base.errors import MapError
from geoaim.base.geometry import transform_points
from geoaim.base.world import World
from geoaim.hdmap.lanelet2 import HDMap, MapLine, read_hdmap
from geoaim.hdmap.rasterize import GROUND, LINES, draw_hdmap


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


def test_zebra_markings_are_drawn():
    hdmap = read_hdmap("samples/map.osm")
    ends = np.concatenate([lanelet.left for lanelet in hdmap.lanelets])[[0, -1]]

    def draw(kind):
        lines = (*hdmap.lines, MapLine(kind, "", ends))
        return draw_hdmap(replace(hdmap, lines=lines), resolution=0.5).image

    assert (draw("zebra_marking") == draw("zebra")).all()
    assert (draw("zebra") != draw("a kind that is not drawn")).any()


def test_absurd_resolution_is_refused():
    line = MapLine("curbstone", "low", np.array([[0.0, 3], [30, 3]]))
    hdmap = HDMap((line,), (), (), (), World(None))
    with pytest.raises(MapError, match="would have"):
        draw_hdmap(hdmap, resolution=0.0005)
