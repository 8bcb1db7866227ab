"""The registered environment, and traffic that drives as a model samples."""

import gymnasium
import numpy as np
import pytest
import torch

import geoaim.gym
from geoaim.prediction import make_traffic, read_pretrained
from geoaim.prediction.environments import make_environment
from geoaim.simulation.episodes import HISTORY_STEPS, simulate_scene
from geoaim.tracks.agent_types import select_group
from tests.prediction.test_itra import KINDS, model

ENVIRONMENT = geoaim.gym.ENVIRONMENT


@pytest.fixture(scope="module")
def env():
    return gymnasium.make(ENVIRONMENT, traffic="itra", render_mode="rgb_array")


def drive(env, action, steps=20):
    """Drive by one action; the states of all agents at each step."""
    env.reset(seed=1)
    path = []
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(np.array(action, np.float32))
        path.append(env.unwrapped._now)
        if terminated or truncated:
            break
    return np.stack(path)


@pytest.mark.usefixtures("unchecked")
def test_traffic_by_the_model_moves_as_no_recording_and_alike_for_a_seed(env):
    first, again = drive(env, [0.0, 0.0]), drive(env, [0.0, 0.0])
    np.testing.assert_array_equal(first, again)
    own = env.unwrapped
    vehicles = select_group(own.scene.types, "vehicle") & own._present[own._step]
    vehicles[own._driven[0].agent] = False
    away = np.hypot(*(first[-1] - own._recorded[own._step])[vehicles, :2].T)
    assert 0.1 < away.max() < 30
    assert np.median(away) < 5
    walkers = select_group(own.scene.types, "pedestrian") & own._present[own._step]
    np.testing.assert_array_equal(first[-1, walkers], own._recorded[own._step, walkers])
    assert env.render().shape == (512, 512, 3)


def test_unknown_traffic_and_rules_without_a_scene_are_refused():
    with pytest.raises(ValueError, match="there is no traffic 'idm'"):
        make_environment(traffic="idm")
    with pytest.raises(ValueError, match="rules are given without the scene"):
        make_environment(rules=make_environment().rules)


def test_scenes_are_simulated_by_a_model_as_its_generator_has_it(env):
    scene = env.unwrapped.scene
    traffic = make_traffic(read_pretrained("vehicle"))
    both = [
        simulate_scene(scene, traffic, start=4.0, duration=1.5, generator=torch.manual_seed(seed))
        for seed in (0, 0, 1)
    ]
    first, again, other = (episode.scene.states.nan_to_num() for episode in both)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    controlled = both[0].controlled
    assert set(np.array(scene.types)[controlled.numpy()]) <= {"car", "van", "truck", "bus"}
    begin = scene.states[:, 40 : 40 + HISTORY_STEPS].nan_to_num()
    assert torch.equal(first[:, :HISTORY_STEPS], begin)
    assert torch.equal(first[~controlled], scene.states[~controlled, 40:56].nan_to_num())
    pedestrian = scene.ids[scene.types.index("pedestrian")]
    with pytest.raises(geoaim.GeoaimError):
        simulate_scene(scene, traffic, ego=pedestrian, start=4.0)


def test_models_with_proposals_are_no_traffic():
    kinds = [config for config in KINDS.values() if config.num_anchors]
    with pytest.raises(ValueError, match="which end with their horizon"):
        make_traffic(model(kinds[0]))
