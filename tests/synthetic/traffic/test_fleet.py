import numpy as np
import pytest

from geoaim.lights import GREEN, RED
from geoaim.synthetic.roads.plan import make_roads
from geoaim.synthetic.traffic.comings import join, vehicle
from geoaim.synthetic.traffic.demand import Driver
from geoaim.synthetic.traffic.fleet import OnFoot, pair_up, reach_of, step
from geoaim.synthetic.traffic.simulate import INTERVAL, prepare_traffic

NOBODY = OnFoot(np.empty(0, int), np.empty(0), np.empty(0), np.empty(0))
DRIVER = Driver(0.0, 0, "car", (4.5, 1.8), 1.0, 1.0, (0.0, 0.0))


def _junction():
    """The first one whose left turns share their lane."""
    plans = (make_roads("junction", np.random.default_rng(seed)) for seed in range(9))
    return next(roads for roads in plans if roads.layout.approaches[0].turns[0] == "LS")


@pytest.fixture(scope="module")
def flow():
    return prepare_traffic(_junction(), np.random.default_rng(1))


def _way(flow, name):
    return next(k for k, way in enumerate(flow.ways) if way.name.startswith(name))


def _run(flow, fleet, seconds, *, light=GREEN, on_foot=NOBODY):
    """All steps of some vehicles, with all lights alike."""
    lights = np.full(len(flow.signals.names), light, np.int8)
    pairs, moments = pair_up(fleet, flow.rules), [fleet]
    for _ in range(round(seconds / INTERVAL)):
        vehicles = fleet, *reach_of(fleet, flow.rules)
        fleet = step(vehicles, pairs, flow.rules, lights, on_foot, INTERVAL)
        moments.append(fleet)
    return moments


def test_alone_one_drives_as_fast_as_allowed(flow):
    way = _way(flow, "east in 1 to west")
    end = _run(flow, vehicle(DRIVER, 0, way=way, speed=5.0), 12.0)[-1]
    assert end.speed[0] == pytest.approx(13.9, rel=0.03)


def test_red_stops_before_the_line_and_gently(flow):
    way = _way(flow, "east in 1 to west")
    moments = _run(flow, vehicle(DRIVER, 0, way=way, at=30.0, speed=13.0), 25.0, light=RED)
    front = reach_of(moments[-1], flow.rules)[0][0]
    assert flow.rules.stop[way] - 2.5 < front < flow.rules.stop[way]
    assert moments[-1].speed[0] < 0.05
    assert min(moment.change[0] for moment in moments) > -4.0


def test_follower_keeps_its_distance_from_one_who_stands(flow):
    way = _way(flow, "east in 1 to west")
    first = vehicle(DRIVER, 0, way=way, at=126.0)
    second = vehicle(DRIVER, 1, way=way, at=40.0, speed=13.0)
    moments = _run(flow, join(first, second), 25.0, light=RED)
    gaps = [reach_of(m, flow.rules)[1][0] - reach_of(m, flow.rules)[0][1] for m in moments]
    assert min(gaps) > 1.0
    assert moments[-1].speed[1] < 0.05


def test_left_turn_waits_for_those_who_come_towards_it(flow):
    left, ahead = _way(flow, "east in 0 to south"), _way(flow, "west in 0 to east")
    waits = vehicle(DRIVER, 0, way=left, at=128.0, speed=3.0)
    comes = vehicle(DRIVER, 1, way=ahead, at=105.0, speed=13.0)
    moments = _run(flow, join(waits, comes), 20.0)
    index = flow.rules.overlaps.meeting[left, ahead, 0]
    start = flow.rules.overlaps.meetings.start[index]
    theirs = flow.rules.overlaps.meetings.other_end[index]
    entered = next(k for k, m in enumerate(moments) if reach_of(m, flow.rules)[0][0] > start)
    assert reach_of(moments[entered], flow.rules)[1][1] > theirs - 1.0
    assert moments[-1].at[0] > start + 8


def test_vehicle_lets_somebody_cross(flow):
    way = _way(flow, "east in 1 to west")
    crossing = int(np.flatnonzero(np.isfinite(flow.rules.overlaps.crossing[way, :, 0]))[0])
    lane = flow.rules.overlaps.beside[way, crossing]
    person = OnFoot(np.array([crossing]), np.array([lane]), np.array([1.0]), np.array([0.3]))
    moments = _run(flow, vehicle(DRIVER, 0, way=way, at=60.0, speed=12.0), 15.0, on_foot=person)
    front = reach_of(moments[-1], flow.rules)[0][0]
    assert front < flow.rules.overlaps.crossing[way, crossing, 0]
    assert moments[-1].speed[0] < 0.1


def test_nobody_on_the_road_is_no_error(flow):
    from geoaim.synthetic.traffic.comings import nobody

    assert len(_run(flow, nobody()[0], 1.0)[-1].at) == 0
