from dataclasses import replace

import numpy as np
import pytest

from geoaim.synthetic.roads.plan import make_roads
from geoaim.synthetic.traffic.gap_acceptance import react_to_vehicles
from geoaim.synthetic.traffic.pedestrians import look_ahead
from geoaim.synthetic.traffic.simulate import prepare_traffic
from geoaim.synthetic.traffic.spawning import (
    PedestrianTrip,
    VehicleTrip,
    make_pedestrian,
    make_vehicle,
)
from geoaim.synthetic.traffic.vehicles import place_vehicles
from geoaim.tracks.lights import GREEN, RED


@pytest.fixture(scope="module")
def model():
    return prepare_traffic(make_roads("t", np.random.default_rng(5)), np.random.default_rng(1))


def _reaction(model, gap, *, light=GREEN, marked=False):
    """A pedestrian at a crossing, and a vehicle at 12 m/s `gap` metres before it."""
    spans = model.tables.conflicts.crossing_span
    number = next(k for k, c in enumerate(model.roads.crossings) if c.marked == marked)
    path = int(np.flatnonzero(np.isfinite(spans[:, number, 0]))[0])
    trip = VehicleTrip(0.0, path, "car", (4.5, 1.8), 1.0, 1.0, (0.0, 0.0))
    s = spans[path, number, 0] - gap - 0.8 * 4.5
    placed = place_vehicles(make_vehicle(trip, 0, s=s, speed=12.0), model.tables)
    line = np.linspace(*model.roads.crossings[number].ends, 20)
    crossing = np.where(np.arange(20) < 1, -1, number)
    walk = PedestrianTrip(0.0, "pedestrian", line, crossing, 0.0, 1.4)
    pedestrians = make_pedestrian(walk, 0)
    outlook = look_ahead(pedestrians, model.crossings)
    crossings = replace(model.crossings, signal=np.zeros_like(model.crossings.signal))
    crossings = crossings if light == RED else model.crossings
    lights = np.array([light], np.int8)
    return react_to_vehicles(pedestrians, outlook, crossings, placed, model.tables, lights)


def test_pedestrian_waits_for_a_vehicle_at_an_unmarked_crossing(model):
    assert _reaction(model, gap=30.0).waits[0]


def test_pedestrian_accepts_a_long_gap(model):
    assert not _reaction(model, gap=110.0).waits[0]


def test_pedestrian_starts_at_a_marked_crossing_where_the_vehicle_can_stop(model):
    assert not _reaction(model, gap=40.0, marked=True).waits[0]
    assert _reaction(model, gap=10.0, marked=True).waits[0]


def test_pedestrian_waits_at_a_red_light(model):
    assert _reaction(model, gap=110.0, light=RED).waits[0]
