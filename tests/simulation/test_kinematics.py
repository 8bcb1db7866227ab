import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from geoaim.simulation.kinematics import (
    agents_action,
    agents_step,
    bicycle_action,
    bicycle_step,
    displacement_action,
    displacement_step,
    limit,
    limit_smoothly,
    unicycle_action,
    unicycle_step,
)

LENGTH = torch.tensor(4.5, dtype=torch.float64)
number = st.floats(-1, 1)


def _state(x, y, heading, speed):
    return torch.tensor([40 * x, 40 * y, 3.1 * heading, 8 * speed], dtype=torch.float64)


@settings(deadline=None)
@given(number, number, number, number, number, number, st.sampled_from([0.1, 0.4, 1.0]))
def test_inverse_undoes_each_step(x, y, heading, speed, push, turn, seconds):
    """Forward, in reverse and standing."""
    state = _state(x, y, heading, speed)
    action = torch.tensor([5 * push, 0.6 * turn], dtype=torch.float64)
    driven = bicycle_step(state, action, LENGTH, seconds)
    again = bicycle_step(state, bicycle_action(state, driven, LENGTH, seconds), LENGTH, seconds)
    torch.testing.assert_close(again, driven, atol=1e-6, rtol=0)
    walked = unicycle_step(state, action, seconds)
    torch.testing.assert_close(unicycle_action(state, walked, seconds), action, atol=1e-6, rtol=0)
    moved = displacement_step(state, action, seconds)
    torch.testing.assert_close(displacement_action(state, moved), action, atol=1e-6, rtol=0)


def test_action_of_a_moving_bicycle_comes_back():
    state = _state(0, 0, 0.3, 0.5)
    for action in ([1.0, 0.3], [-2.0, -0.5], [0.0, 0.0]):
        wanted = torch.tensor(action, dtype=torch.float64)
        after = bicycle_step(state, wanted, LENGTH, 0.1)
        found = bicycle_action(state, after, LENGTH, 0.1)
        torch.testing.assert_close(found, wanted, atol=1e-9, rtol=0)


def test_bicycle_drives_the_circle_of_its_front_wheel():
    """The rear axle's radius is the wheelbase over the tangent of the angle."""
    state, angle = torch.tensor([0.0, 0, 0, 6.0]).double(), 0.4
    radius = 0.6 * 4.5 / np.tan(angle)
    rear, action = [], torch.tensor([0.0, angle], dtype=torch.float64)
    for _ in range(60):
        heading = torch.stack([state[2].cos(), state[2].sin()])
        rear.append(state[:2] - 0.3 * LENGTH * heading)
        state = bicycle_step(state, action, LENGTH, 0.25)
    middle = torch.tensor([-0.3 * 4.5, radius], dtype=torch.float64)
    away = (torch.stack(rear) - middle).norm(dim=1)
    torch.testing.assert_close(away, torch.full_like(away, radius), atol=1e-9, rtol=0)


def test_one_long_step_is_many_short_ones():
    state, action = _state(0, 0, 0.1, 0.4), torch.tensor([1.0, 0.0]).double()
    many = state
    for _ in range(10):
        many = bicycle_step(many, action, LENGTH, 0.1)
    torch.testing.assert_close(bicycle_step(state, action, LENGTH, 1.0), many)


def test_gradients_are_finite_at_standstill():
    state = torch.zeros(2, 4, dtype=torch.float64, requires_grad=True)
    after = torch.zeros(2, 4, dtype=torch.float64, requires_grad=True)
    action = bicycle_action(state, after, LENGTH, 0.1)
    moved = bicycle_step(state, action, LENGTH, 0.1) + displacement_step(
        state, displacement_action(state, after), 0.1
    )
    for gradient in torch.autograd.grad(moved.sum(), (state, after)):
        assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("step", [bicycle_step, unicycle_step, displacement_step])
def test_steps_have_right_gradients(step):
    state = torch.tensor([[1.0, 2, 0.3, 5], [0, 0, -2, -1]]).double().requires_grad_()
    action = torch.tensor([[1.0, 0.2], [-0.5, 0.3]]).double().requires_grad_()
    more = (LENGTH, 0.2) if step is bicycle_step else (0.2,)
    assert torch.autograd.gradcheck(lambda s, a: step(s, a, *more), (state, action))


def test_kinds_are_chosen_by_mask():
    state = torch.stack([_state(0, 0, 0.2, 0.5)] * 2)
    action = torch.tensor([[1.0, 0.3], [1.0, 2.5]]).double()
    feet, lengths = torch.tensor([False, True]), LENGTH.expand(2)
    after = agents_step(state, action, lengths, feet, 0.1)
    torch.testing.assert_close(after[0], bicycle_step(state[0], action[0], LENGTH, 0.1))
    torch.testing.assert_close(after[1], unicycle_step(state[1], action[1], 0.1))
    torch.testing.assert_close(agents_action(state, after, lengths, feet, 0.1), action)


def test_limits_hold_hard_and_smoothly():
    most = torch.tensor([3.0, 0.5])
    far, near = torch.tensor([9.0, -2.0]), torch.tensor([0.01, -0.002])
    assert limit(far, most).tolist() == [3.0, -0.5]
    assert limit(near, most).tolist() == near.tolist()
    assert (limit_smoothly(far, most).abs() <= most).all()
    torch.testing.assert_close(limit_smoothly(near, most), near, rtol=1e-4, atol=0)


def test_limit_of_zero_holds_still_and_learns():
    action = torch.tensor([1.0, 0.2], requires_grad=True)
    held = limit_smoothly(action, torch.tensor([3.0, 0.0]))
    (gradient,) = torch.autograd.grad(held.sum(), action)
    assert held[1] == 0
    assert torch.isfinite(gradient).all()


def test_displacement_learns_from_standstill():
    state = _state(0, 0, 0.3, 0)
    action = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(
        lambda action: displacement_step(state, action, 0.1), action
    )
    turn = torch.tensor([[np.cos(0.93), -np.sin(0.93)], [np.sin(0.93), np.cos(0.93)]])
    torch.testing.assert_close(jacobian[:2], turn.double())
    assert not jacobian[2:].any()


def test_people_without_a_length_have_gradients():
    state, feet = torch.zeros(1, 4, requires_grad=True), torch.tensor([True])
    after = agents_step(state, torch.ones(1, 2), torch.zeros(1), feet, 0.1)
    (gradient,) = torch.autograd.grad(after.sum(), state)
    assert torch.isfinite(gradient).all()
