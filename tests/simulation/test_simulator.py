from dataclasses import replace

import numpy as np
import pytest
import torch

from geoaim.rendering import OrientedBoxes, Scene, View, make_ground, prefilter_ground, render
from geoaim.simulation.kinematics import bicycle, unicycle
from geoaim.simulation.simulator import (
    Scenario,
    apply_rollout,
    collate_scenarios,
    constant_turn_rate,
    constant_velocity,
    invert_step,
    rollout,
    step,
)

DT = 0.1


def _recording(steps=21, dtype=torch.float64):
    """A car straight on, one on a circle, and a pedestrian that is present in between only."""
    time = torch.arange(steps, dtype=dtype) * DT
    zero = torch.zeros_like(time)
    straight = torch.stack([10 * time, zero, zero, zero + 10], -1)
    circle = [torch.tensor([-30.0, 0, 0, 8], dtype=dtype)]
    for _ in time[1:]:
        turn = torch.tensor([0.0, 0.3], dtype=dtype)
        circle.append(bicycle.step(circle[-1], turn, torch.tensor(4.5, dtype=dtype), DT))
    pedestrian = torch.stack([zero + 5, time - 6, zero + np.pi / 2, zero + 1], -1)
    states = torch.stack([straight, torch.stack(circle), pedestrian])[None]
    present = torch.ones(1, 3, steps, dtype=torch.bool)
    present[0, 2, :5] = present[0, 2, 15:] = False
    sizes = torch.tensor([[[4.5, 1.9], [4.5, 1.9], [0.5, 0.5]]], dtype=dtype)
    states = torch.where(present[..., None], states, 0.0)
    return Scenario(states, present, sizes, torch.tensor([[False, False, True]]), DT)


ALL_AGENTS = torch.ones(1, 3, dtype=torch.bool)


def test_inverted_steps_reproduce_a_recording_by_the_motion_models():
    scenario = _recording()

    def follow(scenario, path):
        return invert_step(scenario, path[:, :, -1], scenario.states[:, :, path.shape[2]])

    result = rollout(scenario, follow, ALL_AGENTS)
    apart = (result - scenario.states)[..., :2].norm(dim=-1)
    assert apart[scenario.present].max() < 1e-6


def test_pedestrians_move_by_the_unicycle_and_all_others_by_the_bicycle():
    states = torch.tensor([[8.0, 1.0, 0.6, 4.0], [8.0, 1.0, 0.6, 4.0]]).double()
    actions = torch.tensor([[1.0, 0.3], [1.0, 2.5]]).double()
    sizes = torch.tensor([[4.5, 1.9], [0.0, 0.0]]).double()  # a padded pedestrian has no length
    both = torch.ones(1, 2, 2, dtype=torch.bool)
    pedestrian = torch.tensor([[False, True]])
    scenario = Scenario(states[:, None].expand(1, 2, 2, 4), both, sizes[None], pedestrian, DT)
    start = states[None].requires_grad_()
    after = step(scenario, 0, start, actions[None], both[..., 0])
    length = sizes[0, 0]
    torch.testing.assert_close(after[0, 0], bicycle.step(states[0], actions[0], length, DT))
    torch.testing.assert_close(after[0, 1], unicycle.step(states[1], actions[1], length, DT))
    torch.testing.assert_close(invert_step(scenario, states[None], after)[0], actions)
    (gradient,) = torch.autograd.grad(after.sum(), start)
    assert torch.isfinite(gradient).all()


def test_agents_that_are_not_controlled_replay_the_recording():
    scenario = _recording()

    def wild(scenario, path):
        return torch.full_like(path[:, :, -1, :2], 0.5)

    controlled = torch.tensor([[True, False, False]])
    result = rollout(scenario, wild, controlled)
    torch.testing.assert_close(result[:, 1:], scenario.states[:, 1:])
    assert (result[0, 0, -1] - scenario.states[0, 0, -1]).norm() > 1


def test_agents_enter_in_the_recorded_state():
    scenario = _recording()
    result = rollout(scenario, constant_velocity, ALL_AGENTS)
    torch.testing.assert_close(result[0, 2, 5], scenario.states[0, 2, 5])
    torch.testing.assert_close(result[0, 2, 14], scenario.states[0, 2, 14])
    assert not result[0, 2, 15:].any()


def test_simple_policies_keep_velocity_or_turn_rate():
    scenario = _recording()
    straight = rollout(scenario, constant_velocity, ALL_AGENTS, history=5)
    round_on = rollout(scenario, constant_turn_rate, ALL_AGENTS, history=5)
    torch.testing.assert_close(straight[:, 0], scenario.states[:, 0])
    assert (straight - scenario.states)[0, 1, -1, :2].norm() > 0.5
    assert (round_on - scenario.states)[0, 1, -1, :2].norm() < 1e-6


def test_gradients_through_ten_steps_of_rendering_and_driving():
    """Render, policy, kinematics, closed loop, against central differences."""
    scenario = _recording(steps=11)
    v, u = torch.meshgrid(torch.arange(64.0), torch.arange(64.0), indexing="ij")
    image = (0.5 + 0.3 * torch.sin(u / 6) * torch.cos(v / 8)).double()[None]
    ground = make_ground(image, torch.tensor([[1.0, 0, 32], [0, -1.0, 32]]).double())
    ground = prefilter_ground(ground, 3.0)
    view, colours = View(8, 8, 3.0), torch.ones(3, 1).double()
    weights = torch.randn(64, 2, generator=torch.Generator().manual_seed(0)).double() * 0.05

    def last(weights):
        def policy(scenario, path):
            now = path[:, :, -1]
            here = scenario.present[:, :, path.shape[2] - 1]
            everyone = OrientedBoxes(now[..., :3], scenario.sizes[0], colours, here)
            pictures = [render(view, now[:, a, :3], ground, [everyone]) for a in range(3)]
            return torch.stack([picture.flatten(1) @ weights for picture in pictures], 1)

        return rollout(scenario, policy, ALL_AGENTS)[:, :2, -1]

    given = weights.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(last(given).sum(), given)
    for row, column in ((3, 0), (20, 1), (36, 0), (50, 1)):
        step = torch.zeros_like(weights)
        step[row, column] = 1e-5
        expected = (last(weights + step).sum() - last(weights - step).sum()) / 2e-5
        assert float(gradient[row, column]) == pytest.approx(float(expected), rel=2e-3, abs=1e-4)


def test_what_cannot_be_simulated_is_refused():
    scenario = _recording()
    with pytest.raises(ValueError, match="give 1 to 20"):
        rollout(scenario, constant_velocity, ALL_AGENTS, history=21)

    def lost(scenario, path):
        return torch.full_like(path[:, :, -1, :2], torch.nan)

    with pytest.raises(ValueError, match="at step 0 the policy gives an action"):
        rollout(scenario, lost, ALL_AGENTS)


def test_padded_agents_without_sizes_have_gradients():
    scenario = _recording()
    present = scenario.present.clone()
    present[:, 2] = False
    sizes = scenario.sizes * torch.tensor([1.0, 1.0, 0.0])[:, None]
    states = scenario.states.clone().requires_grad_()
    padded = Scenario(states, present, sizes, torch.zeros_like(scenario.pedestrian), DT)
    result = rollout(padded, constant_velocity, ALL_AGENTS)
    (gradient,) = torch.autograd.grad(result.sum(), states)
    assert torch.isfinite(gradient).all()


def test_absent_agents_of_a_simulated_scene_are_nan():
    scenario = _recording()
    result = rollout(scenario, constant_velocity, ALL_AGENTS)
    empty = torch.zeros(3, 21)
    scene = Scene(
        make_ground(torch.zeros(1, 4, 4), torch.eye(3)[:2]),
        torch.arange(21).double() * DT,
        empty[..., None].expand(3, 21, 3),
        empty,
        scenario.present[0],
        scenario.sizes[0].float(),
        ("car", "car", "pedestrian"),
        ("1", "2", "3"),
        torch.zeros(0, 2, 2),
        torch.zeros(21, 0, dtype=torch.int8),
        empty[..., None].expand(3, 21, 4),
    )
    after = apply_rollout(scene, result[0].float(), 0)
    assert torch.equal(torch.isfinite(after.speeds), after.present)
    assert torch.equal(torch.isfinite(after.poses).all(dim=2), after.present)


def test_collated_scenarios_move_as_each_of_them():
    generator, scenarios = torch.Generator().manual_seed(2), []
    for count, agents in ((1, 2), (2, 4)):
        states = torch.rand(count, agents, 6, 4, generator=generator) * 5
        present = torch.rand(count, agents, 6, generator=generator) > 0.1
        sizes, walks = torch.full((count, agents, 2), 2.0), torch.zeros(count, agents).bool()
        scenarios.append(Scenario(states, present, sizes, walks, 0.1))

    def policy(scenario, path):
        return torch.full_like(path[:, :, -1, :2], 0.3)

    both = collate_scenarios(scenarios)
    paths = [
        rollout(one, policy, torch.ones_like(one.present[..., 0]), history=2)
        for one in (both, *scenarios)
    ]
    torch.testing.assert_close(paths[0][:1, :2], paths[1])
    torch.testing.assert_close(paths[0][1:], paths[2])
    assert not both.present[0, 2:].any()
    assert both.to(dtype=torch.float64).states.dtype == torch.float64
    with pytest.raises(ValueError, match="with the same steps are needed"):
        collate_scenarios([both, replace(both, dt=0.2)])
