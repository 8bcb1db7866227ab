import xml.etree.ElementTree as ET

import numpy as np
import pytest

from geoaim.synthetic.roads.lanelet import lanelet_map
from geoaim.world import World, lonlat_from_world

WORLD = World("EPSG:32635", (583000.0, 6062000.0))


def _tags(element):
    return {tag.attrib["k"]: tag.attrib["v"] for tag in element.findall("tag")}


def _parsed(roads, **options):
    root = ET.fromstring(lanelet_map(roads, np.eye(3), WORLD, **options))
    lanelets = {
        _tags(r)["name"]: {m.attrib["role"]: m.attrib["ref"] for m in r.findall("member")}
        for r in root.findall("relation")
        if _tags(r)["type"] == "lanelet" and "name" in _tags(r)
    }
    return root, lanelets


def test_every_reference_exists(roads):
    root, _ = _parsed(roads, walkways=True, parking=True)
    known = {(element.tag, element.attrib["id"]) for element in root}
    assert len(known) == len(root)
    for way in root.findall("way"):
        assert all(("node", nd.attrib["ref"]) in known for nd in way.findall("nd"))
    for relation in root.findall("relation"):
        members = relation.findall("member")
        assert all((m.attrib["type"], m.attrib["ref"]) in known for m in members)


def test_each_lane_is_a_lanelet_and_neighbours_share_their_boundary(roads):
    _, lanelets = _parsed(roads)
    assert set(lanelets) == {lane.name for lane in roads.lanes}
    for arm in roads.layout.arms:
        for rank in range(1, len(arm.turns)):
            inner, outer = lanelets[f"{arm.name} in {rank - 1}"], lanelets[f"{arm.name} in {rank}"]
            assert inner["right"] == outer["left"]


def test_lanelets_that_follow_each_other_share_their_end_nodes(roads):
    root, lanelets = _parsed(roads)
    ends = {}
    for way in root.findall("way"):
        nodes = [nd.attrib["ref"] for nd in way.findall("nd")]
        ends[way.attrib["id"]] = {nodes[0], nodes[-1]}
    for lane in roads.lanes:
        for before in lane.follows:
            for side in ("left", "right"):
                assert ends[lanelets[lane.name][side]] & ends[lanelets[before][side]]


def test_places_are_longitude_and_latitude(roads):
    root, _ = _parsed(roads)
    found = np.array([[float(n.attrib["lon"]), float(n.attrib["lat"])] for n in root.iter("node")])
    middle = lonlat_from_world(WORLD, np.zeros((1, 2)))[0]
    assert np.abs(found - middle).max() < 0.004


def test_people_and_the_car_park_are_left_out_unless_asked_for(roads):
    kinds = [
        {_tags(r).get("subtype") for r in _parsed(roads, **options)[0].findall("relation")}
        for options in ({}, {"walkways": True, "parking": True})
    ]
    assert not kinds[0] & {"crosswalk", "walkway", "parking"}
    assert {"crosswalk", "walkway"} <= kinds[1]
    assert ("parking" in kinds[1]) == (roads.car_park is not None)


def test_lights_and_give_way_lines_are_regulatory_elements(roads):
    root, _ = _parsed(roads)
    rules = [_tags(r) for r in root.findall("relation") if "regulatory" in _tags(r)["type"]]
    wanted = "traffic_light" if roads.layout.signalised else "right_of_way"
    assert {rule["subtype"] for rule in rules} == {wanted}
    stops = sum(np.isfinite(arm.stop) for arm in roads.layout.arms)
    assert len(rules) >= stops


@pytest.mark.parametrize("options", [{}, {"walkways": True}])
def test_same_plan_gives_the_same_bytes(roads, options):
    one, again = (lanelet_map(roads, np.eye(3), WORLD, **options) for _ in range(2))
    assert one == again
