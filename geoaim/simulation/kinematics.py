"""Motion models: how an action moves an agent in one time step, and the action of a given step.

A state is x, y (metres), heading (radians) and speed (m/s, negative in reverse) of the centre of an
agent's box, as in `geoaim.Tracks`. Acceleration and curvature are constant within a step: the
centre follows a circular arc, and the step is exact for any `dt`. Actions are not limited here; the
limits of drivers are in `idm.py` and `yielding.py`.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

WHEELBASE_PER_LENGTH = 0.6  # the axles lie symmetrically about the box's centre
MIN_DISTANCE_M = 1e-6  # a shorter step determines no curvature
State = Float[Tensor, "... 4"]
Action = Float[Tensor, "... 2"]


class MotionModel(NamedTuple):
    """How agents of one kind move.

    >>> state = torch.tensor([0.0, 0.0, 0.0, 10.0])
    >>> bicycle.step(state, torch.zeros(2), torch.tensor(4.5), 0.1).tolist()
    [1.0, 0.0, 0.0, 10.0]
    """

    # maps states (..., 4), actions (..., 2), lengths of the agents (...), metres, and `dt`,
    # seconds, to the next states
    step: Callable[[State, Action, Float[Tensor, "..."], float], State]
    # maps states, next states, lengths and `dt` to the actions
    inverse: Callable[[State, State, Float[Tensor, "..."], float], Action]
    # typical magnitudes of both components of an action, by which networks normalise them
    scale: tuple[float, float]


def _step_bicycle(state: State, action: Action, length: Float[Tensor, "..."], dt: float) -> State:
    slip = torch.atan(torch.tan(action[..., 1]) / 2)
    curvature = torch.sin(slip) / (WHEELBASE_PER_LENGTH / 2 * length)
    speed, distance = _accelerate(state, action, dt)
    return _follow_arc(state, distance, state[..., 2] + slip, curvature * distance, speed)


def _invert_bicycle(
    state: State, next_state: State, length: Float[Tensor, "..."], dt: float
) -> Action:
    distance = (state[..., 3] + next_state[..., 3]) / 2 * dt
    moves = distance.abs() > MIN_DISTANCE_M
    turn = wrap_angle(next_state[..., 2] - state[..., 2])
    sine = WHEELBASE_PER_LENGTH / 2 * length * turn / torch.where(moves, distance, 1.0)
    sine = torch.where(moves, sine, 0.0).clamp(-0.999, 0.999)
    steering = torch.atan(2 * sine / torch.sqrt(1 - sine**2))
    return torch.stack([(next_state[..., 3] - state[..., 3]) / dt, steering], dim=-1)


def _step_unicycle(state: State, action: Action, length: Float[Tensor, "..."], dt: float) -> State:
    speed, distance = _accelerate(state, action, dt)
    return _follow_arc(state, distance, state[..., 2], action[..., 1] * dt, speed)


def _invert_unicycle(
    state: State, next_state: State, length: Float[Tensor, "..."], dt: float
) -> Action:
    turn = wrap_angle(next_state[..., 2] - state[..., 2])
    return torch.stack([next_state[..., 3] - state[..., 3], turn], dim=-1) / dt


def _step_displacement(
    state: State, action: Action, length: Float[Tensor, "..."], dt: float
) -> State:
    speed = torch.sqrt(action.square().sum(dim=-1) + MIN_DISTANCE_M**2) / dt
    position = world_from_agent(state, action)
    return torch.cat([position, torch.stack([state[..., 2], speed], -1)], dim=-1)


def _invert_displacement(
    state: State, next_state: State, length: Float[Tensor, "..."], dt: float
) -> Action:
    return agent_from_world(state, next_state[..., :2])


# The kinematic bicycle about the box's centre (Kong et al. 2015): acceleration, m/s², and steering
# angle of the front wheel, radians. The inverse reaches the next speed and heading, by a turn of
# less than half a revolution. A standing vehicle steers straight, an impossible turn gives 90°.
bicycle = MotionModel(_step_bicycle, _invert_bicycle, scale=(2.0, 0.2))

# Pedestrians: acceleration, m/s², and turn rate, rad/s.
unicycle = MotionModel(_step_unicycle, _invert_unicycle, scale=(1.0, 1.0))

# Positions without headings: metres forward and to the left; the heading stays as it is.
displacement = MotionModel(_step_displacement, _invert_displacement, scale=(0.5, 0.5))

# names in the configuration of a model; "slide" is for tracks of positions without headings
MOTION_MODELS = {"bicycle": bicycle, "unicycle": unicycle, "slide": displacement}


def world_from_agent(
    state: Float[Tensor, "... 4"], points: Float[Tensor, "... 2"]
) -> Float[Tensor, "... 2"]:
    """Map points in agents' frames (metres forward, left) to the world.

    Leading axes of states (x, y, heading, speed) and points are broadcast.
    """
    forward, left = points.unbind(-1)
    cosine, sine = state[..., 2].cos(), state[..., 2].sin()
    x = state[..., 0] + forward * cosine - left * sine
    y = state[..., 1] + forward * sine + left * cosine
    return torch.stack([x, y], dim=-1)


def agent_from_world(
    state: Float[Tensor, "... 4"], points: Float[Tensor, "... 2"]
) -> Float[Tensor, "... 2"]:
    """Map points in the world to agents' frames: the inverse of `world_from_agent`."""
    x, y = (points - state[..., :2]).unbind(-1)
    cosine, sine = state[..., 2].cos(), state[..., 2].sin()
    return torch.stack([x * cosine + y * sine, y * cosine - x * sine], dim=-1)


def wrap_angle(angle: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Bring angles into [-pi, pi); the gradient is 1."""
    return angle - 2 * torch.pi * torch.floor((angle.detach() + torch.pi) / (2 * torch.pi))


def _accelerate(
    state: State, action: Action, dt: float
) -> tuple[Float[Tensor, "..."], Float[Tensor, "..."]]:
    """Compute the speed after a step, and the distance covered in it."""
    speed = state[..., 3] + action[..., 0] * dt
    return speed, (state[..., 3] + speed) / 2 * dt


def _follow_arc(
    state: State,
    distance: Float[Tensor, "..."],
    course: Float[Tensor, "..."],
    turn: Float[Tensor, "..."],
    speed: Float[Tensor, "..."],
) -> State:
    """Move along an arc that starts in direction `course` and turns by `turn` radians."""
    chord = distance * torch.sinc(turn / (2 * torch.pi))
    direction = course + turn / 2  # an arc's chord points along the direction of its middle
    x = state[..., 0] + chord * direction.cos()
    y = state[..., 1] + chord * direction.sin()
    return torch.stack([x, y, wrap_angle(state[..., 2] + turn), speed], dim=-1)
