"""The intelligent driver (Treiber et al. 2000) on a recorded route, among others, before lights."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.simulation.conflicts import REACH_SLACK_M
from geoaim.simulation.kinematics import WHEELBASE_PER_LENGTH
from geoaim.simulation.overlap import cross
from geoaim.simulation.routes import Routes, interpolate, locate
from geoaim.simulation.simulator import Policy, Scenario
from geoaim.simulation.yielding import (
    MAX_DECELERATION_MPS2,
    Encounters,
    RightsOfWay,
    find_rights_of_way,
    limit_acceleration,
    locate_entries,
    swap,
)
from geoaim.tracks.car_following import DriverParameters, compute_gap_ratio
from geoaim.tracks.lights import RED, YELLOW

# calmer than in the made places, where brisk drivers empty short green phases
DRIVER = DriverParameters(acceleration=1.5, deceleration=2.0, standstill_gap=2.0, headway=1.5)
STOP_GAP_M = 0.5  # vehicles stop this far before a stop line
MIN_LOOKAHEAD_M, LOOKAHEAD_S = 1.5, 0.3  # distance to the point on its route that it steers to
MAX_STEERING_RAD = 0.6
MIN_CHORD_M = 0.1
MIN_DESIRED_SPEED_MPS = 0.1  # a slower vehicle is parked


def make_idm_policy(
    routes: Routes,
    desired_speeds: Float[Tensor, "B A"],
    sizes: Float[Tensor, "B A 2"],
    controlled: Bool[Tensor, "B A"],
    stop_lines: Float[Tensor, "L 2 2"] | None = None,
    light_states: Int[Tensor, "B T L"] | None = None,
) -> Policy:
    """Make a policy that follows routes by the intelligent driver model.

    A red or yellow light is a standing leader for vehicles that can still stop at its line.

    Args:
        routes: the routes of all agents.
        desired_speeds: (B, A) m/s; with 0.1 or less an agent brakes to a standstill and stays.
        sizes: (B, A, 2) length and width, metres.
        controlled: (B, A) agents that follow this policy, and yield to those that do not.
        stop_lines: (L, 2, 2) both ends of each light's line, metres; given with `light_states` or
            not at all.
        light_states: (B, T, L) states at all steps of the scenario, as in `geoaim.tracks.lights`.

    Returns:
        The policy.

    Raises:
        ValueError: only one of `stop_lines` and `light_states` is given.
    """
    if (stop_lines is None) != (light_states is None):
        raise ValueError("stop_lines and light_states go together; one of them is None")
    lines = None
    if stop_lines is not None and len(stop_lines):
        lines = intersect_stop_lines(routes.points, stop_lines)
    rights = find_rights_of_way(routes, sizes, controlled)

    def act(scenario: Scenario, path: Float[Tensor, "B A t 4"]) -> Tensor:
        now = path.shape[2] - 1
        states, speed = path[:, :, -1], path[:, :, -1, 3].clamp_min(0)
        here = locate(rights.points, states[..., :2])
        room = torch.where(routes.stops, routes.lengths - here, torch.inf)
        if lines is not None and light_states is not None:
            fronts = here + scenario.sizes[..., 0] / 2
            to_line = find_red_lights(lines, fronts, speed, light_states[:, now])
            room = torch.where(scenario.pedestrian, room, torch.minimum(room, to_line - STOP_GAP_M))
        standing = compute_gap_ratio(DRIVER, speed, speed, room + DRIVER.standstill_gap)
        agents = locate_entries(rights, here, speed, scenario.present[:, :, now])
        ratio = torch.maximum(standing, _find_leaders(rights, agents).view_as(speed))
        acceleration = _accelerate(speed, desired_speeds, ratio)
        limited = limit_acceleration(rights, agents, acceleration.flatten(), scenario.dt)
        actions = torch.maximum(limited.view_as(speed), -speed / scenario.dt)
        return torch.stack([actions, _steer(rights, here, states, scenario)], dim=-1)

    return act


def _accelerate(speed: Tensor, desired_speed: Tensor, ratio: Tensor) -> Tensor:
    """Compute the accelerations of the intelligent driver model, m/s², from ratios of gaps."""
    free = 1 - (speed / desired_speed.clamp_min(MIN_DESIRED_SPEED_MPS)) ** 4
    free = torch.where(desired_speed > MIN_DESIRED_SPEED_MPS, free, -1.0)
    return (DRIVER.acceleration * (free - ratio.square())).clamp_min(-MAX_DECELERATION_MPS2)


def _find_leaders(rights: RightsOfWay, agents: Encounters) -> Float[Tensor, "n"]:
    """Find the ratio of the desired to the actual gap to the agent ahead; 0 without one."""
    ways = rights.conflicts
    closing_speed = agents.pace - ways.slope * swap(agents.pace)
    ratio = compute_gap_ratio(DRIVER, agents.pace, closing_speed, agents.room + REACH_SLACK_M)
    ratio = torch.where(agents.is_ahead & swap(agents.place >= ways.start), ratio, 0.0)
    return torch.zeros_like(agents.here).scatter_reduce(0, ways.agent, ratio, "amax")


def _steer(
    rights: RightsOfWay,
    here: Float[Tensor, "B A"],
    states: Float[Tensor, "B A 4"],
    scenario: Scenario,
) -> Float[Tensor, "B A"]:
    """Steer (radians, for pedestrians rad/s) so that the centre moves on an arc to a route's point.

    An arc that starts at the slip angle b from the heading has curvature sin b / r, where r is the
    distance from the rear axle to the centre; its chord of length d points b + d sin b / 2 r.
    """
    speed = states[..., 3]
    lookahead = (LOOKAHEAD_S * speed.abs()).clamp_min(MIN_LOOKAHEAD_M)
    chord = interpolate(rights.points, here + lookahead) - states[..., :2]
    distance = chord.norm(dim=-1).clamp_min(MIN_CHORD_M)
    heading = torch.stack([states[..., 2].cos(), states[..., 2].sin()], dim=-1)
    turn = torch.atan2(cross(heading, chord), (heading * chord).sum(-1))
    rear = WHEELBASE_PER_LENGTH / 2 * scenario.sizes[..., 0].clamp_min(MIN_CHORD_M)
    slip = (turn / (1 + distance / (2 * rear))).clamp(-1.0, 1.0)
    steering = torch.atan(2 * torch.tan(slip)).clamp(-MAX_STEERING_RAD, MAX_STEERING_RAD)
    return torch.where(scenario.pedestrian, 2 * turn.sin() / distance * speed, steering)


MAX_STOP_DECELERATION_MPS2 = 4.0  # vehicles that would have to brake harder pass the light
CROSSING_OVERLAP = 1e-4  # share by which segments are extended: no line falls between two
MAX_CROSSINGS = 3  # crossings of a route with a stop line at most; two segments may share one


def intersect_stop_lines(
    routes: Float[Tensor, "B A P 2"], lines: Float[Tensor, "L 2 2"]
) -> Float[Tensor, "B A C L"]:
    """Find where routes cross stop lines: metres along the route at up to C first crossings."""
    start, segment = routes[:, :, :-1, None], routes.diff(dim=2)[:, :, :, None]
    length, line = segment.norm(dim=-1), lines[:, 1] - lines[:, 0]
    offset, denominator = lines[:, 0] - start, cross(segment, line)
    safe = torch.where(denominator == 0, torch.nan, denominator)
    share, line_share = cross(offset, line) / safe, cross(offset, segment) / safe
    limits = routes.new_ones(routes.shape[2] - 1)
    limits[-1] = torch.inf
    crosses = share >= -CROSSING_OVERLAP
    crosses &= share <= limits[:, None] + CROSSING_OVERLAP
    crosses &= (line_share >= 0) & (line_share <= 1)
    along = torch.where(crosses, length.cumsum(2) - length + share * length, torch.inf)
    return along.sort(dim=2).values[:, :, :MAX_CROSSINGS]


def find_red_lights(
    lines: Tensor, fronts: Tensor, speed: Tensor, states: Tensor
) -> Float[Tensor, "B A"]:
    """Find the metres to the next line at which a vehicle must and can stop; infinite if none."""
    distance = lines - fronts[..., None, None]
    braking_distance = speed[..., None, None].square() / (2 * MAX_STOP_DECELERATION_MPS2)
    stops = ((states == RED) | (states == YELLOW))[:, None, None] & (distance > braking_distance)
    return torch.where(stops, distance, torch.inf).amin(dim=(2, 3))
