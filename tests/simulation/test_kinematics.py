import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from geoaim.simulation.kinematics import bicycle, displacement, unicycle

LENGTH = torch.tensor(4.5, dtype=torch.float64)
number = st.floats(-1, 1)


def _state(x, y, heading, speed):
    return torch.tensor([40 * x, 40 * y, 3.1 * heading, 8 * speed], dtype=torch.float64)


@given(number, number, number, number, number, number, st.sampled_from([0.1, 0.4, 1.0]))
def test_inverse_undoes_each_step(x, y, heading, speed, acceleration, turn, dt):
    """Forward, in reverse and standing."""
    state = _state(x, y, heading, speed)
    action = torch.tensor([5 * acceleration, 0.6 * turn], dtype=torch.float64)
    driven = bicycle.step(state, action, LENGTH, dt)
    again = bicycle.step(state, bicycle.inverse(state, driven, LENGTH, dt), LENGTH, dt)
    torch.testing.assert_close(again, driven, atol=1e-6, rtol=0)
    for motion in (unicycle, displacement):
        moved = motion.step(state, action, LENGTH, dt)
        result = motion.inverse(state, moved, LENGTH, dt)
        torch.testing.assert_close(result, action, atol=1e-6, rtol=0)


def test_inverse_recovers_the_action_of_a_moving_bicycle():
    state = _state(0, 0, 0.3, 0.5)
    for action in ([1.0, 0.3], [-2.0, -0.5], [0.0, 0.0]):
        expected = torch.tensor(action, dtype=torch.float64)
        after = bicycle.step(state, expected, LENGTH, 0.1)
        result = bicycle.inverse(state, after, LENGTH, 0.1)
        torch.testing.assert_close(result, expected, atol=1e-9, rtol=0)


def test_bicycle_drives_the_circle_of_its_front_wheel():
    """The rear axle's radius is the wheelbase over the tangent of the angle."""
    state, angle = torch.tensor([0.0, 0, 0, 6.0]).double(), 0.4
    radius = 0.6 * 4.5 / np.tan(angle)
    rear, action = [], torch.tensor([0.0, angle], dtype=torch.float64)
    for _ in range(60):
        heading = torch.stack([state[2].cos(), state[2].sin()])
        rear.append(state[:2] - 0.3 * LENGTH * heading)
        state = bicycle.step(state, action, LENGTH, 0.25)
    middle = torch.tensor([-0.3 * 4.5, radius], dtype=torch.float64)
    away = (torch.stack(rear) - middle).norm(dim=1)
    torch.testing.assert_close(away, torch.full_like(away, radius), atol=1e-9, rtol=0)


def test_one_long_step_equals_many_short_ones():
    state, action = _state(0, 0, 0.1, 0.4), torch.tensor([1.0, 0.0]).double()
    many = state
    for _ in range(10):
        many = bicycle.step(many, action, LENGTH, 0.1)
    torch.testing.assert_close(bicycle.step(state, action, LENGTH, 1.0), many)


def test_gradients_are_finite_at_standstill():
    state = torch.zeros(2, 4, dtype=torch.float64, requires_grad=True)
    after = torch.zeros(2, 4, dtype=torch.float64, requires_grad=True)
    action = bicycle.inverse(state, after, LENGTH, 0.1)
    shift = displacement.inverse(state, after, LENGTH, 0.1)
    moved = bicycle.step(state, action, LENGTH, 0.1)
    moved = moved + displacement.step(state, shift, LENGTH, 0.1)
    for gradient in torch.autograd.grad(moved.sum(), (state, after)):
        assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("motion", [bicycle, unicycle, displacement])
def test_steps_have_right_gradients(motion):
    state = torch.tensor([[1.0, 2, 0.3, 5], [0, 0, -2, -1]]).double().requires_grad_()
    action = torch.tensor([[1.0, 0.2], [-0.5, 0.3]]).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda s, a: motion.step(s, a, LENGTH, 0.2), (state, action))


def test_displacement_has_gradients_at_standstill():
    state = _state(0, 0, 0.3, 0)
    action = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(
        lambda action: displacement.step(state, action, LENGTH, 0.1), action
    )
    turn = torch.tensor([[np.cos(0.93), -np.sin(0.93)], [np.sin(0.93), np.cos(0.93)]])
    torch.testing.assert_close(jacobian[:2], turn.double())
    assert not jacobian[2:].any()
