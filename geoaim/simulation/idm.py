"""The intelligent driver (Treiber et al. 2000) on a recorded route, among others."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.simulation.conflicts import REACH_SLACK_M
from geoaim.simulation.kinematics import WHEELBASE_PER_LENGTH
from geoaim.simulation.overlap import cross
from geoaim.simulation.red_lights import find_red_lights, intersect_stop_lines
from geoaim.simulation.routes import Routes, interpolate, locate
from geoaim.simulation.simulator import Policy, Scenario
from geoaim.simulation.yielding import (
    MAX_DECELERATION_MPS2,
    Encounters,
    Plan,
    limit_acceleration,
    locate_entries,
    make_plan,
    swap,
)
from geoaim.tracks.car_following import DriverParameters, compute_gap_ratio

# calmer than in `geoaim.synthetic.traffic`, where brisk drivers empty short green phases
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
    plan = make_plan(routes, sizes, controlled)

    def act(scenario: Scenario, path: Float[Tensor, "B A t 4"]) -> Tensor:
        now = path.shape[2] - 1
        states, speed = path[:, :, -1], path[:, :, -1, 3].clamp_min(0)
        here = locate(plan.points, states[..., :2])
        room = torch.where(routes.stops, routes.lengths - here, torch.inf)
        if lines is not None and light_states is not None:
            fronts = here + scenario.sizes[..., 0] / 2
            to_line = find_red_lights(lines, fronts, speed, light_states[:, now])
            room = torch.where(scenario.pedestrian, room, torch.minimum(room, to_line - STOP_GAP_M))
        standing = compute_gap_ratio(DRIVER, speed, speed, room + DRIVER.standstill_gap)
        agents = locate_entries(plan, here, speed, scenario.present[:, :, now])
        ratio = torch.maximum(standing, _find_leaders(plan, agents).view_as(speed))
        acceleration = _accelerate(speed, desired_speeds, ratio)
        limited = limit_acceleration(plan, agents, acceleration.flatten(), scenario.dt)
        actions = torch.maximum(limited.view_as(speed), -speed / scenario.dt)
        return torch.stack([actions, _steer(plan, here, states, scenario)], dim=-1)

    return act


def _accelerate(speed: Tensor, desired_speed: Tensor, ratio: Tensor) -> Tensor:
    """Compute the accelerations of the intelligent driver model, m/s², from ratios of gaps."""
    free = 1 - (speed / desired_speed.clamp_min(MIN_DESIRED_SPEED_MPS)) ** 4
    free = torch.where(desired_speed > MIN_DESIRED_SPEED_MPS, free, -1.0)
    return (DRIVER.acceleration * (free - ratio.square())).clamp_min(-MAX_DECELERATION_MPS2)


def _find_leaders(plan: Plan, agents: Encounters) -> Float[Tensor, "n"]:
    """Find the ratio of the desired to the actual gap to the agent ahead; 0 without one."""
    ways = plan.conflicts
    closing_speed = agents.pace - ways.slope * swap(agents.pace)
    ratio = compute_gap_ratio(DRIVER, agents.pace, closing_speed, agents.room + REACH_SLACK_M)
    ratio = torch.where(agents.is_ahead & swap(agents.place >= ways.start), ratio, 0.0)
    return torch.zeros_like(agents.here).scatter_reduce(0, ways.agent, ratio, "amax")


def _steer(
    plan: Plan, here: Float[Tensor, "B A"], states: Float[Tensor, "B A 4"], scenario: Scenario
) -> Float[Tensor, "B A"]:
    """Steer (radians, for pedestrians rad/s) so that the centre moves on an arc to a route's point.

    An arc that starts at the slip angle b from the heading has curvature sin b / r, where r is the
    distance from the rear axle to the centre; its chord of length d points b + d sin b / 2 r.
    """
    speed = states[..., 3]
    lookahead = (LOOKAHEAD_S * speed.abs()).clamp_min(MIN_LOOKAHEAD_M)
    chord = interpolate(plan.points, here + lookahead) - states[..., :2]
    distance = chord.norm(dim=-1).clamp_min(MIN_CHORD_M)
    heading = torch.stack([states[..., 2].cos(), states[..., 2].sin()], dim=-1)
    turn = torch.atan2(cross(heading, chord), (heading * chord).sum(-1))
    rear = WHEELBASE_PER_LENGTH / 2 * scenario.sizes[..., 0].clamp_min(MIN_CHORD_M)
    slip = (turn / (1 + distance / (2 * rear))).clamp(-1.0, 1.0)
    steering = torch.atan(2 * torch.tan(slip)).clamp(-MAX_STEERING_RAD, MAX_STEERING_RAD)
    return torch.where(scenario.pedestrian, 2 * turn.sin() / distance * speed, steering)
