import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from geoaim.base.errors import MapError
from geoaim.base.world import World
from geoaim.hdmap.lanelet2 import read_hdmap

NODES = {1: (0, 0), 2: (20, 0), 3: (0, 4), 4: (20, 4), 5: (20, 0), 6: (20, 4)}
METRE = 1 / 111_320  # degrees
MANY_NODES = 20_000


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


@pytest.mark.parametrize(
    ("at", "message"), [((54.7, 28.3), "are swapped"), ((37.3, 54.7), "of another place")]
)
def test_a_map_outside_the_area_of_the_world_is_refused(tmp_path, at, message):
    path = _osm(tmp_path / "a.osm", at=at)
    assert read_hdmap(path).lanelets
    with pytest.raises(MapError, match=f"outside the area where EPSG:32635 is used.*{message}"):
        read_hdmap(path, World("EPSG:32635"))


def test_map_on_the_earth_lies_where_the_samples_truth_says():
    truth = json.loads(Path("samples/truth.json").read_text())
    hdmap = read_hdmap("samples/map.osm", World(truth["crs"], tuple(truth["origin"])))
    for line in hdmap.stop_lines:
        place = np.array(truth["landmarks"][f"stop line {line.signal}"])
        (dx, dy), apart = line.ends[1] - line.ends[0], place - line.ends[0]
        assert abs(dx * apart[1] - dy * apart[0]) / np.hypot(dx, dy) < 0.5
    assert len(hdmap.lanelets) == 26
    assert read_hdmap("samples/map_full.osm").areas[0].subtype == "parking"


def _park(outer, inner=""):
    """A car park of 20 by 20 m with a hole of 4 by 4 m."""
    corners = {
        30: ((0, 20), (20, 20), (20, 40), (0, 40)),
        31: ((8, 28), (12, 28), (12, 32), (8, 32)),
    }
    drawn = ""
    for way, places in corners.items():
        refs = [10 * way + k for k in range(4)]
        for ref, (x, y) in zip(refs, places, strict=True):
            drawn += f"<node id='{ref}' lon='{x * METRE:.9f}' lat='{y * METRE:.9f}'/>"
        nodes = "".join(f"<nd ref='{ref}'/>" for ref in refs)
        drawn += f"<way id='{way}'>{nodes}</way>"
    members = f"<member type='way' ref='{outer}' role='outer'/>"
    members += f"<member type='way' ref='{inner}' role='inner'/>" if inner else ""
    tags = "<tag k='type' v='multipolygon'/><tag k='subtype' v='parking'/>"
    return f"{drawn}<relation id='40'>{members}{tags}</relation>"


def test_areas_have_holes(tmp_path):
    (whole,) = read_hdmap(_osm(tmp_path / "a.osm", more=_park("30"))).areas
    (holed,) = read_hdmap(_osm(tmp_path / "b.osm", more=_park("30", "31"))).areas
    assert whole.subtype == "parking"
    assert whole.shape.area == pytest.approx(400, rel=0.01)
    assert whole.shape.area - holed.shape.area == pytest.approx(16, rel=0.01)


def test_what_an_editor_has_deleted_is_left_out(tmp_path):
    park = _park("30").replace("<relation", "<relation action='delete'")
    assert read_hdmap(_osm(tmp_path / "a.osm", more=park)).areas == ()
    with pytest.raises(MapError, match="area 40 has way 30, which is missing"):
        read_hdmap(
            _osm(tmp_path / "b.osm", more=_park("30").replace("<way", "<way action='delete'"))
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"left": (3, 99)}, "way 10 has node 99"),
        ({"more": _park("99")}, "area 40 has way 99"),
        ({"more": _park("12")}, "area 40 has 1 outer lines that close no ring"),
        ({"left": (3,)}, "lanelet 20 has 1 left lines of two points"),
        ({"head": "<html>"}, "is XML of 'html'"),
        ({"head": "<!DOCTYPE osm><osm>"}, "defines XML entities"),
        ({"at": (8.0, 49.0)}, "longitudes and latitudes, and the world is a plane without a CRS"),
    ],
)
def test_what_is_no_map_of_that_world_is_refused(tmp_path, change, message):
    with pytest.raises(MapError, match=message):
        read_hdmap(_osm(tmp_path / "a.osm", **change), World(None))


def test_message_names_the_first_node_without_degrees(tmp_path):
    path = tmp_path / "a.osm"
    nodes = "<node id='1' lon='8' lat='49'/><node id='2' lon='8.5' lat='north'/>"
    path.write_text(f"<osm>{nodes}<node id='3' lon='9' lat='here'/></osm>")
    with pytest.raises(MapError, match=r"node 2 has lon '8\.5' and lat 'north'"):
        read_hdmap(path)


def test_road_map_without_lanelets_is_refused(tmp_path):
    path = tmp_path / "a.osm"
    path.write_text("<osm><node id='1' lon='8' lat='49'/></osm>")
    with pytest.raises(MapError, match="no lanelets"):
        read_hdmap(path)
    with pytest.raises(FileNotFoundError):
        read_hdmap(tmp_path / "none.osm")


@pytest.mark.slow
def test_memory_of_many_nodes_is_half_of_a_tree_of_the_xml(tmp_path):
    lines = [
        f"<node id='{k}' lon='{8 + k * 1e-6:.9f}' lat='49'/>" for k in range(100, 100 + MANY_NODES)
    ]
    path = _osm(tmp_path / "a.osm", at=(8.0, 49.0), more="".join(lines))
    read_hdmap(path)  # what is imported and kept on the way does not count
    tracemalloc.start()
    try:
        assert len(read_hdmap(path).lanelets) == 1
        assert tracemalloc.get_traced_memory()[1] < 500 * MANY_NODES  # 330; with a tree 680
    finally:
        tracemalloc.stop()


def _write_local(path, *, lat, lon, scale=1.0):
    """The lane of `_osm` with its place in the tags local_x and local_y."""
    text = _osm(path).read_text()
    for k, (x, y) in NODES.items():
        old = text[text.index(f"<node id='{k}'") :].split("/>")[0] + "/>"
        degrees = f"lon='{lon + x * METRE * bool(lon):.9f}' lat='{lat + y * METRE * bool(lat):.9f}'"
        tags = f"<tag k='local_x' v='{scale * x}'/><tag k='local_y' v='{scale * y}'/>"
        text = text.replace(old, f"<node id='{k}' {degrees}>{tags}</node>")
    path.write_text(text)
    return path


def test_local_metres_in_tags_are_read_where_all_degrees_are_one_place(tmp_path):
    hdmap = read_hdmap(_write_local(tmp_path / "a.osm", lat=0.0, lon=0.0))
    assert hdmap.world == World(None)
    np.testing.assert_allclose(hdmap.lanelets[0].left, [[0, 4], [20, 4]])


def test_positions_count_from_the_origin_of_a_local_world(tmp_path):
    paths = _osm(tmp_path / "a.osm"), _write_local(tmp_path / "b.osm", lat=0.0, lon=0.0)
    for path in paths:
        hdmap = read_hdmap(path, World(None, (5.0, 2.0)))
        np.testing.assert_allclose(hdmap.lanelets[0].left, [[-5, 2], [15, 2]], atol=0.05)


def test_degrees_that_agree_with_local_metres_are_read_and_others_refused(tmp_path):
    path = _write_local(tmp_path / "a.osm", lat=0.5, lon=9.0)
    assert read_hdmap(path).world.crs == "EPSG:32632"
    with pytest.raises(MapError, match=r"by lat and lon, and .* by local_x and local_y"):
        read_hdmap(_write_local(tmp_path / "b.osm", lat=0.5, lon=9.0, scale=3.0))


@pytest.mark.parametrize(
    ("scale", "message"), [(1e-9, "all of its 6 nodes at one place"), (111_320.0, "no degrees")]
)
def test_nodes_at_one_place_and_metres_as_degrees_are_refused(tmp_path, scale, message):
    path = _osm(tmp_path / "a.osm")
    text = path.read_text()
    for x in (20, 4):
        text = text.replace(f"'{x * METRE:.9f}'", f"'{x * METRE * scale:.12f}'")
    path.write_text(text)
    with pytest.raises(MapError, match=message):
        read_hdmap(path)


@pytest.mark.parametrize(
    ("tags", "one_way"),
    [
        ({}, True),
        ({"one_way": "yes"}, True),
        ({"one_way": "true"}, True),
        ({"one_way": "1"}, True),
        ({"one_way": "no"}, False),
        ({"one_way": "false"}, False),
        ({"one_way": "0"}, False),
        ({"one_way": "yes", "one_way:vehicle": "no"}, False),
        ({"subtype": "crosswalk"}, False),
    ],
)
def test_one_way_has_the_spellings_and_defaults_of_lanelet2(tmp_path, tags, one_way):
    path = _osm(tmp_path / "a.osm")
    written = "".join(f"<tag k='{key}' v='{value}'/>" for key, value in tags.items())
    path.write_text(path.read_text().replace("v='lanelet'/>", f"v='lanelet'/>{written}"))
    assert read_hdmap(path).lanelets[0].one_way == one_way


def test_an_unknown_value_of_one_way_is_refused(tmp_path):
    path = _osm(tmp_path / "a.osm")
    tag = "v='lanelet'/><tag k='one_way' v='maybe'/>"
    path.write_text(path.read_text().replace("v='lanelet'/>", tag))
    with pytest.raises(MapError, match="lanelet 20 has one_way='maybe'"):
        read_hdmap(path)
