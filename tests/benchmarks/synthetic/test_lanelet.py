import xml.etree.ElementTree as ET
from functools import cache
from itertools import pairwise

import numpy as np
import shapely

from benchmarks.synthetic.roads.lanelet import make_lanelet_map
from benchmarks.synthetic.roads.lanes import compute_lane_bounds
from benchmarks.synthetic.roads.plan import make_roads
from geoaim.base.world import World, lonlat_from_world, world_from_lonlat

WORLD = World("EPSG:32635", (583000.0, 6062000.0))


def _tags(element):
    return {tag.attrib["k"]: tag.attrib["v"] for tag in element.findall("tag")}


@cache
def _parsed(roads, **options):
    root = ET.fromstring(make_lanelet_map(roads, np.eye(3), WORLD, **options))
    lanelets = {
        _tags(r)["name"]: {m.attrib["role"]: m.attrib["ref"] for m in r.findall("member")}
        for r in root.findall("relation")
        if _tags(r)["type"] == "lanelet" and "name" in _tags(r)
    }
    return root, lanelets


def test_every_reference_exists(roads):
    root, _ = _parsed(roads, complete=True)
    known = {(element.tag, element.attrib["id"]) for element in root}
    assert len(known) == len(root)
    for way in root.findall("way"):
        assert all(("node", nd.attrib["ref"]) in known for nd in way.findall("nd"))
    for relation in root.findall("relation"):
        members = relation.findall("member")
        assert all((m.attrib["type"], m.attrib["ref"]) in known for m in members)


def test_each_lane_is_a_lanelet_and_neighbours_share_a_bound(roads):
    _, lanelets = _parsed(roads, complete=True)
    assert set(lanelets) == {lane.name for lane in roads.lanes}
    for approach in roads.layout.approaches:
        for rank in range(1, len(approach.turns)):
            inner = lanelets[f"{approach.name} in {rank - 1}"]
            assert inner["right"] == lanelets[f"{approach.name} in {rank}"]["left"]


def test_consecutive_lanelets_share_their_end_nodes(roads):
    root, lanelets = _parsed(roads, complete=True)
    ends = {}
    for way in root.findall("way"):
        nodes = [nd.attrib["ref"] for nd in way.findall("nd")]
        ends[way.attrib["id"]] = {nodes[0], nodes[-1]}
    for route in roads.routes:
        for before, after in pairwise(route.lanes):
            for side in ("left", "right"):
                assert ends[lanelets[before][side]] & ends[lanelets[after][side]]


def test_nodes_have_longitude_and_latitude(roads):
    root, _ = _parsed(roads)
    found = np.array([[float(n.attrib["lon"]), float(n.attrib["lat"])] for n in root.iter("node")])
    middle = lonlat_from_world(WORLD, np.zeros((1, 2)))[0]
    assert np.abs(found - middle).max() < 0.004


def test_only_complete_maps_have_walkways_and_the_car_park(roads):
    kinds = [
        {_tags(r).get("subtype") for r in _parsed(roads, **options)[0].findall("relation")}
        for options in ({}, {"complete": True})
    ]
    assert not kinds[0] & {"crosswalk", "walkway", "parking"}
    assert {"crosswalk", "walkway"} <= kinds[1]
    assert ("parking" in kinds[1]) == (roads.car_park is not None)


def test_lights_and_give_way_lines_are_regulatory_elements(roads):
    root, _ = _parsed(roads)
    rules = [_tags(r) for r in root.findall("relation") if "regulatory" in _tags(r)["type"]]
    wanted = "traffic_light" if roads.layout.signalised else "right_of_way"
    assert {rule["subtype"] for rule in rules} == {wanted}
    stops = sum(np.isfinite(approach.stop) for approach in roads.layout.approaches)
    assert len(rules) >= stops


def test_same_plan_gives_the_same_bytes(roads):
    one, again = (make_lanelet_map(roads, np.eye(3), WORLD, complete=True) for _ in range(2))
    assert one == again


def test_lanes_onto_a_roundabout_yield_to_its_ring():
    roads = make_roads("roundabout", np.random.default_rng(5))
    root, _ = _parsed(roads)
    names = {r.attrib["id"]: _tags(r).get("name") for r in root.findall("relation")}
    rules = [r for r in root.findall("relation") if _tags(r).get("subtype") == "right_of_way"]
    assert len(rules) == len(roads.layout.approaches)
    for rule in rules:
        roles = {m.attrib["role"]: names.get(m.attrib["ref"]) for m in rule.findall("member")}
        assert roles["yield"].replace(" onto ring", "") == roles["right_of_way"].split()[-1]


def test_signalised_crosswalks_name_the_pedestrian_light():
    roads = make_roads("junction", np.random.default_rng(5))
    root, _ = _parsed(roads, complete=True)
    found = {_tags(r).get("name", "") for r in root.findall("relation")}
    wanted = {f"walk {c.name}" for c in roads.crossings if c.marked and c.signalised}
    assert wanted
    assert wanted <= found


def test_only_complete_maps_have_private_roads():
    roads = make_roads("campus", np.random.default_rng(5))
    (private,) = roads.layout.private
    missing = {lane.name for lane in roads.lanes if private in lane.name.split()}
    assert {f"{private} in 0", f"{private} out 0", f"south 0 to {private} 0"} <= missing
    root, lanelets = _parsed(roads)
    assert set(lanelets) == {lane.name for lane in roads.lanes} - missing
    assert set(_parsed(roads, complete=True)[1]) == set(lanelets) | missing
    known = {element.attrib["id"] for element in root}
    assert all(member.attrib["ref"] in known for member in root.iter("member"))


def test_no_island_lies_in_a_lane(roads):
    for lane in roads.lanes:
        left, right = compute_lane_bounds(lane)
        area = shapely.Polygon(np.concatenate([left, right[::-1]])).buffer(0)
        assert area.intersection(roads.paving.islands).area < 0.01


def test_car_park_is_one_area_without_slivers(roads):
    if roads.car_park is None:
        return
    root, _ = _parsed(roads, complete=True)
    nodes = {n.attrib["id"]: (n.attrib["lon"], n.attrib["lat"]) for n in root.iter("node")}
    [area] = [r for r in root.findall("relation") if _tags(r).get("subtype") == "parking"]
    [ring] = [m.attrib["ref"] for m in area.findall("member")]
    way = next(w for w in root.findall("way") if w.attrib["id"] == ring)
    lonlat = np.array([nodes[nd.attrib["ref"]] for nd in way.findall("nd")], float)
    polygon = shapely.Polygon(world_from_lonlat(WORLD, lonlat))
    assert polygon.is_valid
    core = polygon.buffer(-0.1).buffer(0.15, join_style="mitre")
    assert polygon.difference(core).area < 0.05
