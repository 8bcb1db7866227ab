"""The benchmark of policies on one synthetic place."""

import pytest

from benchmarks.simulation import policies

pytestmark = pytest.mark.slow


def test_rates_stand_beside_those_of_the_recording():
    cases = [policies._make_place("street", 20)]
    idm, straight = policies._measure("street", cases, ["idm", "constant-velocity"])
    assert idm["collision, %"] == "0 / 0"
    assert idm["red light, %"] == idm["off road, %"] == "0 / 0"
    assert idm["contact, %"] == "- / -"  # no pedestrian is controlled
    assert 80 < idm["way covered, %"] < 110
    rate, recorded = map(float, straight["off road, %"].split(" / "))
    assert rate > recorded == 0


def test_corners_of_recorded_vehicles_are_measured():
    row = policies._measure_corners("street", [policies._make_place("street", 20)])
    assert row["vehicle steps"] > 1000
    assert 0 <= row["at most, m"] < 0.5
    assert row["corner over 0.5 m off, %"] == 0 <= row["corner over 0 m off, %"]


def test_rates_of_what_is_never_counted_are_left_out():
    counts = {"collision": (1.0, 8.0), "contact": (0.0, 0.0)}
    assert policies._format_rates("red light", counts, counts) is None
    assert policies._format_rates("contact", counts, counts) == "- / -"
    assert policies._format_rates("collision", counts, {}) == "12.500 / -"
    total = policies._sum([counts, {"collision": (1.0, 2.0)}])
    assert total["collision"] == pytest.approx((2.0, 10.0))
