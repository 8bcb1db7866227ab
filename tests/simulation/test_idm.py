"""Intelligent drivers: alone, behind others, at lights, and where routes cross."""

import numpy as np
import pytest
import torch

from geoaim.simulation.idm import make_idm_policy
from geoaim.simulation.overlap import box_iou
from geoaim.simulation.routes import Routes, extract_routes, resample_points
from geoaim.simulation.simulator import Scenario, rollout
from geoaim.simulation.spawning import rollout_routes
from geoaim.tracks.lights import GREEN, RED
from tests.sizes import keep_quick

DT = 0.1
CAR, PERSON = (4.5, 1.9), (0.5, 0.6)


def _follow(*polylines):
    """Routes of one scene along polylines."""
    lines = [np.array(line, float) for line in polylines]
    most = max(map(len, lines))
    padded = [np.vstack([line, *[line[-1:] + 1e-3] * (most - len(line))]) for line in lines]
    lengths = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines]
    points = resample_points(torch.tensor(np.array(padded))[None])
    return Routes(points, torch.tensor([lengths]), torch.zeros(1, len(lines), dtype=torch.bool))


def _drive(states, steps=200, sizes=None):
    """A scenario of agents that go on in the states x, y, heading, speed of its first step."""
    start = torch.tensor(states).double()
    seconds = torch.arange(steps)[:, None].double() * DT
    x, y, heading, speed = start.T
    position = [x + seconds * speed * heading.cos(), y + seconds * speed * heading.sin()]
    rest = [heading.expand(steps, -1), speed.expand(steps, -1)]
    boxes = torch.tensor(sizes or [CAR] * len(start)).double()[None]
    there = torch.ones(1, len(start), steps, dtype=torch.bool)
    walks = boxes[..., 0] < 1
    return Scenario(
        torch.stack([*position, *rest], -1).transpose(0, 1)[None], there, boxes, walks, DT
    )


def _simulate(scenario, routes, controlled=None, speed=8.0):
    """Simulate drivers of one desired speed: states (T, A, 4), presence, and pairs that overlap."""
    everyone = torch.ones_like(scenario.pedestrian)
    controlled = everyone if controlled is None else torch.tensor([controlled])
    desired = torch.full_like(scenario.sizes[..., 0], speed)
    policy = make_idm_policy(routes, desired, scenario.sizes, controlled)
    driven, there = rollout_routes(scenario, policy, controlled, routes)
    states, present = driven[0].transpose(0, 1), there[0].t()
    sizes = scenario.sizes.expand(len(states), -1, -1)
    overlaps = box_iou(states[..., :3], sizes, present) > 0
    return states, present, overlaps


def test_driver_follows_its_route_and_stops_behind_others():
    bend = np.linspace(0, 80, 81)
    route = np.column_stack([bend, 6 * np.sin(bend / 80 * np.pi)])
    scenario = _drive([[0.0, 0, 0.22, 8], [80.0, 0, 0, 0]], steps=300)
    states, _, overlaps = _simulate(
        scenario, _follow(route, np.add(route, [80, 0])), [True, False], 12.0
    )
    car = states[:, 0]
    assert car[:, 3].max() > 9
    assert car[-1, 3].abs() < 0.1
    assert 1.5 < 80 - float(car[-1, 0]) - 4.5 < 5
    assert torch.cdist(car[:, :2], torch.tensor(route)).min(dim=1).values.max() < 0.6
    assert not overlaps.any()


def test_driver_waits_for_green():
    scenario = _drive([[0.0, 0, 0, 8], [0.0, 20, 0, 8]])  # the second one has no light
    routes = _follow([[0, 0], [90, 0]], [[0, 20], [90, 20]])
    line = torch.tensor([[[40.0, -2.0], [40.0, 2.0]]]).double()
    light = torch.full((1, 200, 1), RED)
    light[:, 120:] = GREEN
    both = torch.ones(1, 2).bool()
    given = routes, torch.full((1, 2), 8.0).double(), scenario.sizes, both, line, light
    result = rollout(scenario, make_idm_policy(*given), both)[0].transpose(0, 1)
    front = result[:, 0, 0] + 4.5 / 2
    assert front[:120].max() < 40
    assert front[119] > 37
    assert result[-1, 0, 0] > 60
    assert result[119, 1, 0] > 80


@pytest.mark.parametrize("angle", keep_quick([90, 60, 120, 150, 180], 90, 150))
def test_drivers_whose_routes_cross_do_not_overlap(angle):
    turn = np.radians(angle)
    away = 40 * np.array([np.cos(turn), np.sin(turn)])
    aside = np.array([0, 0.5])  # oncoming cars pass through each other's boxes
    scenario = _drive([[-40.0, 0, 0, 8], [*(-away + aside), turn, 8]])
    routes = _follow([[-40, 0], [60, 0]], [-away + aside, 1.5 * away + aside])
    states, present, overlaps = _simulate(scenario, routes)
    assert not overlaps.any()
    if angle < 180:
        assert not present[-1].any()  # both have arrived and left
    else:
        assert states[-1, :, 3].max() < 0.1  # neither can pass


def test_drivers_that_merge_follow_each_other():
    starts = [[-40.0, 0, 0, 8], [-40.0, -20, 0.46, 8], [-60.0, 0, 0, 8]]
    scenario = _drive(starts, steps=300)
    ahead = [[0, 0], [80, 0]]
    routes = _follow([[-40, 0], *ahead], [[-40, -20], *ahead], [[-60, 0], *ahead])
    _, present, overlaps = _simulate(scenario, routes)
    assert not overlaps.any()
    assert not present[-1].any()


@pytest.mark.slow
def test_stopped_drivers_do_not_wait_for_each_other_where_they_merge():
    """The lorry has entered the merge and stands behind the car, which has not."""
    scenario = _drive(
        [[-21.5, 0.0, 0, 0], [-22.3, -4.4, 0.41, 0]], steps=400, sizes=[CAR, (16.5, 2.5)]
    )
    routes = _follow([[-150, 0], [150, 0]], [[-150, -60], [-20, -3.5], [20, 0], [150, 0]])
    _, present, overlaps = _simulate(scenario, routes)
    assert not overlaps.any()
    assert not present[-1].any()


@pytest.mark.parametrize("place", keep_quick([-3.75, -3.5, -3.25], -3.5))
def test_drivers_who_both_stand_at_a_crossing_do_not_wait_for_each_other(place):
    scenario = _drive([[-3.5, 0.0, 0, 0], [0.0, place, np.pi / 2, 0]])
    _, present, overlaps = _simulate(scenario, _follow([[-40, 0], [40, 0]], [[0, -40], [0, 40]]))
    assert not overlaps.any()
    assert not present[-1].any()


@pytest.mark.slow
def test_ring_of_drivers_does_not_block_itself():
    corners = np.array([[-40, -1.6], [1.6, -40], [40, 1.6], [-1.6, 40]])
    headings = [0, np.pi / 2, np.pi, -np.pi / 2]
    starts = [[*corner, heading, 8.0] for corner, heading in zip(corners, headings, strict=True)]
    ways = [[c, c + 110 * np.array([np.cos(h), np.sin(h)])] for *c, h, _ in starts]
    scenario = _drive(starts, steps=400)
    _, present, overlaps = _simulate(scenario, _follow(*ways))
    assert not overlaps.any()
    assert not present[-1].any()


def test_driver_yields_to_a_pedestrian_who_replays():
    scenario = _drive([[0.0, 0, 0, 8], [30.0, -5, np.pi / 2, 1.2]], sizes=[CAR, PERSON])
    routes = _follow([[0, 0], [60, 0]], [[30, -5], [30, 15]])
    states, present, overlaps = _simulate(scenario, routes, [True, False])
    assert not overlaps.any()
    assert states[:60, 0, 3].min() < 3
    assert not present[-1, 0]


@pytest.mark.slow
def test_queue_keeps_the_crossing_clear():
    scenario = _drive([[0.0, 0, 0, 8], [44.0, 0, 0, 0], [35.0, -40, np.pi / 2, 6]], steps=300)
    routes = _follow([[0, 0], [90, 0]], [[44, 0], [90, 0]], [[35, -40], [35, 60]])
    states, present, overlaps = _simulate(scenario, routes, [True, False, True])
    assert not overlaps.any()
    front = states[:, 0, 0] + 4.5 / 2
    passed = int((states[:, 2, 1] > 5).int().argmax())  # by the third car
    assert passed > 30
    assert 30 < front[:passed].max() < 35 - 1.9 / 2  # behind the standing car there is no room
    assert front[-1] > 38  # afterwards it moves up
    assert not present[-1, 2]


def _waiting(far):
    """A car that drives 30 m east, then waits with 1 mm of jitter; another parked on its route."""
    steps, time = 200, torch.arange(200, dtype=torch.float64) * DT
    states = torch.zeros(1, 2, steps, 4, dtype=torch.float64)
    shaking = torch.randn(steps, generator=torch.Generator().manual_seed(0)).double() * 1e-3
    states[0, 0, :, 0] = (8 * time).clamp_max(30.0)
    states[0, 0, :, 1] = torch.where(8 * time > 30, shaking, 0.0)
    states[0, 0, :, 3] = torch.where(8 * time > 30, 0.0, 8.0)
    states[0, 1, :, 0] = 30 + far
    sizes = torch.tensor(CAR).double().expand(1, 2, 2)
    there = torch.ones(1, 2, steps, dtype=torch.bool)
    return Scenario(states, there, sizes, torch.zeros(1, 2).bool(), DT)


def test_driver_stays_where_its_recording_ends_at_a_standstill():
    scenario = _waiting(100.0)
    routes = extract_routes(scenario)
    assert routes.points.diff(dim=2).norm(dim=-1).min() > 0.99
    assert routes.lengths[0, 0] == pytest.approx(30, abs=1)
    assert routes.stops.all()
    states, present, _ = _simulate(scenario, routes, [True, False])
    assert present.all()
    assert states[-1, 0, 0] == pytest.approx(30, abs=1)
    assert states[:, 0, 1].abs().max() < 0.2


def _at_a_light(x, line, speed=8.0):
    """Acceleration of a car at x that drives east towards a red light."""
    scenario = _drive([[x, 0.0, 0.0, speed]], steps=2)
    lights = torch.tensor(line)[None].double(), torch.full((1, 2, 1), RED)
    given = torch.full((1, 1), 8.0).double(), scenario.sizes, torch.ones(1, 1).bool()
    policy = make_idm_policy(_follow([[0, 0], [99, 0]]), *given, *lights)
    return float(policy(scenario, scenario.states[:, :, :1])[0, 0, 0])


def test_vehicles_stop_only_at_lines_ahead_that_cross_their_route():
    across = [[40.0, -2.0], [40.0, 2.0]]
    assert _at_a_light(20.0, across) < -1
    assert _at_a_light(39.0, across, speed=1.0) > 0  # its front is past the line
    assert _at_a_light(20.0, [[25.0, 1.0], [45.0, 1.0]]) == pytest.approx(0)  # along the way
    assert _at_a_light(20.0, [[40.0, 2.0], [40.0, 8.0]]) == pytest.approx(0)  # another lane's
    assert _at_a_light(29.0, across) == -8  # no car brakes harder


def test_lines_without_states_are_refused():
    scenario = _drive([[0.0, 0, 0, 8]], steps=2)
    given = torch.ones(1, 1).double(), scenario.sizes, torch.ones(1, 1).bool()
    with pytest.raises(ValueError, match="go together"):
        make_idm_policy(_follow([[0, 0], [9, 0]]), *given, torch.zeros(1, 2, 2))


def test_drivers_enter_when_there_is_room():
    steps = 200
    scenario = _drive([[10.0, 0, 0, 0], [0.0, 0, 0, 8]], steps=steps)
    scenario.present[:, 1, :20] = False
    routes = _follow([[10, 0], [80, 0]], [[0, 0], [80, 0]])
    _, present, overlaps = _simulate(scenario, routes)
    assert not present[20, 1]  # the other one still stands in its way
    entered = int(present[:, 1].int().argmax())
    assert 21 < entered < 80
    assert not overlaps.any()
    assert not present[-1].any()
