"""Safe speeds: how fast an agent may go on its arc so that it can still stop.

Every agent is continued on the arc of its curvature, without routes or lanes. Behind somebody on
that arc, or on another one that leads to it in its own direction, an agent keeps the speed from
which it can stop if the one ahead brakes (Gipps 1981).
Where somebody crosses the arc at the time when it would be there, the later one stops before it.
Before a red light an agent stops if its brakes allow it.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.simulation.kinematics import WHEELBASE_PER_LENGTH, agent_from_world, wrap_angle

NEAREST = 10  # others that count
REACTION_S, BRAKING_MPS2, MAX_BRAKING_MPS2 = 0.3, 4.0, 8.0
STANDSTILL_GAP_M, SIDE_MARGIN_M = 1.5, 0.2
STOP_LINE_GAP_M = 0.5
MAX_SKEW = 0.7  # tangent of the angle by which a stop line may be turned against the way
MIN_CURVATURE = 1e-4  # 1/m; less is straight
CROSSING_TIMES_S = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
CROSSING_MARGIN_S = 0.4  # between one that leaves the place of a crossing and the next one
ALONG_COSINE = 0.7  # of the angle between those who drive along each other
MIN_SPEED_MPS = 0.3
UNKNOWN_COSINE = 0.8  # who stands across more than this may have an unknown heading


def compute_safe_speeds(  # noqa: PLR0913  (agents and others, field by field)
    pose: Float[Tensor, "E 4"],
    size: Float[Tensor, "E 2"],
    curvature: Float[Tensor, "E"],
    others: Float[Tensor, "E n 4"],
    sizes: Float[Tensor, "E n 2"],
    turns: Float[Tensor, "E n"],
    there: Bool[Tensor, "E n"],
) -> Float[Tensor, "E 2"]:
    """Compute the highest speeds from which agents can still stop for others.

    Args:
        pose: x, y, heading, speed of E agents.
        size: their lengths and widths.
        curvature: of their arcs, 1/m; positive to the left.
        others: states of n others of each.
        sizes: their lengths and widths.
        turns: curvatures of their arcs; 0 where it is not known.
        there: which of them count; not the agent itself.

    Returns:
        m/s, behind those who are ahead and before those who cross; infinite where nobody is.
    """
    away = (others[..., :2] - pose[:, None, :2]).norm(dim=2).masked_fill(~there, torch.inf)
    away, index = away.topk(min(NEAREST, others.shape[1]), dim=1, largest=False)
    row = torch.arange(len(pose), device=pose.device)[:, None]
    others, sizes, turns = others[row, index], sizes[row, index], turns[row, index]
    there = torch.isfinite(away)
    gap, pace = _find_leaders(pose, size, curvature, others, sizes, there)
    crossing = _find_crossings(pose, size, curvature, others, sizes, turns, there)
    behind = _compute_safe_speed(gap, pace).amin(dim=1)
    return torch.stack([behind, _compute_safe_speed(crossing).amin(dim=1)], dim=1)


def compute_safe_speed_before_red(
    pose: Float[Tensor, "E 4"],
    size: Float[Tensor, "E 2"],
    curvature: Float[Tensor, "E"],
    lines: Float[Tensor, "E L 2 2"],
    red: Bool[Tensor, "E L"],
) -> Float[Tensor, "E"]:
    """Compute the highest speed from which agents can still stop before red lights.

    Args:
        pose: x, y, heading, speed of E agents.
        size: their lengths and widths.
        curvature: of their arcs, 1/m; positive to the left.
        lines: both ends of each light's stop line.
        red: which lights are red.

    Returns:
        m/s; infinite where no red light is ahead, and where `MAX_BRAKING_MPS2` would not stop an
        agent in time.
    """
    ends = lines.flatten(1, 2)  # (E, 2 L, 2)
    along, aside = (part.view(*red.shape, 2) for part in _project(pose, curvature, ends))
    (along, last), (aside, last_aside) = along.unbind(2), aside.unbind(2)
    crosses = aside * last_aside < 0
    crosses &= (along - last).abs() < MAX_SKEW * (aside - last_aside).abs()
    share = aside / torch.where(crosses, aside - last_aside, 1.0)
    gap = torch.lerp(along, last, share) - size[:, :1] / 2
    speed = pose[:, 3].clamp_min(0)
    ahead = red & crosses & (gap > 0)
    ahead &= speed[:, None].square() < 2 * MAX_BRAKING_MPS2 * gap
    room = torch.where(ahead, gap + STANDSTILL_GAP_M - STOP_LINE_GAP_M, torch.inf)
    safe = _compute_safe_speed(room)
    return torch.cat([safe, torch.full_like(pose[:, :1], torch.inf)], dim=1).amin(dim=1)


def compute_curvature(
    steering: Float[Tensor, "..."], length: Float[Tensor, "..."]
) -> Float[Tensor, "..."]:
    """Curvature, 1/m, of the centre's arc by the bicycle model's steering angle."""
    slip = torch.atan(torch.tan(steering) / 2)
    return torch.sin(slip) / (WHEELBASE_PER_LENGTH / 2 * length)


def _compute_safe_speed(gap: Float[Tensor, "E n"], pace: Tensor | float = 0.0) -> Tensor:
    """The speed from which one stops behind a leader that brakes as hard (Gipps 1981)."""
    lost = BRAKING_MPS2 * REACTION_S
    room = (gap - STANDSTILL_GAP_M).clamp_min(0)
    return (lost**2 + 2 * BRAKING_MPS2 * room + pace**2).sqrt() - lost


def _project(
    pose: Float[Tensor, "E 4"], curvature: Float[Tensor, "E"], points: Float[Tensor, "E m 2"]
) -> tuple[Float[Tensor, "E m"], Float[Tensor, "E m"]]:
    """How far along each agent's arc points are, and how far to its left."""
    x, y = agent_from_world(pose[:, None], points).unbind(-1)
    bent = curvature.abs() > MIN_CURVATURE
    radius = torch.where(bent, 1 / torch.where(bent, curvature, 1.0).abs(), 1.0)[:, None]
    left = curvature.sign()[:, None]  # points are mirrored so that the arc bends to the left
    inward = radius - y * left
    along = torch.atan2(x, inward) * radius
    aside = (radius - (x.square() + inward.square()).sqrt()) * left
    return torch.where(bent[:, None], along, x), torch.where(bent[:, None], aside, y)


def _measure_extents(
    turn: Float[Tensor, "*E"], sizes: Float[Tensor, "*E 2"]
) -> tuple[Tensor, Tensor]:
    """Lengths of boxes along and across a path that they are turned against."""
    cosine, sine = turn.cos().abs(), turn.sin().abs()
    length, width = sizes.unbind(-1)
    return length * cosine + width * sine, length * sine + width * cosine


def _find_leaders(
    pose: Float[Tensor, "E 4"],
    size: Float[Tensor, "E 2"],
    curvature: Float[Tensor, "E"],
    others: Float[Tensor, "E n 4"],
    sizes: Float[Tensor, "E n 2"],
    there: Bool[Tensor, "E n"],
) -> tuple[Tensor, Tensor]:
    """Gaps to those who are ahead on an arc, infinite for others; and their speeds along it.

    The arc is that of the agent's curvature, or the one that leads from its heading to the other's
    place, if it ends near the other's heading too: round a bend that is yet to come.
    """
    along, aside = _project(pose, curvature, others[..., :2])
    turn = others[..., 2] - pose[:, None, 2] - curvature[:, None] * along
    length, width = _measure_extents(turn, sizes)
    stands = others[..., 3].abs() < MIN_SPEED_MPS
    unknown = stands & (turn.cos().abs() < UNKNOWN_COSINE)
    width = torch.where(unknown, sizes[..., 1], width)
    pace = others[..., 3] * turn.cos()
    touches = aside.abs() < (size[:, None, 1] + width) / 2 + SIDE_MARGIN_M
    ahead = there & touches & (along > 0) & (pace >= -MIN_SPEED_MPS)
    gap = torch.where(ahead, along - (size[:, None, 0] + length) / 2, torch.inf)
    room = _find_round_bends(pose, size, others, sizes)
    leads = there & (room < gap)
    pace = torch.where(leads, others[..., 3], pace)
    return torch.where(leads, room, gap), pace.clamp_min(0)


def _find_round_bends(
    pose: Float[Tensor, "E 4"],
    size: Float[Tensor, "E 2"],
    others: Float[Tensor, "E n 4"],
    sizes: Float[Tensor, "E n 2"],
) -> Float[Tensor, "E n"]:
    """Gaps to those whom an arc reaches in their own direction; infinite for others.

    An arc turns by twice the angle at which its end is seen. Nobody is on one on which they would
    be pushed aside harder than they brake, and who is no longer than wide, as pedestrians, does not
    drive ahead: without both, 1.5 % of recorded steps at a junction, a T-junction, a street, a
    roundabout and the sample are faster than was safe, with them 0.2 %.
    """
    x, y = agent_from_world(pose[:, None], others[..., :2]).unbind(-1)
    bend = wrap_angle(others[..., 2] - pose[:, None, 2])
    distance = (x.square() + y.square()).clamp_min(1e-6).sqrt()
    aside = distance * (bend / 2 - torch.atan2(y, x.clamp_min(1e-3)))
    reaches = aside.abs() < (size[:, None, 1] + sizes[..., 1]) / 2 + SIDE_MARGIN_M
    reaches &= (x > 0) & (bend.cos() > 0) & (sizes[..., 0] > sizes[..., 1])
    aside_mps2 = pose[:, None, 3].square() * 2 * (bend / 2).sin().abs() / distance
    reaches &= aside_mps2 < BRAKING_MPS2
    return torch.where(reaches, distance - (size[:, None, 0] + sizes[..., 0]) / 2, torch.inf)


def _find_crossings(  # noqa: PLR0913  (as above)
    pose: Float[Tensor, "E 4"],
    size: Float[Tensor, "E 2"],
    curvature: Float[Tensor, "E"],
    others: Float[Tensor, "E n 4"],
    sizes: Float[Tensor, "E n 2"],
    turns: Float[Tensor, "E n"],
    there: Bool[Tensor, "E n"],
) -> Float[Tensor, "E n"]:
    """Gaps to where others cross the arc first and at that time; infinite for those who do not."""
    times = others.new_tensor(CROSSING_TIMES_S)
    way = others[..., 3:] * times  # (E, n, k)
    bend = turns[..., None] * way
    heading = others[..., 2:3] + bend
    course = others[..., 2:3] + bend / 2
    chord = way * torch.sinc(bend / (2 * torch.pi))
    direction = torch.stack([course.cos(), course.sin()], dim=-1)
    points = others[..., None, :2] + chord[..., None] * direction  # (E, n, k, 2)
    along, aside = (part.view_as(way) for part in _project(pose, curvature, points.flatten(1, 2)))
    turn = heading - pose[:, None, 2:3] - curvature[:, None, None] * along
    box = sizes[:, :, None].expand(*way.shape, 2)
    length, width = _measure_extents(turn, box)
    reach, side = (size[:, 0, None, None] + length) / 2, (size[:, 1, None, None] + width) / 2
    inside = (aside.abs() < side + SIDE_MARGIN_M) & (along + reach > 0)
    speed = pose[:, 3].clamp_min(MIN_SPEED_MPS)[:, None, None]
    arrival, leaving = (along - reach) / speed, (along + reach) / speed
    meets = inside & (times > arrival - CROSSING_MARGIN_S) & (times < leaving + CROSSING_MARGIN_S)
    entry = torch.where(inside, times, torch.inf).amin(dim=2)  # when the other one gets there
    own = torch.where(inside, arrival, torch.inf).amin(dim=2)
    across = wrap_angle(others[..., 2] - pose[:, None, 2]).cos().abs() < ALONG_COSINE
    across |= turn.cos().abs().amin(dim=2) < ALONG_COSINE
    moves = others[..., 3].abs() > MIN_SPEED_MPS
    yields = there & moves & across & meets.any(dim=2) & (entry < own) & (own > 0)
    gap = torch.where(inside, along - reach, torch.inf).amin(dim=2)
    return torch.where(yields, gap, torch.inf)
