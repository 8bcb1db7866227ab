"""Who goes first where routes cross or merge: reservations of the ground ahead.

A driver reserves the ground up to where it can stop, and on to the end of the crossings that it
would stop in. It does not enter a crossing that another agent has reserved; of two who would enter
at once, the first in the tracks goes, unless it waits for a third one.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.simulation.conflicts import STRIDE_M, Conflicts, find_conflicts
from geoaim.simulation.routes import Routes

YIELD_DECELERATION_MPS2 = 3.0  # deceleration before conflicts
MAX_DECELERATION_MPS2 = 8.0
CLEARING_ACCELERATION_MPS2 = 1.5  # acceleration in a crossing
QUEUE_SPEED_MPS = 2.5  # a driver keeps crossings clear while the vehicle ahead is slower than this
MAX_CHAINED_CROSSINGS = 2  # crossings one after the other that are kept clear
MERGE_TIE_M = 0.001  # distances to a merge that differ by less count as equal
MIN_SPEED_MPS = 0.1  # avoids divisions by zero


@dataclass(frozen=True, eq=False)
class RightsOfWay:
    """What stays the same in a simulation: routes, and conflicts with E entries."""

    points: Float[Tensor, "B A P 2"]
    conflicts: Conflicts
    is_along: Bool[Tensor, "E"]  # whether routes have the same or opposite directions
    replays: Bool[Tensor, "E"]  # whether the other agent of a conflict replays its recording
    any_replays: bool
    first: Bool[Tensor, "E"]  # whether the other agent goes first, if both want to enter


@dataclass(frozen=True, eq=False)
class Encounters:
    """All n = B * A agents at one time, and the E entries of conflicts as they meet them."""

    here: Float[Tensor, "n"]  # metres along their routes
    speed: Float[Tensor, "n"]  # m/s, not negative
    place: Float[Tensor, "E"]  # `here` of each entry
    pace: Float[Tensor, "E"]  # `speed` of each entry
    is_open: Bool[Tensor, "E"]  # whether both agents are present and neither has passed
    room: Float[Tensor, "E"]  # metres to where both would touch, of routes along each other
    is_ahead: Bool[Tensor, "E"]  # whether the other agent is ahead, on such routes


@dataclass(frozen=True, eq=False)
class _Reserved:
    """The ground that the agent of each entry reserves ahead, metres along its route."""

    stop: Float[Tensor, "E"]  # the distance at which it can stop
    end: Float[Tensor, "E"]  # the end of the conflicts in which it would stop


def find_rights_of_way(
    routes: Routes, sizes: Float[Tensor, "B A 2"], controlled: Bool[Tensor, "B A"]
) -> RightsOfWay:
    """Find the conflicts of routes, and who goes first in them."""
    conflicts = find_conflicts(routes, sizes, controlled)
    other = swap(conflicts.agent)
    replays = ~controlled.flatten()[other]
    first = replays | (other < conflicts.agent)
    is_along = conflicts.follows | conflicts.faces
    return RightsOfWay(routes.points, conflicts, is_along, replays, bool(replays.any()), first)


def locate_entries(
    rights: RightsOfWay,
    here: Float[Tensor, "B A"],
    speed: Float[Tensor, "B A"],
    present: Bool[Tensor, "B A"],
) -> Encounters:
    """Look up the agents of all conflicts, and which conflicts are open."""
    here, speed = here.flatten(), speed.flatten()
    own = rights.conflicts.agent
    place = here.gather(0, own)
    is_open = present.flatten().gather(0, own) & (place <= rights.conflicts.end)
    is_open = is_open & swap(is_open)
    distance = rights.conflicts.offset + rights.conflicts.slope * swap(place) - place
    is_ahead = (distance > MERGE_TIE_M) | ((distance > -MERGE_TIE_M) & rights.first)
    is_ahead &= rights.is_along & is_open
    room = distance - rights.conflicts.reach
    return Encounters(here, speed, place, speed.gather(0, own), is_open, room, is_ahead)


def swap(values: Tensor) -> Tensor:
    """Swap the values (E,) of the two agents of each conflict."""
    return values.view(2, -1).flip(0).view(-1)


def limit_acceleration(
    rights: RightsOfWay, agents: Encounters, acceleration: Float[Tensor, "n"], dt: float
) -> Float[Tensor, "n"]:
    """Brake where an acceleration would lead into what others have reserved."""
    ways = rights.conflicts
    next_speed = (agents.speed + acceleration * dt).clamp_min(0)
    next_here = agents.here + (agents.speed + next_speed) * (dt / 2)
    stops = (_stop(agents.here, agents.speed, dt), _stop(next_here, next_speed, dt))
    now, wanted = _reserve(rights, agents, torch.stack(stops))
    inside = now.end >= ways.start
    early = _find_early_arrivals(rights, agents) if rights.any_replays else rights.replays
    enters = (wanted.end >= ways.start) & ~ways.follows & ~inside
    waits = (enters & (swap(inside) | early)) | _find_near(rights, agents, now, wanted)
    waits = agents.is_open & (waits | _find_queues(rights, agents, now, wanted))
    waits |= enters & swap(enters) & _find_first(rights, waits)
    halts = _find_emergencies(rights, agents, inside, early)
    brake = torch.full_like(agents.place, torch.inf)
    brake.masked_fill_(waits & agents.is_open, -YIELD_DECELERATION_MPS2)
    brake.masked_fill_(halts & agents.is_open, -MAX_DECELERATION_MPS2)
    return acceleration.scatter_reduce(0, ways.agent, brake, "amin")


def _stop(here: Float[Tensor, "n"], speed: Float[Tensor, "n"], dt: float) -> Float[Tensor, "n"]:
    """Where agents stop at the latest if they brake in steps of `dt`, metres along their routes."""
    return here + speed * (speed / (2 * YIELD_DECELERATION_MPS2) + dt / 2)


def _reserve(
    rights: RightsOfWay, agents: Encounters, stop: Float[Tensor, "2 n"]
) -> tuple[_Reserved, _Reserved]:
    """Reserve the ground up to each of two stops, and on to the end of the crossings there."""
    own, start = rights.conflicts.agent.expand(2, -1), rights.conflicts.start
    last = torch.where(agents.is_open & ~rights.conflicts.follows, rights.conflicts.end, -torch.inf)
    end = stop
    for _ in range(MAX_CHAINED_CROSSINGS):
        reached = torch.where(end.gather(1, own) >= start, last, -torch.inf)
        end = end.scatter_reduce(1, own, reached, "amax")
    stop, end = stop.gather(1, own), end.gather(1, own)
    return _Reserved(stop[0], end[0]), _Reserved(stop[1], end[1])


def _find_early_arrivals(rights: RightsOfWay, agents: Encounters) -> Bool[Tensor, "E"]:
    """Mark conflicts that a replayed agent reaches before this agent has left them."""
    ways = rights.conflicts
    rest = (ways.end - agents.place).clamp_min(0)
    final = (agents.pace.square() + 2 * CLEARING_ACCELERATION_MPS2 * rest + MIN_SPEED_MPS**2).sqrt()
    duration = 2 * rest / (agents.pace + final)  # when it accelerates as fast as it can
    return rights.replays & (swap(agents.place) + swap(agents.pace) * duration >= swap(ways.start))


def _find_first(rights: RightsOfWay, waits: Bool[Tensor, "E"]) -> Bool[Tensor, "E"]:
    """Mark entries whose other agent goes first; one that waits anyway lets others go."""
    own = rights.conflicts.agent
    stands = torch.zeros(rights.points.shape[:2].numel(), dtype=torch.bool, device=own.device)
    stands = stands.index_fill(0, own[waits], True)
    return rights.first & (rights.replays | ~swap(stands[own]))


def _find_near(
    rights: RightsOfWay, agents: Encounters, now: _Reserved, wanted: _Reserved
) -> Bool[Tensor, "E"]:
    """Mark conflicts in which an agent could not stop behind a leader or before an oncoming one."""
    ways = rights.conflicts
    # change of the room once the other one has stopped
    change = ways.slope * swap(now.stop - agents.place)
    limit = agents.place + agents.room + change
    inside, enters = now.stop >= ways.start, wanted.stop >= ways.start
    near = agents.is_ahead & enters & swap(enters) & (wanted.stop > limit)
    late = ways.follows & agents.is_ahead & inside & (now.stop > limit)
    lets_pass = late & ~swap(inside)  # the agent ahead has not merged, and waits for the late one
    return (near & ~lets_pass) | (enters & ~inside & swap(late))


def _find_queues(
    rights: RightsOfWay, agents: Encounters, now: _Reserved, wanted: _Reserved
) -> Bool[Tensor, "E"]:
    """Mark slow leaders behind whom there is no room beyond crossings that an agent enters."""
    ways = rights.conflicts
    slow = swap((agents.pace < QUEUE_SPEED_MPS) & (agents.place >= ways.start))
    enters = (wanted.end > wanted.stop) & (wanted.end > now.end)
    is_full = wanted.end > agents.place + agents.room
    return ways.follows & agents.is_ahead & slow & enters & is_full


def _find_emergencies(
    rights: RightsOfWay, agents: Encounters, inside: Bool[Tensor, "E"], early: Bool[Tensor, "E"]
) -> Bool[Tensor, "E"]:
    """Mark crossings that both have reserved, before which an agent can still stop."""
    ways = rights.conflicts
    both = inside & (swap(inside) | early) & ~ways.follows
    stop = agents.place + agents.pace.square() / (2 * MAX_DECELERATION_MPS2)
    is_before, is_in = stop < ways.start + STRIDE_M / 2, agents.place >= ways.start
    goes_on = rights.replays | swap(~is_before)
    is_second = torch.where(is_in == swap(is_in), rights.first, swap(is_in))
    return both & is_before & (goes_on | is_second)
