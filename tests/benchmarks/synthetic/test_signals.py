from itertools import pairwise

import numpy as np
import pytest

from benchmarks.synthetic.roads.plan import make_roads
from benchmarks.synthetic.traffic.signals import compute_light_states, make_signals
from geoaim.tracks.lights import GREEN, RED, YELLOW


@pytest.fixture(scope="module")
def signals():
    generator = np.random.default_rng(1)
    return make_signals(make_roads("junction", generator), generator)


def test_roads_that_cross_are_never_green_together(signals):
    states = compute_light_states(signals, np.arange(0, 200, 0.1))
    open_ = {name: states[:, k] != RED for k, name in enumerate(signals.names)}
    assert not (open_["east"] & open_["north"]).any()
    assert not (open_["east"] & open_["walk east"]).any()
    assert not (open_["north"] & open_["walk north"]).any()
    assert open_["east"].any()
    assert open_["north"].any()


def test_yellow_lies_between_green_and_red(signals):
    states = compute_light_states(signals, np.arange(0, 200, 0.1))[:, signals.names.index("east")]
    changes = {(a, b) for a, b in pairwise(states) if a != b}
    assert changes == {(GREEN, YELLOW), (YELLOW, RED), (RED, GREEN)}
    yellow = np.diff(np.flatnonzero(np.diff((states == YELLOW).astype(int))))[0]
    assert yellow * 0.1 == pytest.approx(3.0, abs=0.15)


def test_lights_repeat(signals):
    times = np.arange(0, 30, 0.5)
    later = compute_light_states(signals, times + signals.cycle)
    np.testing.assert_array_equal(compute_light_states(signals, times), later)


def test_place_without_lights_has_none():
    generator = np.random.default_rng(1)
    signals = make_signals(make_roads("roundabout", generator), generator)
    assert compute_light_states(signals, np.arange(3.0)).shape == (3, 0)
