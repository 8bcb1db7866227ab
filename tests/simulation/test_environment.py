"""The gymnasium environment on the sample: its interface, goals, infractions and rewards."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from benchmarks.simulation.environment import drive_random_steps, make_sample_environment
from geoaim.base.errors import TracksError
from geoaim.rendering.ground import View
from geoaim.rendering.layers import EGO_COLOUR
from geoaim.simulation.environment import (
    EGO_VALUES,
    NEIGHBOURS,
    RENDERED,
    ROAD_POINTS,
    DrivingEnv,
    EnvConfig,
)
from geoaim.simulation.infractions import detect_offroad
from geoaim.simulation.kinematics import bicycle
from geoaim.simulation.simulator import Traffic
from geoaim.tracks.agent_types import select_group


@pytest.fixture(scope="module")
def env():
    return make_sample_environment()


def follow_recording(env):
    """The actions that move the ego as recorded, from -1 to 1."""
    ego = env._driven[0]
    limits = torch.tensor([env.config.max_acceleration, env.config.max_steering])
    while True:
        state = torch.from_numpy(ego.state)
        wanted = env.scene.states[ego.agent, env._step + 1]
        action = (
            bicycle.inverse(state, wanted, env.scene.sizes[ego.agent, 0], env.scene.dt) / limits
        )
        yield action.clamp(-1, 1).nan_to_num().numpy()


FORMS = {
    "plain": {},
    "image and pictures": {"view": View(48, 40, 1.0), "render_mode": "rgb_array"},
    "two egos": {"egos": 2, "view": View(24, 24, 2.0)},
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.filterwarnings("ignore:.*WARN.*")  # of an environment outside of the registry
@pytest.mark.usefixtures("unchecked")
def test_gymnasium_finds_no_fault(env, form):
    own = DrivingEnv(env.scene, env.rules, **FORMS[form])
    check_env(own, skip_render_check=own.render_mode is None)


def test_recorded_drive_reaches_its_goal(env):
    _, info = env.reset(seed=3)
    start = np.linalg.norm(env._driven[0].goal - env._driven[0].state[:2])
    total = 0.0
    for action in follow_recording(env):
        _, reward, terminated, truncated, info = env.step(action)
        total += reward
        if terminated or truncated:
            break
    assert info["reached"]
    assert not info["collided"]
    assert not info["left_road"]
    assert total == pytest.approx(start - env.config.goal_radius + 10, abs=1.5)


def test_same_seed_gives_the_same_episode(env):
    runs = []
    for _ in range(2):
        first, info = env.reset(seed=11)
        second, *_ = env.step(np.array([0.5, 0.1], np.float32))
        runs.append((info["ego"], info["time"], first, second))
    assert runs[0][:2] == runs[1][:2]
    np.testing.assert_array_equal(runs[0][2:], runs[1][2:])


def test_observation_is_what_lies_around_the_ego(env):
    observation, info = env.reset(seed=5)
    assert env.observation_space.contains(observation)
    assert info["ego"] in env.scene.ids
    speed, x, y, distance, left = observation[:EGO_VALUES]
    assert speed == env._driven[0].state[3]
    assert distance == pytest.approx(np.hypot(x, y), rel=1e-5)
    heading = env._driven[0].state[2]
    east = x * np.cos(heading) - y * np.sin(heading)
    assert east == pytest.approx(env._driven[0].goal[0] - env._driven[0].state[0], abs=1e-3)
    assert 0 < left <= env.config.duration
    road = observation[EGO_VALUES : EGO_VALUES + len(ROAD_POINTS)]
    assert road[ROAD_POINTS.index((0.0, 0.0))] < 0
    others = observation[EGO_VALUES + len(ROAD_POINTS) :].reshape(NEIGHBOURS, -1)
    distances = np.hypot(*others[:, :2].T)
    assert (np.diff(distances[distances > 0]) >= 0).all()


def test_leaving_the_road_ends_the_episode_and_costs(env):
    env.reset(seed=1)
    for _ in range(200):
        _, reward, terminated, truncated, info = env.step(np.array([1.0, 1.0], np.float32))
        if terminated or truncated:
            break
    assert terminated
    assert info["left_road"] or info["collided"]
    assert reward < -5


def test_the_road_is_left_where_the_rates_count_it(env):
    ends = set()
    for seed in range(12):
        env.reset(seed=seed)
        terminated = truncated = False
        while not (terminated or truncated):
            _, _, terminated, truncated, info = env.step(np.zeros(2, np.float32))
            pose, size = (
                torch.from_numpy(env._driven[0].state[None, :3]),
                env.scene.sizes[env._driven[0].agent][None],
            )
            offroad, _ = detect_offroad(env.rules.drivable, pose, size, torch.ones(1).bool())
            assert info["left_road"] == bool(offroad)
        ends.add(info["left_road"])
    assert ends == {True, False}


def test_collision_ends_the_episode(env):
    env.reset(seed=2)
    other = env._driven[0].others[0][0]
    env._driven[0].state = other.copy()
    _, _, terminated, _, info = env.step(np.zeros(2, np.float32))
    assert terminated
    assert info["collided"]


def test_braking_stops_and_does_not_reverse(env):
    env.reset(seed=4)
    for _ in range(60):
        _, _, terminated, truncated, _ = env.step(np.array([-1.0, 0.0], np.float32))
        assert env._driven[0].state[3] >= -1e-5
        if terminated or truncated:
            break


def test_reward_is_a_plain_function_of_the_transition(env):
    seen = []

    def reward(transition):
        seen.append(transition)
        return 7.0

    own = DrivingEnv(env.scene, env.rules, reward=reward)
    own.reset(seed=0)
    assert own.step(np.array([1.0, 0.0], np.float32))[1] == 7.0
    assert seen[0].action.tolist() == [4.0, 0.0]
    assert seen[0].next_state[3] == pytest.approx(seen[0].state[3] + 0.4, abs=1e-5)


def test_ego_and_start_are_chosen_by_options(env):
    agent = sorted(env._starts)[0]
    ego, time = env.scene.ids[agent], float(env.scene.times[env._starts[agent][0]])
    _, info = env.reset(options={"ego": ego, "start": time})
    assert (info["ego"], info["time"]) == (ego, time)
    pedestrian = env.scene.ids[env.scene.types.index("pedestrian")]
    with pytest.raises(TracksError, match=r"no vehicle can start with .* present for 3 s"):
        env.reset(options={"ego": pedestrian})
    with pytest.raises(ValueError, match="is not in the scene"):
        env.reset(options={"start": 1e6})


def test_unknown_options_are_refused(env):
    with pytest.raises(ValueError, match="unknown options begin; there are ego and start"):
        env.reset(options={"begin": 2.0})


@pytest.mark.parametrize("action", [[np.nan, 0.0], [np.inf, 0.0], [0.5], [0.0, 0.0, 0.0]])
@pytest.mark.usefixtures("unchecked")
def test_actions_that_are_not_two_numbers_are_refused(env, action):
    env.reset(seed=5)
    with pytest.raises(ValueError, match=r"the action is .* two finite numbers"):
        env.step(np.array(action, np.float32))
    env.step(np.zeros(2, np.float32))  # the episode goes on


def test_steps_outside_an_episode_are_refused(env):
    new = DrivingEnv(env.scene, env.rules, config=EnvConfig(duration=3.0))
    brake = np.array([-1.0, 0.0], np.float32)
    with pytest.raises(ResetNeeded, match="call reset before step"):
        new.step(brake)
    new.reset(seed=0)
    while not any(new.step(brake)[2:4]):
        pass
    with pytest.raises(ResetNeeded, match="call reset before step"):
        new.step(brake)


def test_unevenly_spaced_steps_are_refused(env):
    times = env.scene.times.clone()
    times[10:] += 5.0
    with pytest.raises(ValueError, match="evenly spaced"):
        DrivingEnv(replace(env.scene, times=times), env.rules)


def test_scene_without_moving_vehicles_is_refused(env):
    with pytest.raises(TracksError, match="no vehicle is present for 3 s and moves 1e"):
        DrivingEnv(env.scene, config=EnvConfig(min_travel=1e9))


def still(egos=1):
    return np.zeros((egos, 2) if egos > 1 else 2, np.float32)


def test_pictures_and_image_observations_show_the_ego_in_the_middle(env):
    given = {"view": View(64, 64, 0.5), "render_mode": "rgb_array"}
    own = DrivingEnv(env.scene, env.rules, **given)
    with pytest.raises(ResetNeeded, match="call reset before render"):
        own.render()
    observation, _ = own.reset(seed=3)
    picture = own.render()
    assert observation["image"].shape == (64, 64, 3)
    orange = 255 * np.array(EGO_COLOUR)
    for image, metres in ((observation["image"], 0.5), (picture, RENDERED.resolution)):
        middle, off = len(image) // 2, round(1.2 / metres)  # beside the white triangle in front
        np.testing.assert_allclose(image[middle + off, middle], orange, atol=40)
    own.step(still())
    assert (own.render() != picture).any()
    assert env.render() is None  # without a mode
    with pytest.raises(ValueError, match="render_mode='human'"):
        DrivingEnv(env.scene, env.rules, render_mode="human")


def test_egos_see_each_other_and_are_judged_apart(env):
    own = DrivingEnv(env.scene, env.rules, egos=2)
    observation, info = own.reset(seed=0)
    assert observation.shape == (2, *env.observation_space.shape)
    assert len(set(info["ego"])) == 2
    first, second = own._driven
    second.state = first.state + np.array([0.5, 0, 0, 0], np.float32)
    _, reward, terminated, _, info = own.step(still(2))
    assert terminated
    assert info["collided"] == [True, True]
    assert reward < -15
    _, info = own.reset(options={"ego": info["ego"][::-1]})
    assert info["ego"] == [own.scene.ids[ego.agent] for ego in own._driven]
    with pytest.raises(ValueError, match="up to 2 are driven, each once"):
        own.reset(options={"ego": ["1", "1"]})
    with pytest.raises(TracksError, match="no 65 vehicles are present"):
        DrivingEnv(env.scene, env.rules, egos=65)


def brake_all(scene, controlled, history, generator):
    """Traffic that brakes, however it is recorded."""

    def act(scenario, path):
        actions = torch.zeros_like(path[:, :, -1, :2])
        actions[..., 0] = -path[:, :, -1, 3] / scenario.dt
        return actions

    return act


def test_traffic_moves_all_other_vehicles(env):
    own = DrivingEnv(env.scene, env.rules, traffic=Traffic("vehicle", brake_all))
    own.reset(seed=0)
    vehicles = select_group(env.scene.types, "vehicle")
    for _ in range(3):
        own.step(still())
    others = vehicles & own._present[own._step - 2 : own._step + 1].all(axis=0)
    others[own._driven[0].agent] = False
    recorded = own._recorded[own._step]
    assert np.abs(recorded[others, 3]).max() > 3
    assert np.abs(own._now[others, 3]).max() < 1e-4
    walkers = own._present[own._step] & select_group(env.scene.types, "pedestrian")
    np.testing.assert_array_equal(own._now[walkers], recorded[walkers])


def test_random_driving_goes_on_after_episodes_end(env):
    env.reset(seed=0)
    drive_random_steps(env, 100)


@pytest.mark.parametrize("value", [0.0, -2.0, np.nan, np.inf])
def test_options_that_are_not_positive_are_refused(value):
    with pytest.raises(ValueError, match=r"goal_radius of the environment is .*; give a positive"):
        EnvConfig(goal_radius=value)
