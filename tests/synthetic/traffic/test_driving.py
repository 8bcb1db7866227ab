import numpy as np
import pytest

from geoaim.synthetic.roads.plan import make_roads
from geoaim.synthetic.traffic.driving import step_vehicles
from geoaim.synthetic.traffic.pedestrians import CrossingPedestrians
from geoaim.synthetic.traffic.simulate import DT, prepare_traffic
from geoaim.synthetic.traffic.spawning import VehicleTrip, concat, make_empty, make_vehicle
from geoaim.synthetic.traffic.vehicles import make_vehicle_context, place_vehicles
from geoaim.tracks.lights import GREEN, RED

NO_PEDESTRIANS = CrossingPedestrians(np.empty(0, int), np.empty(0), np.empty(0), np.empty(0))


def _junction():
    """The first junction whose left turns share their lane."""
    plans = (make_roads("junction", np.random.default_rng(seed)) for seed in range(9))
    return next(roads for roads in plans if roads.layout.approaches[0].turns[0] == "LS")


@pytest.fixture(scope="module")
def model():
    return prepare_traffic(_junction(), np.random.default_rng(1))


def _path(model, name):
    return next(k for k, path in enumerate(model.paths) if path.name.startswith(name))


def _vehicle(path, number=0, **state):
    trip = VehicleTrip(0.0, path, "car", (4.5, 1.8), 1.0, 1.0, (0.0, 0.0))
    return make_vehicle(trip, number, **state)


def _simulate(model, vehicles, duration, *, light=GREEN, pedestrians=NO_PEDESTRIANS):
    """The states at all steps, with all lights alike."""
    lights = np.full(len(model.signals.names), light, np.int8)
    context, states = make_vehicle_context(vehicles, model.tables), [vehicles]
    for _ in range(round(duration / DT)):
        placed = place_vehicles(vehicles, model.tables)
        vehicles = step_vehicles(placed, context, model.tables, lights, pedestrians, DT)
        states.append(vehicles)
    return states


def test_lone_vehicle_drives_at_the_speed_limit(model):
    path = _path(model, "east in 1 to west")
    end = _simulate(model, _vehicle(path, speed=5.0), 12.0)[-1]
    assert end.speed[0] == pytest.approx(13.9, rel=0.03)


def test_vehicle_stops_gently_before_a_red_light(model):
    path = _path(model, "east in 1 to west")
    states = _simulate(model, _vehicle(path, s=30.0, speed=13.0), 25.0, light=RED)
    front = place_vehicles(states[-1], model.tables).front[0]
    assert model.tables.stop[path] - 2.5 < front < model.tables.stop[path]
    assert states[-1].speed[0] < 0.05
    assert min(state.acceleration[0] for state in states) > -4.0


def test_follower_keeps_its_distance_from_a_standing_leader(model):
    path = _path(model, "east in 1 to west")
    first, second = _vehicle(path, 0, s=126.0), _vehicle(path, 1, s=40.0, speed=13.0)
    states = _simulate(model, concat(first, second), 25.0, light=RED)
    placed = [place_vehicles(state, model.tables) for state in states]
    assert min(p.rear[0] - p.front[1] for p in placed) > 1.0
    assert states[-1].speed[1] < 0.05


def test_left_turn_waits_for_oncoming_vehicles(model):
    left, straight = _path(model, "east in 0 to south"), _path(model, "west in 0 to east")
    waiting = _vehicle(left, 0, s=128.0, speed=3.0)
    oncoming = _vehicle(straight, 1, s=105.0, speed=13.0)
    states = _simulate(model, concat(waiting, oncoming), 20.0)
    index = model.tables.conflicts.zone_index[left, straight, 0]
    start = model.tables.conflicts.zones.start[index]
    other_end = model.tables.conflicts.zones.other_end[index]
    placed = [place_vehicles(state, model.tables) for state in states]
    entered = next(p for p in placed if p.front[0] > start)
    assert entered.rear[1] > other_end - 1.0
    assert states[-1].s[0] > start + 8


def test_vehicle_lets_a_pedestrian_cross(model):
    path, conflicts = _path(model, "east in 1 to west"), model.tables.conflicts
    crossing = int(np.flatnonzero(np.isfinite(conflicts.crossing_span[path, :, 0]))[0])
    offset = conflicts.crossing_offset[path, crossing]
    values = (np.array([value]) for value in (crossing, offset, 1.0, 0.3))
    pedestrian = CrossingPedestrians(*values)
    vehicle = _vehicle(path, s=60.0, speed=12.0)
    end = _simulate(model, vehicle, 15.0, pedestrians=pedestrian)[-1]
    front = place_vehicles(end, model.tables).front[0]
    assert front < conflicts.crossing_span[path, crossing, 0]
    assert end.speed[0] < 0.1


def test_empty_road_is_no_error(model):
    assert len(_simulate(model, make_empty().vehicles, 1.0)[-1].s) == 0
