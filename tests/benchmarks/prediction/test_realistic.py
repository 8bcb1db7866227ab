import numpy as np
import pytest

from benchmarks.prediction import realistic
from benchmarks.prediction.places import read_recordings
from benchmarks.prediction.realistic import add_detection_noise, add_standing, read_realistic_map


@pytest.fixture(scope="module")
def tracks(place):
    return read_recordings(place)[0].tracks


def added(tracks):
    """Rows of the agents that `add_standing` added."""
    return [row for row, name in enumerate(tracks.ids) if name.startswith("standing")]


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(realistic, "STANDING_S", 10.0)


def test_added_agents_stand_where_no_other_agent_is(tracks):
    more = add_standing(tracks, np.random.default_rng(0))
    count = len(tracks.ids)
    assert 20 < len(more.ids) - count <= sum(realistic.STANDING.values())
    for agent in range(count, len(more.ids)):
        here = more.states[agent, more.present[agent]]
        assert 9.5 < more.present[agent].sum() / realistic.RATE < 10.5
        assert np.ptp(here, axis=0).max() == 0
        others = tracks.states[tracks.present][::5]
        distances = np.hypot(*(others[:, :2] - here[0, :2]).T)
        assert distances.min() > realistic.CLEARANCE_M


def test_vehicles_are_added_in_rows_side_by_side(tracks):
    more = add_standing(tracks, np.random.default_rng(0))
    poses = np.array([more.states[agent, more.present[agent]][0, :3] for agent in added(more)])
    gaps = np.hypot(*(poses[1:, :2] - poses[:-1, :2]).T)
    beside = np.isclose(gaps, realistic.ROW_PITCH_M)
    assert beside.sum() > 5
    assert (poses[1:, 2] == poses[:-1, 2])[beside].all()


def test_who_stands_keeps_the_heading_despite_detection_noise(tracks):
    more = add_standing(tracks, np.random.default_rng(0))
    noisy = add_detection_noise(more, np.random.default_rng(1))
    for agent in added(more):
        known = np.isfinite(noisy.observed[agent, :, 2])
        assert known.sum() > 50
        assert np.ptp(noisy.observed[agent, known, 2]) == 0
        assert np.ptp(noisy.observed[agent, known, 0]) > 0.02


def test_detection_noise_moves_all_states_and_knows_no_later_row(tracks):
    noisy = add_detection_noise(tracks, np.random.default_rng(0))
    errors = (noisy.states - tracks.states)[tracks.present][:, :2]
    assert 0.03 < errors.std() < 0.2
    assert abs(errors.mean()) < 0.02
    assert noisy.observed is not None
    assert (noisy.present == tracks.present).all()


@pytest.mark.parametrize("name", ["drawn", "later", "bad", "bad later", "lanes"])
def test_maps_of_all_sorts_show_the_same_ground(place, name):
    aim, drawn = read_realistic_map(place, name), read_realistic_map(place, "drawn")
    assert aim.world == drawn.world
    middle = drawn.corners.mean(axis=0)
    assert (aim.corners.min(axis=0) < middle).all()
    assert (middle < aim.corners.max(axis=0)).all()
    if name == "bad":
        assert np.abs(aim.image.astype(float) - drawn.image).mean() > 2
