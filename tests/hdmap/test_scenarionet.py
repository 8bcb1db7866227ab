"""Scenarios for ScenarioNet: a round trip of the sample, and refusals."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.scenarionet import STATES, write_scenarionet
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.files import read_plain_tracks
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import find_light_states, read_lights

SAMPLES = Path(__file__).parents[2] / "samples"
TRACKS = read_plain_tracks(SAMPLES / "tracks.csv")
HDMAP = read_hdmap(SAMPLES / "map.osm", TRACKS.world)
LIGHTS = read_lights(SAMPLES / "lights.csv", HDMAP.stop_lines, HDMAP.world)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "sample"
    write_scenarionet(TRACKS, folder, hdmap=HDMAP, lights=LIGHTS)
    return folder / "sd_geoaim_1.0_sample.pkl"


def test_tracks_come_back_as_they_were(scenario):
    read = read_tracks(scenario)
    order = [read.ids.index(name) for name in TRACKS.ids]
    assert read.world == TRACKS.world
    assert tuple(read.types[row] for row in order) == TRACKS.types
    np.testing.assert_array_equal(read.present[order], TRACKS.present)
    np.testing.assert_allclose(read.states[order], TRACKS.states, atol=1e-9)
    np.testing.assert_allclose(read.sizes[order], TRACKS.sizes, atol=1e-9)
    np.testing.assert_allclose(read.times, TRACKS.times)


def test_lights_stand_in_the_lanes_that_their_stop_lines_cross(scenario):
    content = pickle.loads(scenario.read_bytes())
    shown = find_light_states(LIGHTS, TRACKS.times)
    middles = LIGHTS.lines.mean(axis=1)
    assert len(content["dynamic_map_states"]) >= len(LIGHTS.names)
    for lane, light in content["dynamic_map_states"].items():
        assert content["map_features"][lane]["type"] == "LANE_SURFACE_STREET"
        distances = np.linalg.norm(middles - light["stop_point"][:2], axis=1)
        assert distances.min() < 3
        states = [STATES.get(state, "LANE_STATE_UNKNOWN") for state in shown[:, distances.argmin()]]
        assert light["state"]["object_state"] == states


def test_file_is_a_pickle_of_plain_data_with_a_summary(scenario):
    """The schema's checks (ScenarioDescription.sanity_check) in short."""
    content = pickle.loads(scenario.read_bytes())
    keys = {"id", "version", "length", "tracks", "dynamic_map_states", "map_features", "metadata"}
    assert set(content) == keys
    for name, track in content["tracks"].items():
        assert all(len(values) == content["length"] for values in track["state"].values())
        absent = ~track["state"]["valid"]
        assert all(not np.any(values[absent]) for values in track["state"].values())
        assert track["metadata"]["object_id"] == name
    lanes = [x for x in content["map_features"].values() if x["type"] == "LANE_SURFACE_STREET"]
    assert lanes
    assert all(x["polyline"].shape[1] == 3 and x["polyline"].flags.writeable for x in lanes)
    assert any(x["exit_lanes"] for x in lanes)
    ego = content["metadata"]["sdc_id"]
    assert content["tracks"][ego]["state"]["valid"][0]
    summary = pickle.loads((scenario.parent / "dataset_summary.pkl").read_bytes())
    mapping = pickle.loads((scenario.parent / "dataset_mapping.pkl").read_bytes())
    assert list(summary) == list(mapping) == [scenario.name]
    assert summary[scenario.name]["object_summary"][ego]["valid_length"] > 10


def test_ego_that_enters_later_and_other_rates_are_refused(tmp_path):
    late = TRACKS.ids[int((~TRACKS.present[:, 0]).argmax())]
    with pytest.raises(TracksError, match=rf"agent '{late}' is not present at 0 s"):
        write_scenarionet(TRACKS, tmp_path / "a", ego=late)
    with pytest.raises(TracksError, match="not at 10 Hz throughout"):
        write_scenarionet(resample_tracks(TRACKS, 5.0), tmp_path / "a")
    walking = replace(TRACKS, types=("pedestrian",) * len(TRACKS.types))
    with pytest.raises(TracksError, match="no vehicle is present at the first step"):
        write_scenarionet(walking, tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_lights_that_cross_no_lane_are_left_out_with_a_warning(tmp_path):
    far = replace(LIGHTS, lines=LIGHTS.lines + 1000.0)
    with pytest.warns(GeoaimWarning, match="are left out: their stop lines cross no lane"):
        write_scenarionet(TRACKS, tmp_path / "a", hdmap=HDMAP, lights=far)
