import numpy as np
import pytest

from geoaim.synthetic.roads.arms import (
    Arm,
    half_width,
    lane_in,
    lane_out,
    on_arm,
    turn_between,
)
from geoaim.synthetic.roads.layouts import KINDS, corner_along, lay_out

EAST, NORTH = Arm("east", 0.0, 0.0, ("L", "S"), 1), Arm("north", np.pi / 2, 0.0, ("LSR",), 1)


def test_lanes_towards_the_middle_lie_left_of_somebody_who_looks_out():
    assert lane_in(EAST, 0) > lane_out(EAST, 0)
    np.testing.assert_allclose(on_arm(EAST, np.array([[20.0, 3.0]])), [[20, 3]])
    np.testing.assert_allclose(on_arm(NORTH, np.array([[20.0, 3.0]])), [[-3, 20]], atol=1e-9)


def test_lanes_fill_the_road_between_the_gutters():
    assert lane_in(EAST, 1) + EAST.lane / 2 == pytest.approx(half_width(EAST) - 0.45)
    assert lane_out(EAST, 0) - EAST.lane / 2 == pytest.approx(0.45 - half_width(EAST))


@pytest.mark.parametrize(("go", "turn"), [("west", "S"), ("north", "R"), ("south", "L")])
def test_turns_are_those_of_somebody_who_drives_west(go, turn):
    angle = {"west": np.pi, "north": np.pi / 2, "south": -np.pi / 2}[go]
    assert turn_between(EAST, Arm(go, angle, 0.0, (), 1)) == turn


def test_kerbs_of_two_roads_meet_at_the_other_ones_half_width():
    assert corner_along(EAST, NORTH) == pytest.approx(half_width(NORTH))
    assert corner_along(EAST, Arm("west", np.pi, 0.0, (), 1)) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_stop_lines_lie_outside_of_the_crossings(kind):
    for seed in range(20):
        for arm in lay_out(kind, np.random.default_rng(seed)).arms:
            if kind in ("junction", "t", "campus") and np.isfinite(arm.stop):
                assert arm.stop > arm.crossing + 4.0
            assert arm.mouth > 0


def test_unknown_kind_names_those_that_there_are(unchecked):
    with pytest.raises(ValueError, match="'motorway' is not one of junction, t, roundabout"):
        lay_out("motorway", np.random.default_rng(0))
