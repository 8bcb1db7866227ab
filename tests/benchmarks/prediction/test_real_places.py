"""The experiments on real places, on recordings of a synthetic one."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.prediction import observed_states, own_place, songdo, zero_shot
from benchmarks.prediction.places import read_map, read_recordings
from benchmarks.prediction.real_places import RealRecording, read_karlsruhe, read_stanford
from benchmarks.prediction.results import Workspace
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.config import SEGMENT_STEPS
from geoaim.rendering.scene import slice_scene
from geoaim.simulation.road_rules import NO_ROAD_RULES
from geoaim.tracks.changes import cut_tracks


@pytest.fixture
def recording(place):
    """Half a minute of a recording."""
    whole = read_recordings(place)[0]
    tracks = cut_tracks(whole.tracks, float(whole.tracks.times[0]), 30.0)
    return RealRecording(tracks, read_map(place, "aim"))


def read_methods(paths):
    return json.loads(paths[0].read_text())["methods"]


def test_zero_shot_models_stand_beside_baselines_and_the_recordings_rates(
    recording, monkeypatch, tmp_path
):
    cases = [(slice_scene(recording.make_scene(0.1), slice(0, 90)), NO_ROAD_RULES)]
    some = zero_shot.RecordingSet("vehicle", cases, SEGMENT_STEPS["vehicle"])
    monkeypatch.setattr(zero_shot, "_list_sets", lambda: {"here, 1 place, vehicles": some})
    methods = read_methods(zero_shot.run(Workspace(tmp_path, tmp_path)))
    rows = "ITRA", *BASELINES, "recording", "ITRA, networks alone"
    names = [f"here, 1 place, vehicles, {name}" for name in rows]
    assert list(methods) == names
    assert methods[names[0]]["minADE"]["segments"] == 2
    assert list(methods[names[-2]]) == ["collision rate"]


def test_what_is_told_beforehand_is_counted_with_what_came(recording, monkeypatch, tmp_path):
    scene = slice_scene(recording.make_scene(0.1), slice(0, 130))
    monkeypatch.setattr(zero_shot, "_list_tested_places", lambda: {"here": lambda: [scene]})
    monkeypatch.setattr(zero_shot, "TESTED_S", (3,))
    paths = zero_shot.run_tests_before(Workspace(tmp_path, tmp_path))
    (row,) = json.loads(paths[0].read_text())["places"]
    told = [row[f"told {answer}, then better"] for answer in ("better", "as good", "worse")]
    counts = [int(cell.split(",")[0]) for cell in told]
    assert row["untested"] == 1  # nothing was recorded before the first one
    assert sum(counts) == row["starts"] - 1 > 0


def test_recordings_of_a_junction_are_of_one_place(recording, monkeypatch):
    monkeypatch.setattr(own_place, "read_karlsruhe", lambda name: iter([recording, recording]))
    first, second = own_place._read_junction("here").scenes
    assert first.ground is second.ground  # models of several places get no network of the place


def test_estimates_from_the_past_are_compared(recording, monkeypatch, tmp_path):
    first = cut_tracks(recording.tracks, float(recording.tracks.times[0]), 5.0)
    monkeypatch.setattr(songdo, "read_recording", lambda: RealRecording(first, recording.aim))
    monkeypatch.setattr(observed_states, "read_stanford", lambda place: [recording])
    monkeypatch.setattr(observed_states, "WINDOWS_S", {0: (0.5,), 1: (0.5,)})
    methods = read_methods(observed_states.run(Workspace(tmp_path, tmp_path)))
    assert list(methods)[1:] == ["differences of 0.5 s", "line of 0.5 s"]
    assert {"Songdo, ITRA", "Stanford, constant velocity"} < set(methods["line of 0.5 s"])


@pytest.mark.parametrize(("degree", "speed"), [(0, 3.5), (1, 3.5), (2, 4.0)])
def test_estimates_of_an_accelerating_car_lag_unless_they_fit_a_parabola(recording, degree, speed):
    """x = t^2 / 2: over the last second the mean speed is half a metre a second below."""
    times = np.arange(41) / 10
    states = np.zeros((1, 41, 4))
    states[0, :, 0] = times**2 / 2
    one = replace(
        recording.tracks,
        times=times,
        states=states,
        present=np.ones((1, 41), bool),
        sizes=np.ones((1, 2)),
        types=("car",),
        ids=("1",),
        observed=None,
    )
    velocity = observed_states._estimate(degree, 1.0, one)
    assert velocity[0, -1] == pytest.approx([speed, 0], abs=1e-6)


def test_real_recordings_lie_on_their_maps(data_folder):
    stanford = next(iter(read_stanford("gates")))
    scene = stanford.make_scene(0.4)
    low, high = scene.ground.bounds[0]
    places = scene.poses[scene.present][:, :2]
    assert ((places > low) & (places < high)).all(dim=1).float().mean() > 0.95
    karlsruhe = next(iter(read_karlsruhe("k729_2022-03-16")))
    assert karlsruhe.rules.drivable is not None
