from dataclasses import replace

import pytest
import torch
from shapely import MultiPolygon, box

from geoaim.errors import TracksError
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.lights import UNKNOWN, read_lights
from geoaim.simulation.episodes import HISTORY_STEPS, POLICY_NAMES, simulate_scene
from geoaim.simulation.infractions import Lanes
from geoaim.simulation.road_rules import RoadRules, make_road_rules
from geoaim.simulation.scene import make_scene, make_tracks
from geoaim.track_files import write_tracks
from geoaim.track_formats import read_tracks


@pytest.fixture(scope="module")
def hdmap():
    return read_hdmap("samples/map_full.osm", read_tracks("samples/tracks.csv").world)


@pytest.fixture(scope="module")
def scene(hdmap):
    """The bundled tracks on their HD map, rendered as an image."""
    tracks = read_tracks("samples/tracks.csv")
    lights = read_lights("samples/lights.csv", hdmap.stop_lines, hdmap.world)
    return make_scene(draw_hdmap(hdmap, resolution=0.5), tracks, lights)


def test_replayed_traffic_commits_few_infractions(scene, hdmap):
    episode = simulate_scene(scene, "replay", start=5.0, duration=8.0, rules=make_road_rules(hdmap))
    assert episode.rates["red light"] < 0.001
    assert episode.rates["wrong way"] < 0.01
    assert episode.rates["collision"] < 0.02  # a step of replayed actions may touch in a queue


def test_only_the_ego_departs_from_the_recording(scene):
    episode = simulate_scene(scene, "constant-velocity", ego="12", start=4.0, duration=6.0)
    agent = scene.ids.index("12")
    recorded = scene.poses[:, 40:101]
    apart = (episode.scene.poses - recorded).abs().nan_to_num().amax(dim=(1, 2))
    assert apart[agent] > 1
    assert apart.sum() == apart[agent]
    assert episode.controlled.sum() == 1
    assert "off road" not in episode.rates


@pytest.mark.parametrize("policy", POLICY_NAMES)
def test_simulation_is_written_as_tracks(scene, hdmap, policy, tmp_path):
    episode = simulate_scene(scene, policy, start=2.0, duration=3.0)
    assert torch.isfinite(episode.scene.poses[episode.scene.present]).all()
    write_tracks(make_tracks(episode.scene, hdmap.world), tmp_path / "a.csv")
    again = read_tracks(tmp_path / "a.csv")
    assert len(again.times) == 31
    assert again.times[0] == pytest.approx(2.0)


def test_what_cannot_be_simulated_is_refused(scene):
    with pytest.raises(ValueError, match="no policy 'best'"):
        simulate_scene(scene, "best")
    with pytest.raises(TracksError, match="agent 29 is not present at 2 s"):
        simulate_scene(scene, "replay", ego="29", start=2.0)
    with pytest.raises(ValueError, match="9 seconds from start 58 s on are not all in the scene"):
        simulate_scene(scene, "replay", start=58.0, duration=9.0)
    for start in (-3.0, 61.0, torch.nan, torch.inf):
        with pytest.raises(ValueError, match="is not in the scene, from 0 to 60 s"):
            simulate_scene(scene, "replay", start=start)
    with pytest.raises(ValueError, match=r"simulate 0\.5 seconds or more"):
        simulate_scene(scene, "replay", duration=0.4)


def test_rules_of_another_place_are_refused(scene):
    far = MultiPolygon([box(3000, 3000, 3100, 3100)])
    with pytest.raises(TracksError, match="no drivable area touches the map: they lie between"):
        simulate_scene(scene, "replay", rules=make_road_rules(None, far))
    lanes = Lanes(torch.tensor([[3000.0, 0.0]]), torch.zeros(1), torch.ones(1))
    with pytest.raises(TracksError, match="no lane touches the map"):
        simulate_scene(scene, "replay", rules=RoadRules(lanes=lanes))


def test_infractions_that_cannot_occur_have_no_rate(scene):
    unknown = replace(scene, light_states=torch.full_like(scene.light_states, UNKNOWN))
    aside = Lanes(scene.stop_lines[:1, 0] + 15, torch.zeros(1), torch.full((1,), 0.01))
    episode = simulate_scene(unknown, "replay", start=5.0, rules=RoadRules(lanes=aside))
    assert list(episode.rates) == ["collision"]


def test_controlled_agents_are_present_in_simulated_steps(scene):
    episode = simulate_scene(scene, "replay", start=5.0, duration=2.0)
    there = episode.scene.present.t()[HISTORY_STEPS - 1 :]
    assert not there.any(dim=0).all()
    assert there[:, episode.controlled].any(dim=0).all()
    reversing = replace(scene, speeds=torch.full_like(scene.speeds, -2.0))
    with pytest.raises(TracksError, match="none that never reverses is present"):
        simulate_scene(reversing, "replay")
