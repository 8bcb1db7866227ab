from dataclasses import replace

import pytest
import torch
from shapely import MultiPolygon, box

from geoaim.base.errors import TracksError
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.rendering.scene import make_scene, make_tracks
from geoaim.simulation.episodes import HISTORY_STEPS, POLICY_NAMES, simulate_scene
from geoaim.simulation.infractions import Lanes
from geoaim.simulation.road_rules import RoadRules, make_drivable, make_road_rules
from geoaim.simulation.scene_infractions import detect_infractions
from geoaim.tracks.files import write_tracks
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import RED, UNKNOWN, read_lights


@pytest.fixture(scope="module")
def hdmap():
    return read_hdmap("samples/map_full.osm", read_tracks("samples/tracks.csv").world)


@pytest.fixture(scope="module")
def scene(hdmap):
    """The bundled tracks on their HD map, rendered as an image."""
    tracks = read_tracks("samples/tracks.csv")
    lights = read_lights("samples/lights.csv", hdmap.stop_lines, hdmap.world)
    return make_scene(draw_hdmap(hdmap, resolution=0.5), tracks, lights)


def test_recorded_traffic_commits_no_infractions(scene, hdmap):
    rules = make_road_rules(hdmap)
    everyone = torch.ones(len(scene.ids)).bool()
    found = detect_infractions(scene, everyone, rules)
    counts = {name: int(infractions.sum()) for name, (infractions, _) in found.items()}
    contacts = counts.pop("contact")  # of pedestrians and cyclists, side by side
    assert counts == {"collision": 0, "red light": 0, "off road": 0, "wrong way": 0}
    assert 0 < contacts < 0.04 * float(found["contact"][1].sum())


def test_rates_stand_beside_those_of_the_recording(scene, hdmap):
    given = {"start": 5.0, "duration": 8.0, "rules": make_road_rules(hdmap)}
    replayed, straight = (simulate_scene(scene, x, **given) for x in ("replay", POLICY_NAMES[1]))
    recorded = replayed.recorded_rates
    assert straight.recorded_rates == recorded
    assert replayed.rates == recorded
    assert recorded["off road"] == 0
    assert straight.rates["off road"] > 0.03
    assert straight.rates["wrong way"] > recorded["wrong way"] == 0


@pytest.mark.slow
def test_turned_vehicles_drive_the_wrong_way(scene, hdmap):
    rules, everyone = make_road_rules(hdmap), torch.ones(len(scene.ids)).bool()
    half = torch.tensor([0.0, 0.0, torch.pi])
    turned = replace(scene, poses=scene.poses + half)
    wrong, on_lane = detect_infractions(turned, everyone, rules)["wrong way"]
    one_way = RoadRules(lanes=rules.lanes)
    right, _ = detect_infractions(scene, everyone, one_way)["wrong way"]
    assert not right.any()
    assert wrong.sum() > 0.9 * on_lane.sum() > 1000  # all but where lanes cross


def test_vehicles_beyond_the_map_are_not_off_road(scene):
    away = replace(scene, poses=scene.poses + torch.tensor([500.0, 0.0, 0.0]))
    area = MultiPolygon([box(600, 0, 800, 400)])
    rules = RoadRules(drivable=make_drivable(area))
    offroad, known = detect_infractions(away, torch.ones(len(scene.ids)).bool(), rules)["off road"]
    assert not known.any()
    assert not offroad.any()


def test_vehicles_where_the_map_has_no_image_are_not_off_road(scene):
    everyone = torch.ones(len(scene.ids)).bool()
    low, high = scene.ground.bounds[0].tolist()
    rules = RoadRules(drivable=make_drivable(MultiPolygon([box(*low, *high)])))
    coverage = scene.ground.coverage.clone()
    coverage[:, :, coverage.shape[2] // 2 :] = 0
    half = replace(scene, ground=replace(scene.ground, coverage=coverage))
    middle = scene.ground.bounds[0].mean(dim=0)[0]
    known = detect_infractions(half, everyone, rules)["off road"][1]
    assert known.any()
    x = scene.poses[:, 1:, 0]
    assert (x[known] < middle).all()


def test_a_noisy_vehicle_that_stands_on_a_stop_line_runs_one_light(scene):
    ends = scene.stop_lines[0]
    along = ends[1] - ends[0]
    heading = torch.atan2(along[1], along[0]) + torch.pi / 2
    forwards = torch.stack([heading.cos(), heading.sin()])
    centre = ends.mean(dim=0) - forwards * scene.sizes[0, 0] / 2
    noise = 0.02 * torch.randn(len(scene.times), 1, generator=torch.Generator().manual_seed(0))
    pose = torch.cat([centre + noise * forwards, heading.expand(len(noise), 1)], dim=1)
    alone = torch.arange(len(scene.ids)) == 0
    standing = replace(
        scene,
        poses=torch.where(alone[:, None, None], pose, scene.poses),
        present=alone[:, None].expand_as(scene.present),
        light_states=torch.full_like(scene.light_states, RED),
        types=("car", *scene.types[1:]),
    )
    assert detect_infractions(standing, alone, RoadRules())["red light"][0].sum() == 1


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


def test_without_a_duration_six_seconds_are_simulated_or_all_that_are_left(scene):
    whole, rest = (simulate_scene(scene, "replay", start=start) for start in (2.0, 54.5))
    assert len(whole.scene.times) == 61
    assert len(rest.scene.times) == 56
    assert float(rest.scene.times[-1]) == pytest.approx(60.0)


def test_what_cannot_be_simulated_is_refused(scene):
    with pytest.raises(ValueError, match="no policy 'best'"):
        simulate_scene(scene, "best")
    with pytest.raises(TracksError, match="agent 29 is not present at 2 s"):
        simulate_scene(scene, "replay", ego="29", start=2.0)
    with pytest.raises(ValueError, match=r"from 58 s on go beyond; simulate 2 seconds or fewer"):
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
    assert list(episode.rates) == ["collision", "collision with replay", "contact"]


def test_controlled_agents_are_present_in_simulated_steps(scene):
    episode = simulate_scene(scene, "replay", start=5.0, duration=2.0)
    there = episode.scene.present.t()[HISTORY_STEPS - 1 :]
    assert not there.any(dim=0).all()
    assert there[:, episode.controlled].any(dim=0).all()
    reversing = replace(scene, speeds=torch.full_like(scene.speeds, -2.0))
    with pytest.raises(TracksError, match="none that never reverses is present"):
        simulate_scene(reversing, "replay")


@pytest.mark.slow
def test_idm_drives_vehicles_without_overlaps(scene):
    episode = simulate_scene(scene, "idm", duration=60.0)
    types = {scene.types[k] for k in episode.controlled.nonzero()[:, 0].tolist()}
    assert types == {"car", "van"}
    assert episode.rates["collision"] == episode.rates["red light"] == 0
    driven, recorded = (
        float(part.speeds[episode.controlled].nan_to_num().sum()) for part in (episode.scene, scene)
    )
    assert driven > 0.8 * recorded
    people = scene.present & ~episode.controlled[:, None]
    torch.testing.assert_close(episode.scene.poses[people], scene.poses[people])


def test_idm_needs_vehicles_or_an_ego(scene):
    people = replace(scene, types=("pedestrian",) * len(scene.types))
    with pytest.raises(
        TracksError,
        match=r"no vehicle can be controlled.*or another policy, as this one moves vehicles",
    ):
        simulate_scene(people, "idm")
    assert simulate_scene(people, "idm", ego="12", start=4.0).controlled.sum() == 1
