"""How agents move in a step, and the actions that move them so: bicycle, unicycle, displacement.

A state is x, y, heading and speed of the middle of an agent's box (metres, radians, m/s; negative
in reverse), as in `geoaim.Tracks`. Within a step the acceleration and the curve are constant, so
that the middle runs along an arc, of which the step is exact at any length.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

AXLES = 0.6  # of the length between a vehicle's axles, which lie evenly about its middle
STILL = 1e-6  # m: a shorter way in a step tells no curve
State = Float[Tensor, "... 4"]
Action = Float[Tensor, "... 2"]


def bicycle_step(
    state: State, action: Action, length: Float[Tensor, "..."], seconds: float
) -> State:
    """The kinematic bicycle about its middle (Kong et al. 2015).

    Args:
        state: before the step.
        action: acceleration, m/s², and the front wheel's angle, radians.
        length: of the vehicle, metres.
        seconds: of the step.

    >>> state = torch.tensor([0.0, 0.0, 0.0, 10.0])
    >>> bicycle_step(state, torch.zeros(2), torch.tensor(4.5), 0.1).tolist()
    [1.0, 0.0, 0.0, 10.0]
    """
    slip = torch.atan(torch.tan(action[..., 1]) / 2)
    turn_per_metre = torch.sin(slip) / (AXLES / 2 * length)
    speed, way = _pushed(state, action, seconds)
    return _moved(state, way, state[..., 2] + slip, turn_per_metre * way, speed)


def bicycle_action(
    state: State, after: State, length: Float[Tensor, "..."], seconds: float
) -> Action:
    """The action whose step has the speed and the heading of the state after; undoes the step.

    Where the vehicle stands, no wheel's angle can be told, and it is zero. A turn that no bicycle
    can make in that way gets the front wheel across. Turns are taken as less than half of one.
    """
    way = (state[..., 3] + after[..., 3]) / 2 * seconds
    moves = way.abs() > STILL
    turn = wrapped(after[..., 2] - state[..., 2])
    sine = AXLES / 2 * length * turn / torch.where(moves, way, 1.0)
    sine = torch.where(moves, sine, 0.0).clamp(-0.999, 0.999)
    steering = torch.atan(2 * sine / torch.sqrt(1 - sine**2))
    return torch.stack([(after[..., 3] - state[..., 3]) / seconds, steering], dim=-1)


def unicycle_step(state: State, action: Action, seconds: float) -> State:
    """Somebody on foot: action is acceleration, m/s², and turn, radians a second."""
    speed, way = _pushed(state, action, seconds)
    return _moved(state, way, state[..., 2], action[..., 1] * seconds, speed)


def unicycle_action(state: State, after: State, seconds: float) -> Action:
    """The action whose step has the speed and the heading of the state after; undoes the step."""
    turn = wrapped(after[..., 2] - state[..., 2])
    return torch.stack([after[..., 3] - state[..., 3], turn], dim=-1) / seconds


def displacement_step(state: State, action: Action, seconds: float) -> State:
    """Anything: action is metres ahead and to the left; heading and speed follow from them.

    The heading stays where the way is too short to tell.
    """
    ahead, left = action.unbind(-1)
    moves = ahead**2 + left**2 > STILL**2
    safe = torch.where(moves, ahead, 1.0), torch.where(moves, left, 0.0)
    turn = torch.where(moves, torch.atan2(safe[1], safe[0]), 0.0)
    way = torch.where(moves, torch.sqrt(safe[0] ** 2 + safe[1] ** 2), 0.0)
    heading = wrapped(state[..., 2] + turn)
    return torch.cat([ahead_of(state, action), torch.stack([heading, way / seconds], -1)], dim=-1)


def slide_step(state: State, action: Action, seconds: float) -> State:
    """As `displacement_step`, but the heading stays: for tracks of positions alone."""
    speed = torch.sqrt(action.square().sum(dim=-1) + STILL**2) / seconds
    return torch.cat([ahead_of(state, action), torch.stack([state[..., 2], speed], -1)], dim=-1)


def displacement_action(state: State, after: State) -> Action:
    """Metres ahead and to the left from state to state."""
    return seen_from(state, after[..., :2])


def ahead_of(state: State, points: Float[Tensor, "... 2"]) -> Float[Tensor, "... 2"]:
    """Places in the world of points so many metres ahead and to the left; undoes `seen_from`."""
    ahead, left = points.unbind(-1)
    cosine, sine = state[..., 2].cos(), state[..., 2].sin()
    x = state[..., 0] + ahead * cosine - left * sine
    y = state[..., 1] + ahead * sine + left * cosine
    return torch.stack([x, y], dim=-1)


def seen_from(state: State, places: Float[Tensor, "... 2"]) -> Float[Tensor, "... 2"]:
    """Metres ahead and to the left at which places of the world lie."""
    x, y = (places - state[..., :2]).unbind(-1)
    cosine, sine = state[..., 2].cos(), state[..., 2].sin()
    return torch.stack([x * cosine + y * sine, y * cosine - x * sine], dim=-1)


def agents_step(
    state: State,
    action: Action,
    length: Float[Tensor, "..."],
    on_foot: Bool[Tensor, "..."],
    seconds: float,
) -> State:
    """Vehicles by `bicycle_step`, those on foot by `unicycle_step`, in one batch."""
    wheels = torch.where(on_foot[..., None], 0.0, action)  # a turn a second is no wheel's angle
    axles = torch.where(on_foot, 1.0, length)  # who has no length has gradients all the same
    driven = bicycle_step(state, wheels, axles, seconds)
    return torch.where(on_foot[..., None], unicycle_step(state, action, seconds), driven)


def agents_action(
    state: State,
    after: State,
    length: Float[Tensor, "..."],
    on_foot: Bool[Tensor, "..."],
    seconds: float,
) -> Action:
    """The actions that `agents_step` undoes."""
    walked = unicycle_action(state, after, seconds)
    return torch.where(on_foot[..., None], walked, bicycle_action(state, after, length, seconds))


def limit(action: Action, most: Float[Tensor, "... 2"]) -> Action:
    """Held to plus and minus the most; nothing flows back where it is held."""
    return torch.maximum(torch.minimum(action, most), -most)


def limit_smoothly(action: Action, most: Float[Tensor, "... 2"]) -> Action:
    """Held below the most by a hyperbolic tangent; far beyond it the gradient fades to zero."""
    return most * torch.tanh(action / torch.where(most > 0, most, 1.0))


def _pushed(
    state: State, action: Action, seconds: float
) -> tuple[Float[Tensor, "..."], Float[Tensor, "..."]]:
    """The speed after a step's acceleration, and the way in it."""
    speed = state[..., 3] + action[..., 0] * seconds
    return speed, (state[..., 3] + speed) / 2 * seconds


def _moved(
    state: State,
    way: Float[Tensor, "..."],
    course: Float[Tensor, "..."],
    turn: Float[Tensor, "..."],
    speed: Float[Tensor, "..."],
) -> State:
    """Along an arc that sets out on a course; the chord of an arc points along its middle."""
    chord = way * torch.sinc(turn / (2 * torch.pi))
    middle = course + turn / 2
    x = state[..., 0] + chord * middle.cos()
    y = state[..., 1] + chord * middle.sin()
    return torch.stack([x, y, wrapped(state[..., 2] + turn), speed], dim=-1)


def wrapped(angle: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Within half a turn of zero; whole turns are constants to the gradient."""
    return angle - 2 * torch.pi * torch.floor((angle.detach() + torch.pi) / (2 * torch.pi))
