import numpy as np
import pytest
import torch

from geoaim.simulation.conflicts import REACH_SLACK_M, find_conflicts
from geoaim.simulation.routes import Routes, interpolate, locate, resample_points


def _find(first, second, width=2.0):
    """The conflicts of two routes of cars of 4 m."""
    points = resample_points(torch.tensor([[first, second]]).double())
    lengths = torch.tensor([[np.linalg.norm(np.subtract(*line)) for line in (first, second)]])
    routes = Routes(points, lengths, torch.zeros(1, 2).bool())
    sizes = torch.tensor([[[4.0, width], [4.0, width]]]).double()
    return find_conflicts(routes, sizes, torch.ones(1, 2).bool())


def test_crossing_routes_share_a_rectangle():
    found = _find([[0.0, 0.0], [60.0, 0.0]], [[30.0, -20.0], [30.0, 40.0]])
    assert found.agent.tolist() == [0, 1]
    assert not found.follows.any()
    start, end = found.start[0], found.end[0]  # half of a length and half of a width before
    assert 30 - 3 - 1.7 <= start <= 30 - 3
    assert 30 + 3 <= end <= 30 + 3 + 1.7
    assert found.start[1] - 20 == pytest.approx(float(start) - 30)


def test_routes_in_one_lane_follow_each_other():
    found = _find([[0.0, 0.0], [60.0, 0.0]], [[10.0, 0.2], [70.0, 0.2]])
    assert found.follows.all()
    assert found.slope.tolist() == pytest.approx([1.0, 1.0], abs=0.001)
    assert found.offset.tolist() == pytest.approx([10.0, -10.0], abs=0.6)
    assert found.reach.tolist() == pytest.approx([4 + REACH_SLACK_M] * 2, abs=0.5)


def test_oncoming_routes_meet():
    found = _find([[0.0, 0.0], [60.0, 0.0]], [[60.0, 0.2], [0.0, 0.2]])
    assert found.faces.all()
    assert not found.follows.any()
    assert found.slope.tolist() == pytest.approx([-1.0, -1.0], abs=0.001)
    assert found.offset.tolist() == pytest.approx([60.0, 60.0], abs=0.6)


@pytest.mark.parametrize("aside", [3.0, 50.0])
def test_neighbouring_and_far_routes_have_no_conflict(aside):
    found = _find([[0.0, 0.0], [60.0, 0.0]], [[0.0, aside], [60.0, aside]])
    assert len(found.agent) == 0


def test_agents_that_only_replay_have_no_conflict():
    points = resample_points(torch.tensor([[[[0.0, 0.0], [9.0, 0.0]]] * 2]))
    routes = Routes(points, torch.full((1, 2), 9.0), torch.zeros(1, 2).bool())
    found = find_conflicts(routes, torch.ones(1, 2, 2), torch.zeros(1, 2).bool())
    assert len(found.agent) == 0


def test_places_are_found_along_routes():
    bend = np.linspace(0, np.pi / 2, 40)
    arc = 20 * np.column_stack([np.sin(bend), 1 - np.cos(bend)])
    points = resample_points(torch.tensor(arc)[None, None])
    along = torch.tensor([[17.3]])
    place = interpolate(points, along.double())
    angle = 17.3 / 20
    expected = [20 * np.sin(angle), 20 * (1 - np.cos(angle))]
    np.testing.assert_allclose(place[0, 0], expected, atol=0.02)
    assert float(locate(points, place)) == pytest.approx(17.3, abs=0.02)
    beyond = torch.tensor([[[20.0, 25.0]]]).double()  # straight on from the end at (20, 20)
    assert float(locate(points, beyond)) == pytest.approx(10 * np.pi + 5, abs=0.3)
