import numpy as np
import pytest

from geoaim.synthetic.roads.approaches import (
    Approach,
    classify_turn,
    locate_inbound_lane,
    locate_outbound_lane,
    plan_from_road,
)
from geoaim.synthetic.roads.layouts import PLACE_KINDS, locate_corner, make_layout

EAST = Approach("east", 0.0, 0.0, ("L", "S"), 1)
NORTH = Approach("north", np.pi / 2, 0.0, ("LSR",), 1)


def test_inbound_lanes_lie_at_larger_t():
    assert locate_inbound_lane(EAST, 0) > locate_outbound_lane(EAST, 0)
    np.testing.assert_allclose(plan_from_road(EAST, np.array([[20.0, 3.0]])), [[20, 3]])
    point = plan_from_road(NORTH, np.array([[20.0, 3.0]]))
    np.testing.assert_allclose(point, [[-3, 20]], atol=1e-9)


def test_lanes_fill_the_road_between_the_gutters():
    left = locate_inbound_lane(EAST, 1) + EAST.lane_width / 2
    right = locate_outbound_lane(EAST, 0) - EAST.lane_width / 2
    assert (left, right) == pytest.approx((EAST.half_width - 0.45, 0.45 - EAST.half_width))


@pytest.mark.parametrize(("destination", "turn"), [("west", "S"), ("north", "R"), ("south", "L")])
def test_turns_from_the_east_are_those_of_westbound_traffic(destination, turn):
    angle = {"west": np.pi, "north": np.pi / 2, "south": -np.pi / 2}[destination]
    assert classify_turn(EAST, Approach(destination, angle, 0.0, (), 1)) == turn


def test_kerbs_of_perpendicular_roads_meet_at_the_half_width():
    assert locate_corner(EAST, NORTH) == pytest.approx(NORTH.half_width)
    assert locate_corner(EAST, Approach("west", np.pi, 0.0, (), 1)) == 0


@pytest.mark.parametrize("kind", PLACE_KINDS)
def test_stop_lines_lie_behind_the_crossings(kind):
    for seed in range(20):
        for approach in make_layout(kind, np.random.default_rng(seed)).approaches:
            if kind in ("junction", "t", "campus") and np.isfinite(approach.stop):
                assert approach.stop > approach.crossing + 4.0
            assert approach.mouth > 0


def test_error_for_an_unknown_kind_lists_the_known_ones(unchecked):
    with pytest.raises(ValueError, match="'motorway' is not one of junction, t, roundabout"):
        make_layout("motorway", np.random.default_rng(0))
