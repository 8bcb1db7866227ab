"""Policies without training: constant velocity, constant turn rate, replay, intelligent driver.

The constants below limit the intelligent driver's steering and braking.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from geoaim.car_following import DriverParameters, compute_gap_ratio
from geoaim.lights import RED, YELLOW
from geoaim.simulation.kinematics import WHEELBASE_PER_LENGTH
from geoaim.simulation.overlap import cross
from geoaim.simulation.simulator import Policy, Scenario, invert_step

# calmer than in `geoaim.synthetic.traffic`, where brisk drivers empty short green phases
DRIVER = DriverParameters(acceleration=1.5, deceleration=2.0, standstill_gap=2.0, headway=1.5)
MAX_LEADER_OFFSET_M = 2.0  # from the route, within which another agent is in the way
STOP_GAP_M = 0.5  # before a stop line
MAX_STOP_DECELERATION_MPS2 = 4.0  # vehicles that would have to brake harder pass the light
MAX_DECELERATION_MPS2 = 8.0
CROSSING_OVERLAP = 1e-4  # share of a segment; no stop line falls between two of them
MIN_LOOKAHEAD_M, LOOKAHEAD_S = 4.0, 0.8  # to the point of the route that is steered at
MAX_STEERING_RAD = 0.6
MIN_SEGMENT_M = 1e-6
MIN_DESIRED_SPEED_MPS = 0.1  # a slower vehicle is parked


def constant_velocity(scenario: Scenario, path: Float[Tensor, "B t A 4"]) -> Tensor:
    """Give actions (B, A, 2) that neither accelerate nor turn: a `Policy`."""
    return torch.zeros_like(path[:, -1, :, :2])


def constant_turn_rate(scenario: Scenario, path: Float[Tensor, "B t A 4"]) -> Tensor:
    """Give actions (B, A, 2) that keep speed and the last step's turn, if any: a `Policy`."""
    if path.shape[1] < 2:
        return constant_velocity(scenario, path)
    now = path.shape[1] - 1
    present = scenario.present[:, now - 1] & scenario.present[:, now]
    last = torch.where(present[..., None], path[:, -2], path[:, -1])
    actions = invert_step(scenario, last, path[:, -1])
    return torch.stack([torch.zeros_like(actions[..., 0]), actions[..., 1]], dim=-1)


def replay(scenario: Scenario, path: Float[Tensor, "B t A 4"]) -> Tensor:
    """Give actions (B, A, 2) that reach the recorded speed and heading: a `Policy`."""
    return invert_step(scenario, path[:, -1], scenario.states[:, path.shape[1]])


def make_idm_policy(
    routes: Float[Tensor, "B A P 2"],
    desired_speeds: Float[Tensor, "B A"],
    stop_lines: Float[Tensor, "L 2 2"] | None = None,
    light_states: Int[Tensor, "B T L"] | None = None,
) -> Policy:
    """Make a policy that follows routes by the intelligent driver model and pure pursuit.

    The leader is the nearest agent ahead whose centre is near the route. A red or yellow light
    counts as a standing leader for vehicles that can still stop at its line. Sources: Treiber et
    al. 2000 (acceleration), Coulter 1992 (steering).

    Args:
        routes: (B, A, P, 2) points, metres; the last segment extends beyond them.
        desired_speeds: (B, A) m/s; with 0.1 or less an agent brakes to a standstill and stays.
        stop_lines: (L, 2, 2) both ends of each light's line, metres; given with `light_states` or
            not at all.
        light_states: (B, T, L) at all steps of the scenario, as in `geoaim.lights`.

    Returns:
        The policy.

    Raises:
        ValueError: only one of `stop_lines` and `light_states` is given.
    """
    if (stop_lines is None) != (light_states is None):
        raise ValueError("stop_lines and light_states go together; one of them is None")
    lines = None
    if stop_lines is not None and len(stop_lines):
        lines = _intersect_stop_lines(routes, stop_lines)  # (B, A, P-1, L)

    def act(scenario: Scenario, path: Float[Tensor, "B t A 4"]) -> Tensor:
        now = path.shape[1] - 1
        states, length = path[:, -1], scenario.sizes[..., 0]
        speed = states[..., 3]
        along, off = _project(routes, states[..., :2])  # (B, A, A): of column agents on row routes
        own = along.diagonal(dim1=1, dim2=2)
        gap, closing = _find_leaders(along, off, states, length, scenario.present[:, now])
        acceleration = _accelerate(speed, desired_speeds, gap, closing)
        if lines is not None and light_states is not None:
            room = _find_red_lights(lines, own + length / 2, speed, light_states[:, now])
            room = torch.where(scenario.pedestrian, torch.inf, room)
            room = room + DRIVER.standstill_gap - STOP_GAP_M
            stop = _accelerate(speed, desired_speeds, room, speed)
            acceleration = torch.minimum(acceleration, stop)
        to_standstill = -speed.clamp_min(0) / scenario.dt
        braked = acceleration.clamp_min(-MAX_DECELERATION_MPS2)
        curvature = _pursue(routes, own, states, length)
        steering = torch.atan(WHEELBASE_PER_LENGTH * length * curvature)
        steering = steering.clamp(-MAX_STEERING_RAD, MAX_STEERING_RAD)
        turn = torch.where(scenario.pedestrian, curvature * speed, steering)
        return torch.stack([torch.maximum(braked, to_standstill), turn], dim=-1)

    return act


def _find_leaders(
    along: Float[Tensor, "B A A"],
    off: Float[Tensor, "B A A"],
    states: Float[Tensor, "B A 4"],
    length: Float[Tensor, "B A"],
    present: Tensor,
) -> tuple[Float[Tensor, "B A"], Float[Tensor, "B A"]]:
    """Find the gaps to the leaders, infinite without one, and the speeds at which they close."""
    own, speed = along.diagonal(dim1=1, dim2=2), states[..., 3]
    gap = along - own[..., None] - (length[:, :, None] + length[:, None]) / 2
    ahead = (along > own[..., None]) & (off < MAX_LEADER_OFFSET_M) & present[:, None]
    ahead &= ~torch.eye(ahead.shape[1], dtype=torch.bool, device=ahead.device)
    gap, leader = torch.where(ahead, gap, torch.inf).min(dim=-1)
    return gap, torch.where(torch.isfinite(gap), speed - speed.gather(1, leader), 0.0)


def _accelerate(speed: Tensor, desired_speed: Tensor, gap: Tensor, closing_speed: Tensor) -> Tensor:
    """Compute the accelerations (B, A) of the intelligent driver model, m/s²."""
    ratio = compute_gap_ratio(DRIVER, speed, closing_speed, gap)
    free = 1 - (speed / desired_speed.clamp_min(MIN_DESIRED_SPEED_MPS)) ** 4
    free = torch.where(desired_speed > MIN_DESIRED_SPEED_MPS, free, -1.0)
    return DRIVER.acceleration * (free - ratio.square())


def _intersect_stop_lines(
    routes: Float[Tensor, "B A P 2"], lines: Float[Tensor, "L 2 2"]
) -> Float[Tensor, "B A P-1 L"]:
    """Find how far along a route each of its segments crosses each line; infinite where not."""
    start, segment = routes[:, :, :-1, None], routes.diff(dim=2)[:, :, :, None]
    length, line = segment.norm(dim=-1), lines[:, 1] - lines[:, 0]
    offset, denominator = lines[:, 0] - start, cross(segment, line)
    safe = torch.where(denominator == 0, torch.nan, denominator)
    share, line_share = cross(offset, line) / safe, cross(offset, segment) / safe
    crosses = share >= -CROSSING_OVERLAP
    crosses &= share <= _limit_shares(routes)[:, None] + CROSSING_OVERLAP
    crosses &= (line_share >= 0) & (line_share <= 1)
    return torch.where(crosses, length.cumsum(2) - length + share * length, torch.inf)


def _find_red_lights(
    lines: Tensor, fronts: Tensor, speed: Tensor, states: Tensor
) -> Float[Tensor, "B A"]:
    """Find the distance to the next line at which a vehicle must and can stop; infinite if none."""
    distance = lines - fronts[..., None, None]
    braking_distance = speed[..., None, None].square() / (2 * MAX_STOP_DECELERATION_MPS2)
    stops = ((states == RED) | (states == YELLOW))[:, None, None] & (distance > braking_distance)
    return torch.where(stops, distance, torch.inf).amin(dim=(2, 3))


def _project(
    routes: Float[Tensor, "B A P 2"], points: Float[Tensor, "B N 2"]
) -> tuple[Float[Tensor, "B A N"], Float[Tensor, "B A N"]]:
    """Project points on routes: how far along each one they lie, and how far off it, metres."""
    start, segment = routes[:, :, None, :-1], routes.diff(dim=2)[:, :, None]
    length = segment.norm(dim=-1).clamp_min(MIN_SEGMENT_M)
    offset = points[:, None, :, None] - start  # (B, A, N, P-1, 2)
    share = ((offset * segment).sum(-1) / length.square()).clamp_min(0)
    share = share.minimum(_limit_shares(routes))
    off, nearest = (offset - share[..., None] * segment).norm(dim=-1).min(dim=-1)
    along = length.cumsum(-1) - length + share * length
    return along.gather(-1, nearest[..., None])[..., 0], off


def _limit_shares(routes: Float[Tensor, "B A P 2"]) -> Float[Tensor, "P-1"]:
    """Limit how much of each segment's line belongs to the route: 1; of the last one, no limit."""
    limits = routes.new_ones(routes.shape[2] - 1)
    limits[-1] = torch.inf
    return limits


def _pursue(routes: Tensor, along: Tensor, states: Tensor, lengths: Tensor) -> Tensor:
    """Compute the curvature (B, A) of the arc from the rear axle through a point of the route."""
    heading = torch.stack([states[..., 2].cos(), states[..., 2].sin()], dim=-1)
    rear_axle = states[..., :2] - heading * WHEELBASE_PER_LENGTH * lengths[..., None] / 2
    lookahead = (LOOKAHEAD_S * states[..., 3].abs()).clamp_min(MIN_LOOKAHEAD_M)
    target = _interpolate(routes, along + lookahead) - rear_axle
    return 2 * cross(heading, target) / target.square().sum(-1).clamp_min(1.0)


def _interpolate(routes: Float[Tensor, "B A P 2"], along: Float[Tensor, "B A"]) -> Tensor:
    """Find the points (B, A, 2) at `along` metres of the routes; straight on beyond their ends."""
    segments = routes.diff(dim=2)
    length = segments.norm(dim=-1).clamp_min(MIN_SEGMENT_M)
    ends = length.cumsum(-1)
    index = (ends < along[..., None]).sum(-1).clamp_max(length.shape[-1] - 1)[..., None]
    rest = along[..., None] - (ends - length).gather(-1, index)
    pick = index[..., None].expand(*index.shape, 2)
    start, segment = (x.gather(2, pick)[:, :, 0] for x in (routes[:, :, :-1], segments))
    return start + segment * (rest / length.gather(-1, index))
