from itertools import pairwise

import numpy as np
import pytest
import shapely
from shapely import LineString

from benchmarks.synthetic.roads.curves import compute_curvature, compute_headings
from benchmarks.synthetic.roads.layouts import PLACE_KINDS
from benchmarks.synthetic.roads.paving import outline_crossing, outline_road
from benchmarks.synthetic.roads.plan import find_signal, make_roads


def test_consecutive_lanes_join_smoothly(roads):
    lanes = {lane.name: lane.centreline for lane in roads.lanes}
    for route in roads.routes:
        for before, after in pairwise(route.lanes):
            np.testing.assert_allclose(lanes[before][-1], lanes[after][0], atol=1e-6)
            turn = compute_headings(lanes[before])[-1] - compute_headings(lanes[after])[0]
            assert abs((turn + np.pi) % (2 * np.pi) - np.pi) < 0.05


def test_vehicles_can_follow_the_lanes(roads):
    assert max(np.abs(compute_curvature(lane.centreline)).max() for lane in roads.lanes) < 1 / 5.0


def test_vehicles_in_lanes_touch_no_kerb(roads):
    asphalt = roads.paving.carriageway.buffer(0.05)
    for lane in roads.lanes:
        body = LineString(lane.centreline).buffer(1.1, cap_style="flat")
        assert asphalt.contains(body), lane.name


def test_surfaces_do_not_overlap(roads):
    paving = roads.paving
    parts = [
        paving.carriageway,
        paving.islands,
        paving.driveway,
        paving.parking_lot,
        paving.pavement,
    ]
    for k, part in enumerate(parts):
        for other in parts[:k]:
            assert part.intersection(other).area < 0.01


def test_crossings_end_on_kerbs(roads):
    kerbs = outline_road(roads.paving).exterior
    for crossing in roads.crossings:
        if crossing.name != "drive":
            assert max(kerbs.distance(shapely.points(crossing.ends))) < 0.01
            inside = outline_crossing(crossing).intersection(outline_road(roads.paving)).area
            assert inside > 0.8 * outline_crossing(crossing).area


@pytest.mark.parametrize("kind", PLACE_KINDS)
def test_same_seed_gives_the_same_plan(kind):
    one, again = (make_roads(kind, np.random.default_rng(2)) for _ in range(2))
    for lane, twin in zip(one.lanes, again.lanes, strict=True):
        np.testing.assert_array_equal(lane.centreline, twin.centreline)
    assert one.paving.pavement.equals_exact(again.paving.pavement)


@pytest.mark.parametrize("kind", PLACE_KINDS)
def test_plans_of_many_seeds_are_valid(kind):
    for seed in range(8):
        roads = make_roads(kind, np.random.default_rng(seed))
        assert roads.paving.carriageway.is_valid
        assert len(roads.paving.plots) >= 2
        assert len(roads.routes) >= 2


def test_only_protected_left_turns_have_their_own_light():
    for seed in range(4):
        roads = make_roads("junction", np.random.default_rng(seed))
        pocket = roads.layout.approaches[0].turns[0] == "L"
        assert find_signal(roads, "east in 0", "L") == ("east left" if pocket else "east")
        assert find_signal(roads, "north in 0", "L") == "north"
        assert find_signal(roads, "east out 0", "S") == ""
