import json
from pathlib import Path

import numpy as np
import pytest

from geoaim.errors import MapError
from geoaim.mapping.hdmap import read_hdmap
from geoaim.world import World

NODES = {1: (0, 0), 2: (20, 0), 3: (0, 4), 4: (20, 4), 5: (20, 0), 6: (20, 4)}
METRE = 1 / 111_320  # degrees


def _osm(path, *, left=(3, 4), right=(1, 2), more="", at=(0.0, 0.0), head="<osm version='0.6'>"):
    """A lane of 20 m eastwards with a stop line and a light."""
    nodes = "".join(
        f"<node id='{k}' lon='{at[0] + x * METRE:.9f}' lat='{at[1] + y * METRE:.9f}'/>"
        for k, (x, y) in NODES.items()
    )
    ways = "".join(
        f"<way id='{k}'>{''.join(f'<nd ref={ref!r}/>' for ref in map(str, refs))}"
        f"<tag k='type' v='{kind}'/></way>"
        for k, refs, kind in (
            (10, left, "curbstone"),
            (11, right, "curbstone"),
            (12, (5, 6), "stop_line"),
        )
    )
    relations = (
        "<relation id='20'><member type='way' ref='10' role='left'/>"
        "<member type='way' ref='11' role='right'/><tag k='type' v='lanelet'/></relation>"
        "<relation id='21'><member type='way' ref='12' role='ref_line'/>"
        "<tag k='type' v='regulatory_element'/><tag k='subtype' v='traffic_light'/></relation>"
    )
    path.write_text(f"<?xml version='1.0'?>{head}{nodes}{ways}{relations}{more}</osm>")
    return path


@pytest.mark.parametrize("left", [(3, 4), (4, 3)])
@pytest.mark.parametrize("right", [(1, 2), (2, 1)])
def test_lines_of_a_lanelet_run_along_with_it(tmp_path, left, right):
    (lanelet,) = read_hdmap(_osm(tmp_path / "a.osm", left=left, right=right)).lanelets
    np.testing.assert_allclose(lanelet.left, [[0, 4], [20, 4]], atol=0.1)
    np.testing.assert_allclose(lanelet.right, [[0, 0], [20, 0]], atol=0.1)
    assert (lanelet.subtype, lanelet.one_way) == ("road", True)


def test_light_stops_traffic_at_its_line(tmp_path):
    hdmap = read_hdmap(_osm(tmp_path / "a.osm"))
    assert hdmap.world == World(None)
    (line,) = hdmap.stop_lines
    assert line.signal == "21"
    np.testing.assert_allclose(line.ends, [[20, 0], [20, 4]], atol=0.1)


def test_map_on_the_earth_lies_where_the_samples_truth_says():
    truth = json.loads(Path("samples/truth.json").read_text())
    hdmap = read_hdmap("samples/map.osm", World(truth["crs"], tuple(truth["origin"])))
    for line in hdmap.stop_lines:
        place = np.array(truth["landmarks"][f"stop line {line.signal}"])
        (dx, dy), apart = line.ends[1] - line.ends[0], place - line.ends[0]
        assert abs(dx * apart[1] - dy * apart[0]) / np.hypot(dx, dy) < 0.5
    assert len(hdmap.lanelets) == 26
    assert read_hdmap("samples/map_full.osm").areas[0].subtype == "parking"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"left": (3, 99)}, "way 10 goes through node 99"),
        ({"left": (3,)}, "lanelet 20 has 1 left lines of two points"),
        ({"head": "<html>"}, "is no XML"),
        ({"head": "<!DOCTYPE osm><osm>"}, "defines XML entities"),
        ({"at": (8.0, 49.0)}, "a place on the Earth, and the world is a plane of its own"),
    ],
)
def test_what_is_no_map_of_that_world_is_refused(tmp_path, change, message):
    with pytest.raises(MapError, match=message):
        read_hdmap(_osm(tmp_path / "a.osm", **change), World(None))


def test_road_map_without_lanelets_is_refused(tmp_path):
    path = tmp_path / "a.osm"
    path.write_text("<osm><node id='1' lon='8' lat='49'/></osm>")
    with pytest.raises(MapError, match="no lanelets"):
        read_hdmap(path)
    with pytest.raises(FileNotFoundError):
        read_hdmap(tmp_path / "none.osm")
