"""The people of a moment, on foot and on cycles, and one step of all of them.

They walk by social forces (Helbing and Molnár 1995): towards a point of their path a little ahead,
away from each other and from the edges of the pavement. At a crossing they wait for their light,
or for a gap.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from numpy import ndarray as Array

from geoaim.lights import GREEN
from geoaim.synthetic.exact import round_reproducibly
from geoaim.synthetic.roads.curves import POINT_SPACING_M
from geoaim.synthetic.traffic.fleet import OnFoot, Rules, Vehicles

RELAX = 0.5  # s in which one takes one's own speed again
PUSH, RANGE = 2.2, 0.28  # m/s2 and m of the force between two people
BEHIND = 0.3  # share of that force for whoever comes from behind
WALL, EDGE = 1.6, 0.22  # m/s2 and m of the force from the edge of the pavement
HELD = 4.0  # m/s2, the most that the edge pushes
AHEAD = 1.6  # m on the path that is walked towards
SOON = 0.7  # m before the kerb where one stops
WARY = 1.6  # s more than one needs, where nothing is marked
BODY = 1.8  # m to either side of a vehicle's middle that one does not walk into
SWAY, STRIDE = 0.45, 1.6  # m/s2 for each m/s of pace up to STRIDE: what is left to chance
ASIDE = 1.0  # m from a vehicle's end at which one walks round it
FURTHEST = 6.0  # m that one goes out of one's way for that
INSIDE = 0.15  # m from the edge that nobody is pushed beyond


@dataclass(frozen=True)
class Crowd:
    """People of a moment (n of them).

    Attributes:
        number: who it is.
        place: plan metres.
        speed: m/s in x and y.
        path: (n, K, 2) points each `POINT_SPACING_M`; the last one repeated to the end.
        over: (n, K) crossing at each point of the path; -1: none.
        last: number of the path's last point.
        done: metres of the path that are behind.
        aside: metres to the left of the path where one likes to walk.
        pace: m/s that one likes to walk.
        radius: metres of one's body.
    """

    number: Int[Array, "n"]
    place: Float[Array, "n 2"]
    speed: Float[Array, "n 2"]
    path: Float[Array, "n K 2"]
    over: Int[Array, "n K"]
    last: Int[Array, "n"]
    done: Float[Array, "n"]
    aside: Float[Array, "n"]
    pace: Float[Array, "n"]
    radius: Float[Array, "n"]


@dataclass(frozen=True)
class Ground:
    """Where people may stand, as a raster over the plan (rows run up).

    Attributes:
        table: (H, W, 3) metres to the nearest edge of the pavement, 0 outside of it, and the
            direction away from that edge.
        corner: plan coordinates of the raster's first corner.
        cell: metres of a cell.
    """

    table: Float[Array, "H W 3"]
    corner: Float[Array, "2"]
    cell: float


@dataclass(frozen=True)
class Crossings:
    """Crossings as the crowd sees them (C of them).

    Attributes:
        first: (C, 2) their first ends.
        ahead: (C, 2) direction to the other end.
        light: number of the light for those on foot; -1: none.
        marked: whether vehicles stop there for those who want to cross.
        free: whether nobody waits there: a pavement that a drive crosses.
    """

    first: Float[Array, "C 2"]
    ahead: Float[Array, "C 2"]
    light: Int[Array, "C"]
    marked: Bool[Array, "C"]
    free: Bool[Array, "C"]


@dataclass(frozen=True)
class Outlook:
    """What people of a moment have before them (n of them; m are on a crossing or close to one).

    Attributes:
        on: (n,) whether one is on a crossing.
        target: (n, 2) the point of the path to walk towards.
        along: (n, 2) the path's direction there.
        who: (m,) those on a crossing or close to one.
        which: (m,) the crossing.
        beside: (m,) metres from its first end.
        sign: (m,) 1 for those who walk away from the first end, else -1.
    """

    on: Bool[Array, "n"]
    target: Float[Array, "n 2"]
    along: Float[Array, "n 2"]
    who: Int[Array, "m"]
    which: Int[Array, "m"]
    beside: Float[Array, "m"]
    sign: Float[Array, "m"]


def look_ahead(crowd: Crowd, crossings: Crossings) -> Outlook:
    """Where each path leads next, and over which crossing."""
    rows = np.arange(len(crowd.last))
    here = np.minimum((crowd.done / POINT_SPACING_M).astype(np.int64), crowd.last)
    look = (np.maximum(AHEAD, 0.5 * crowd.pace) / POINT_SPACING_M).astype(np.int64)
    ahead = np.minimum(here + look, crowd.last)
    target = crowd.path[rows, ahead]
    along = target - crowd.path[rows, np.maximum(ahead - 2, 0)]
    along = along / np.maximum(np.sqrt(_dot(along, along)), 1e-6)[:, None]
    soon = np.minimum(
        here + ((SOON + RELAX * crowd.pace) / POINT_SPACING_M).astype(np.int64), crowd.last
    )
    now, after = crowd.over[rows, here], crowd.over[rows, soon]
    on = now >= 0
    which = np.where(on, now, after)
    who = np.flatnonzero(which >= 0)
    which = which[who]
    beside = _dot(crowd.place[who] - crossings.first[which], crossings.ahead[which])
    sign = np.where(_dot(along[who], crossings.ahead[which]) < 0, -1.0, 1.0)
    return Outlook(on, target, along, who, which, beside, sign)


def stepping(crowd: Crowd, outlook: Outlook, crossings: Crossings) -> OnFoot:
    """Who is on a crossing, or walks towards one, as the vehicles see it."""
    speed = crowd.speed[outlook.who]
    seen = outlook.on[outlook.who] | (_dot(speed, speed) > 0.09)
    which, sign = outlook.which[seen], outlook.sign[seen]
    pace = np.abs(_dot(speed[seen], crossings.ahead[which]))
    reach = np.where(crowd.radius[outlook.who[seen]] > 0.3, 0.9, 0.3)
    return OnFoot(which, outlook.beside[seen], sign * np.maximum(pace, 0.8), reach)


def walk(
    crowd: Crowd,
    outlook: Outlook,
    ground: Ground,
    minded: tuple[Bool[Array, "n"], Float[Array, "n"]],
    sway: Float[Array, "n 2"],
    interval: float,
) -> Crowd:
    """All people an interval (seconds) later; `minded` is from `mind_traffic`.

    `sway` is noise of variance 1: nobody walks evenly.
    """
    if len(crowd.number) == 0:
        return crowd
    held, detour = minded
    along = outlook.along
    left = np.column_stack([-along[:, 1], along[:, 0]])
    going_round = detour != 0
    aside = np.where(going_round, detour, crowd.aside)
    late = _dot(outlook.target - crowd.place, along)  # who is held in front of a vehicle sidesteps
    target = outlook.target - np.where(held & going_round, late, 0.0)[:, None] * along
    wish = target + aside[:, None] * left - crowd.place
    fast = np.where(held & ~going_round, 0.0, crowd.pace) / np.maximum(
        np.sqrt(_dot(wish, wish)), 1e-6
    )
    force = (fast[:, None] * wish - crowd.speed) / RELAX + _apart(crowd)
    force += (SWAY * ~held * np.minimum(crowd.pace, STRIDE))[:, None] * sway
    free = outlook.on
    edge = _look_up(crowd.place, ground)
    push = np.minimum(WALL * np.exp((crowd.radius - edge[:, 0]) / EDGE), HELD)
    force += np.where(free, 0.0, push)[:, None] * edge[:, 1:]
    speed = crowd.speed + force * interval
    fast = np.maximum(np.sqrt(_dot(speed, speed)), 1e-6)
    speed = round_reproducibly(speed * np.minimum(1.0, 1.3 * crowd.pace / fast)[:, None])
    place = crowd.place + speed * interval
    edge = _look_up(place, ground)  # nobody is pushed off the pavement
    out = np.where(free, 0.0, np.maximum(INSIDE - edge[:, 0], 0))
    place = round_reproducibly(place + out[:, None] * edge[:, 1:])
    done = round_reproducibly(crowd.done + np.maximum(_dot(place - crowd.place, along), 0))
    return replace(crowd, place=place, speed=speed, done=done)


def mind_traffic(
    crowd: Crowd,
    outlook: Outlook,
    crossings: Crossings,
    vehicles: Vehicles,
    rules: Rules,
    lights: Int8[Array, "G"],
) -> tuple[Bool[Array, "n"], Float[Array, "n"]]:
    """Who stands, and metres to the left of the path by which one walks round a vehicle.

    One stands at the kerb until it is time to go, and on a crossing while a vehicle passes.
    """
    held, detour = np.zeros(len(crowd.number), bool), np.zeros(len(crowd.number))
    if len(outlook.who) == 0 or len(vehicles[0].at) == 0:
        return held, detour
    which = outlook.which
    light = crossings.light[which]
    green = (np.append(lights, np.int8(GREEN))[light] == GREEN) | crossings.free[which]
    left = np.column_stack([-crossings.ahead[which, 1], crossings.ahead[which, 0]])
    across = _dot(crowd.place[outlook.who] - crossings.first[which], left)
    safe, clear, around = _traffic(
        crowd.pace[outlook.who], across, outlook, crossings, vehicles, rules
    )
    on = outlook.on[outlook.who]
    held[outlook.who] = np.where(on, ~clear, ~(green & safe))
    detour[outlook.who] = np.where(on, around, 0.0)
    return held, detour


def _dot(a: Array, b: Array) -> Float[Array, "n"]:
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])


def _apart(crowd: Crowd) -> Float[Array, "n 2"]:
    """The forces between people: strongest from whoever is in front."""
    x, y = crowd.place.T
    right, up = x[:, None] - x, y[:, None] - y
    distance = np.maximum(np.sqrt(right * right + up * up), 0.05) + np.diag(np.full(len(x), 1e3))
    reach = np.minimum(crowd.radius[:, None] + crowd.radius - distance, 0.3)
    strength = PUSH * np.exp(reach / RANGE) / distance
    u, v = crowd.speed.T
    fast = np.maximum(np.sqrt(u * u + v * v), 0.1)
    facing = -(right * u[:, None] + up * v[:, None]) / (distance * fast[:, None])
    strength *= BEHIND + (1 - BEHIND) * 0.5 * (1 + facing)
    return np.column_stack([(strength * right).sum(axis=1), (strength * up).sum(axis=1)])


def _look_up(place: Array, ground: Ground) -> Float[Array, "n 3"]:
    cells = ((place - ground.corner) / ground.cell).astype(np.int64)
    rows, columns = ground.table.shape[:2]
    column = np.minimum(np.maximum(cells[:, 0], 0), columns - 1)
    row = np.minimum(np.maximum(cells[:, 1], 0), rows - 1)
    return ground.table[row, column]


def _traffic(
    pace: Array,
    across: Array,
    outlook: Outlook,
    crossings: Crossings,
    vehicles: Vehicles,
    rules: Rules,
) -> tuple[Bool[Array, "m"], Bool[Array, "m"], Float[Array, "m"]]:
    """Whether one can step on the road, whether nothing is in one's way there, and a detour.

    `across` is metres to the left of the crossing's middle line.
    """
    (fleet, front, tail), which, table = vehicles, outlook.which, rules.overlaps
    way, speed = fleet.way[:, None], fleet.speed[:, None]
    span, sense = table.crossing[way, which], table.sense[way, which]
    apart = (table.beside[way, which] - outlook.beside) * outlook.sign
    room, clear = span[..., 0] - front[:, None], span[..., 1] - tail[:, None]
    body = (room < 0.4) & (clear > -0.4)
    # the body along its way, from the crossing's middle line
    middle = 0.5 * (span[..., 0] + span[..., 1])
    nose, end = front[:, None] - middle + ASIDE, tail[:, None] - middle - ASIDE
    level = (across * sense < nose - 0.1) & (across * sense > end + 0.1)
    blocked = body & level & (apart > -0.2) & (apart < BODY + 0.7 * pace)
    stands = body & (speed < 0.3) & (apart > -BODY) & (apart < BODY + 2.0)
    past = np.where(np.abs(nose) < np.abs(end), nose, end) * sense * outlook.sign
    past = np.where(stands & (np.abs(past) < FURTHEST), past, 0.0)
    around = past[np.argmax(np.abs(past), axis=0), np.arange(len(which))]
    marked, free = crossings.marked[which], crossings.free[which]
    needed = (apart + BODY) / pace + np.where(marked, 0.5, WARY)
    stops = (room > speed * speed / 5.0 + 2.0) | ((speed < 0.3) & (room > 0.5))
    comes = (room > 0) & (room < needed * np.maximum(speed, 1.0)) & (apart > 0)
    comes &= ~(marked & stops)
    comes &= (crossings.light[which] < 0) & ~free  # where lights rule, those who turn give way
    near = body & (apart > 0) & ((apart < 3.0 * pace) | (speed < 0.5))
    return ~(comes | near).any(axis=0), ~blocked.any(axis=0), around
