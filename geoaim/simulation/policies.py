"""Policies that need no training: as it was, straight on, on the same curve, along a path."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from geoaim.car_following import DriverParameters, compute_gap_ratio
from geoaim.lights import RED, YELLOW
from geoaim.simulation.kinematics import WHEELBASE_PER_LENGTH, invert_agents
from geoaim.simulation.overlap import cross
from geoaim.simulation.simulator import Policy, Recording

# calmer than `geoaim.synthetic.traffic`, where brisk drivers empty short green phases
DRIVER = DriverParameters(acceleration=1.5, deceleration=2.0, standstill_gap=2.0, headway=1.5)
LANE = 2.0  # m from a path within which somebody is in the way
AHEAD = 4.0  # m along the path that is steered at, at least
SHORT = 0.5  # m before its line that one stops
HARD = 4.0  # m/s² of braking that one can still do for a light
BRAKES = 8.0  # m/s² of braking at most
TOUCH = 1e-4  # share by which ways of a route overlap, lest a line slips between two
LOOK = 0.8  # s of the way ahead that is steered at


def constant_velocity(recording: Recording, path: Float[Tensor, "B t A 4"]) -> Tensor:
    """No acceleration and no turn."""
    return torch.zeros_like(path[:, -1, :, :2])


def constant_turn_rate(recording: Recording, path: Float[Tensor, "B t A 4"]) -> Tensor:
    """No acceleration, and the curve of the last step; straight on for whom there is none."""
    if path.shape[1] < 2:
        return constant_velocity(recording, path)
    number = path.shape[1] - 1
    there = recording.present[:, number - 1] & recording.present[:, number]
    before = torch.where(there[..., None], path[:, -2], path[:, -1])
    actions = invert_agents(
        before, path[:, -1], recording.sizes[..., 0], recording.on_foot, recording.seconds
    )
    return torch.stack([torch.zeros_like(actions[..., 0]), actions[..., 1]], dim=-1)


def replay(recording: Recording, path: Float[Tensor, "B t A 4"]) -> Tensor:
    """The actions that give each one the recorded speed and heading of the next step."""
    number = path.shape[1]
    lengths, feet = recording.sizes[..., 0], recording.on_foot
    return invert_agents(path[:, -1], recording.states[:, number], lengths, feet, recording.seconds)


def intelligent_driver(
    routes: Float[Tensor, "B A P 2"],
    speeds: Float[Tensor, "B A"],
    stop_lines: Float[Tensor, "L 2 2"] | None = None,
    light_states: Int[Tensor, "B T L"] | None = None,
) -> Policy:
    """Along routes at the wanted speeds, keeping distance: the intelligent driver model.

    Treiber et al. 2000; steered at a point of the route ahead (pure pursuit, Coulter 1992).
    Somebody is in the way whose middle is near the route, further along it; so is a line that
    crosses the route and whose light is not green, for vehicles whose front can still stop there.
    Nobody brakes harder than `BRAKES`.

    Args:
        routes: points along each agent's way, metres; its last way goes on beyond them.
        speeds: wanted, m/s; who wants none stays where it is.
        stop_lines: both ends of each light's line.
        light_states: at all steps of the recording, as in `geoaim.lights`.
    """

    lines = None if stop_lines is None or light_states is None else _crossings(routes, stop_lines)

    def policy(recording: Recording, path: Float[Tensor, "B t A 4"]) -> Tensor:
        number = path.shape[1] - 1
        states, present, sizes = path[:, -1], recording.present[:, number], recording.sizes
        speed, long = states[..., 3], sizes[..., 0]
        along, off = _on_routes(routes, states[..., :2])
        mine = along.diagonal(dim1=1, dim2=2)
        gap = along - mine[..., None] - (long[:, :, None] + long[:, None]) / 2
        ahead = (along > mine[..., None]) & (off < LANE) & present[:, None]
        ahead &= ~torch.eye(ahead.shape[1], dtype=torch.bool, device=ahead.device)
        gap, leader = torch.where(ahead, gap, torch.inf).min(dim=-1)
        closing = torch.where(torch.isfinite(gap), speed - speed.gather(1, leader), 0.0)
        push = _acceleration(speed, speeds, gap, closing)
        if lines is not None and light_states is not None and lines.shape[-1]:
            way = _way_to_lights(lines, mine + long / 2, speed, light_states[:, number])
            way = torch.where(recording.on_foot, torch.inf, way)
            push = torch.minimum(
                push, _acceleration(speed, speeds, way + DRIVER.standstill_gap - SHORT, speed)
            )
        push = torch.maximum(push.clamp_min(-BRAKES), -speed.clamp_min(0) / recording.seconds)
        curve = _curve(routes, mine, states, long)
        wheel = torch.atan(WHEELBASE_PER_LENGTH * long * curve).clamp(-0.6, 0.6)
        return torch.stack([push, torch.where(recording.on_foot, curve * speed, wheel)], dim=-1)

    return policy


def _crossings(
    routes: Float[Tensor, "B A P 2"], lines: Float[Tensor, "L 2 2"]
) -> Float[Tensor, "B A P-1 L"]:
    """How far along a route each of its straight ways crosses each line; infinite where not."""
    start, way = routes[:, :, :-1, None], routes.diff(dim=2)[:, :, :, None]
    long, side = way.norm(dim=-1), lines[:, 1] - lines[:, 0]
    apart, across = lines[:, 0] - start, cross(way, side)
    safe = torch.where(across == 0, torch.nan, across)
    share, aside = cross(apart, side) / safe, cross(apart, way) / safe
    crosses = (share >= -TOUCH) & (share <= _shares(routes)[:, None] + TOUCH)
    crosses &= (aside >= 0) & (aside <= 1)
    before = long.cumsum(2) - long
    return torch.where(crosses, before + share * long, torch.inf)


def _way_to_lights(
    lines: Tensor, fronts: Tensor, speed: Tensor, states: Tensor
) -> Float[Tensor, "B A"]:
    """The way of each front to the next line at which it must and can stop; infinite for none."""
    way = lines - fronts[..., None, None]
    needed = speed[..., None, None].square() / (2 * HARD)
    stops = ((states == RED) | (states == YELLOW))[:, None, None] & (way > needed)
    return torch.where(stops, way, torch.inf).amin(dim=(2, 3))


def _acceleration(speed: Tensor, wanted: Tensor, gap: Tensor, closing: Tensor) -> Tensor:
    ratio = compute_gap_ratio(DRIVER, speed, closing, gap)
    free = torch.where(wanted > 0.1, 1 - (speed / wanted.clamp_min(0.1)) ** 4, -1.0)  # or parked
    return DRIVER.acceleration * (free - ratio.square())


def _on_routes(
    routes: Float[Tensor, "B A P 2"], places: Float[Tensor, "B N 2"]
) -> tuple[Float[Tensor, "B A N"], Float[Tensor, "B A N"]]:
    """How far along each route everybody is, beyond its end too, and how far off it."""
    start, way = routes[:, :, None, :-1], routes.diff(dim=2)[:, :, None]
    long = way.norm(dim=-1).clamp_min(1e-6)
    apart = places[:, None, :, None] - start
    share = ((apart * way).sum(-1) / long.square()).clamp_min(0).minimum(_shares(routes))
    off = (apart - share[..., None] * way).norm(dim=-1)
    off, which = off.min(dim=-1)
    before = long.cumsum(-1) - long
    along = before + share * long
    return along.gather(-1, which[..., None])[..., 0], off


def _shares(routes: Float[Tensor, "B A P 2"]) -> Float[Tensor, "P-1"]:
    """How much of each straight way belongs to a route: all, and of the last one what follows."""
    shares = routes.new_ones(routes.shape[2] - 1)
    shares[-1] = torch.inf
    return shares


def _curve(routes: Tensor, along: Tensor, states: Tensor, lengths: Tensor) -> Tensor:
    """One over the radius of the arc from the rear axle through a point of the route ahead."""
    heading = torch.stack([states[..., 2].cos(), states[..., 2].sin()], dim=-1)
    rear = states[..., :2] - heading * WHEELBASE_PER_LENGTH * lengths[..., None] / 2
    look = torch.maximum(LOOK * states[..., 3].abs(), torch.full_like(along, AHEAD))
    target = _point_at(routes, along + look) - rear
    return 2 * cross(heading, target) / target.square().sum(-1).clamp_min(1.0)


def _point_at(routes: Tensor, along: Tensor) -> Tensor:
    """The point of each route at a way along it; beyond its end straight on."""
    ways = routes.diff(dim=2)
    long = ways.norm(dim=-1).clamp_min(1e-6)
    ends = long.cumsum(-1)
    which = (ends < along[..., None]).sum(-1).clamp_max(long.shape[-1] - 1)[..., None]
    rest = along[..., None] - (ends - long).gather(-1, which)
    pick = which[..., None].expand(*which.shape, 2)
    start, way = (x.gather(2, pick)[:, :, 0] for x in (routes[:, :, :-1], ways))
    return start + way * (rest / long.gather(-1, which))
