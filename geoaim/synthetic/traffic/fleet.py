"""The vehicles of a moment, and one step of all of them.

Each follows the intelligent driver model (Treiber, Hennecke, Helbing 2000) behind whoever is
ahead on its way, stops at red, gives way where ways meet, and waits for people on crossings.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int8
from numpy import ndarray as Array

from geoaim.car_following import DriverParameters, compute_gap_ratio
from geoaim.lights import RED, YELLOW
from geoaim.synthetic.exact import round_reproducibly
from geoaim.synthetic.roads.curves import POINT_SPACING_M
from geoaim.synthetic.traffic.overlaps import COARSE, Meetings, Overlaps
from geoaim.synthetic.traffic.signals import Signals
from geoaim.synthetic.traffic.ways import Way

NOSE, TAIL = 0.8, 0.2  # shares of the length before and behind the rear axle
PULL, BRAKE = 1.8, 2.2  # m/s2, acceleration and comfortable braking
FORESEEN = 0.6  # s by which one adapts to the speed that will be wished
EASY = 1.5  # m/s2 that one counts on when the ground must be left in time
HARD, HARDEST = 3.2, 8.0  # m/s2: who would need more than HARD passes at yellow; the limit
GAP, MARGIN = 2.0, 0.7  # m behind others, and before a line
SURE = 1.0  # s between those who pass the same ground
JERK = (3.0, 7.0)  # m/s3 up and down
FAR = 1e6
COARSE_STEP = COARSE * POINT_SPACING_M
BODY = 1.6  # m from the middle of a vehicle to where nobody should stand
STRAIGHT = 6.5  # m: longer vehicles do not turn


@dataclass(frozen=True)
class Fleet:
    """Vehicles of a moment (n of them).

    Attributes:
        number: who it is.
        way: the number of its way.
        at: metres of its rear axle along the way.
        speed: m/s along the way.
        change: acceleration, m/s2.
        length: metres.
        pace: its speed as a share of what is allowed.
        headway: seconds that it keeps behind others.
        leaves: when it leaves its bay, seconds; infinite while it drives.
    """

    number: Int[Array, "n"]
    way: Int[Array, "n"]
    at: Float[Array, "n"]
    speed: Float[Array, "n"]
    change: Float[Array, "n"]
    length: Float[Array, "n"]
    pace: Float[Array, "n"]
    headway: Float[Array, "n"]
    leaves: Float[Array, "n"]


# vehicles of a moment, and their foremost and hindmost points along their ways, from `reach_of`
Vehicles = tuple[Fleet, Float[Array, "v"], Float[Array, "v"]]


@dataclass(frozen=True)
class Rules:
    """What a step looks up (R ways, K points, C crossings).

    Attributes:
        overlaps: what ways share.
        wish: (R, K) speed at each point such that what lies ahead can be met calmly, m/s.
        forward: (R, K) whether vehicles drive forward there.
        finish: (R,) metres of each way.
        stop: (R,) metres to the stop line; infinite where there is none.
        light: (R,) number of the light that holds there; -1: none.
        entry: (R,) number of the place where its vehicles appear; -1: a bay.
        bay: (R,) number of the bay that it leads into or out of; -1: none.
        inwards: (R,) whether it leads into one.
        ahead: `overlaps.ahead` as one row, with a row of infinities at its end.
    """

    overlaps: Overlaps
    wish: Float[Array, "R K"]
    forward: Bool[Array, "R K"]
    finish: Float[Array, "R"]
    stop: Float[Array, "R"]
    light: Int[Array, "R"]
    entry: Int[Array, "R"]
    bay: Int[Array, "R"]
    inwards: Bool[Array, "R"]
    ahead: Float32[Array, "_"]


@dataclass(frozen=True)
class Pairs:
    """Which vehicles meet, as long as nobody comes, goes or changes its way (P pairs).

    Attributes:
        rows: (n, n) where in `Rules.ahead` the places of each other vehicle begin.
        me: (P,) vehicles whose ways meet those of `other`.
        other: (P,) those.
        meetings: (P,) where they meet.
        other_line: (P,) where the other one waits for me.
        light: (n,) number of the light on the way of each; -1: none.
        stop: (n,) metres to the stop line.
        crossing: (n, C, 2) where the crossings begin and end.
    """

    rows: Int[Array, "n n"]
    me: Int[Array, "P"]
    other: Int[Array, "P"]
    meetings: Meetings
    other_line: Float[Array, "P"]
    light: Int[Array, "n"]
    stop: Float[Array, "n"]
    crossing: Float[Array, "n C 2"]


@dataclass(frozen=True)
class OnFoot:
    """Those who are on a crossing or stepping on it (m of them).

    Attributes:
        crossing: which one.
        beside: metres from its first end.
        pace: m/s along it, positive away from the first end; not 0.
        reach: metres of the body along the crossing, to either side.
    """

    crossing: Int[Array, "m"]
    beside: Float[Array, "m"]
    pace: Float[Array, "m"]
    reach: Float[Array, "m"]


def make_rules(ways: tuple[Way, ...], overlaps: Overlaps, signals: Signals) -> Rules:
    """Tables of all ways side by side."""
    longest = max(len(way.line) for way in ways)
    entries = sorted({way.entry for way in ways} - {""})
    wish = np.full((len(ways), longest), 0.1)
    forward = np.ones((len(ways), longest), bool)
    for r, way in enumerate(ways):
        wish[r, : len(way.line)] = _calm(way.limit)
        forward[r, : len(way.line)] = way.forward
    return Rules(
        overlaps=overlaps,
        wish=wish,
        forward=forward,
        finish=np.array([POINT_SPACING_M * (len(way.line) - 1) for way in ways]),
        stop=np.array([way.stop for way in ways]),
        light=np.array([signals.names.index(w.signal) if w.signal else -1 for w in ways]),
        entry=np.array([entries.index(way.entry) if way.entry else -1 for way in ways]),
        bay=np.array([way.bay for way in ways]),
        inwards=np.array([way.bay >= 0 and way.entry != "" for way in ways]),
        ahead=np.append(overlaps.ahead.ravel(), np.full(longest, np.inf, np.float32)),
    )


def pair_up(fleet: Fleet, rules: Rules) -> Pairs:
    """Who meets whom, from the ways of all vehicles."""
    count, _, reach = rules.overlaps.ahead.shape
    mine, others = fleet.way[:, None], fleet.way[None, :]
    rows = (mine * count + others) * reach
    rows[np.arange(len(rows)), np.arange(len(rows))] = count * count * reach
    numbers = rules.overlaps.meeting[mine, others]  # (n, n, 2)
    me, other, slot = np.nonzero(numbers >= 0)
    reverse = rules.overlaps.meeting[fleet.way[other], fleet.way[me], slot]
    table, which = rules.overlaps.meetings, numbers[me, other, slot]
    return Pairs(
        rows=rows,
        me=me,
        other=other,
        meetings=Meetings(*(getattr(table, field.name)[which] for field in fields(Meetings))),
        other_line=table.line[reverse],
        light=rules.light[fleet.way],
        stop=rules.stop[fleet.way],
        crossing=rules.overlaps.crossing[fleet.way],
    )


def reach_of(fleet: Fleet, rules: Rules) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Metres along their ways of the vehicles' foremost and hindmost points."""
    forward = rules.forward[fleet.way, _point(fleet.at, rules)]
    front = fleet.at + np.where(forward, NOSE, TAIL) * fleet.length
    return front, front - fleet.length


def step(
    vehicles: Vehicles,
    pairs: Pairs,
    rules: Rules,
    lights: Int8[Array, "G"],
    on_foot: OnFoot,
    interval: float,
) -> Fleet:
    """All vehicles an interval (seconds) later."""
    fleet, front, tail = vehicles
    if len(fleet.at) == 0:
        return fleet
    wish = fleet.pace * rules.wish[fleet.way, _point(fleet.at + FORESEEN * fleet.speed, rules)]
    gap, leader = _leaders(fleet, pairs, rules, front, tail)
    halt, held = _red(fleet, pairs, lights, front)
    halt = np.minimum(halt, _crossings(fleet, rules, on_foot, front, tail))
    halt = np.minimum(halt, _kept_clear(fleet, pairs, front, gap, leader))
    ground, pace = _meetings(fleet, pairs, (front, tail), (gap, leader), (held, wish))
    share = fleet.speed / wish
    share *= share
    over = np.maximum((wish - fleet.speed) / 0.7, -3.5)
    pull = np.where(share < 1, PULL * (1 - share * share), over)
    press = np.maximum(
        _press(fleet, gap, leader, GAP, fleet.headway),
        np.maximum(_press(fleet, halt, 0.0, MARGIN, 0.4), _press(fleet, ground, pace, MARGIN, 0.4)),
    )
    change = np.minimum(pull, np.maximum(pull, 0) - press)
    change = np.maximum(change, -HARDEST)
    eased = np.minimum(change, fleet.change + JERK[0] * interval)
    eased = np.maximum(eased, fleet.change - JERK[1] * interval)
    change = np.where(change < -HARD, np.minimum(change, eased), eased)
    speed = round_reproducibly(np.maximum(fleet.speed + change * interval, 0))
    stands = np.isfinite(fleet.leaves)
    speed = np.where(stands, 0.0, speed)
    at = round_reproducibly(fleet.at + 0.5 * (fleet.speed + speed) * interval)
    at = np.where(stands, fleet.at, at)
    change = round_reproducibly(np.where(speed > 0, change, np.maximum(change, 0)))
    return replace(fleet, at=at, speed=speed, change=change)


def _calm(limit: Float[Array, "L"]) -> Float[Array, "L"]:
    """Speeds from which each later limit is reached with comfortable braking."""
    calm = limit**2
    for k in range(len(calm) - 2, -1, -1):
        calm[k] = min(calm[k], calm[k + 1] + 2 * 0.8 * BRAKE * POINT_SPACING_M)
    return np.sqrt(calm)


def _point(at: Float[Array, "n"], rules: Rules) -> Int[Array, "n"]:
    return np.minimum((at / POINT_SPACING_M).astype(np.int64), rules.wish.shape[1] - 1)


def _press(
    fleet: Fleet, gap: Array, leader: Array | float, rest: float, headway: Array | float
) -> Float[Array, "n"]:
    """The braking term of the intelligent driver model, m/s2."""
    driver = DriverParameters(PULL, BRAKE, rest, headway)
    ratio = compute_gap_ratio(driver, fleet.speed, fleet.speed - leader, gap)
    return PULL * ratio * ratio


def _leaders(
    fleet: Fleet, pairs: Pairs, rules: Rules, front: Array, tail: Array
) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Metres to whoever drives ahead, and its speed; who turns in counts at once."""
    metres = rules.overlaps.ahead.shape[2] - 1
    nose = np.minimum(np.maximum(front / COARSE_STEP, 0), metres).astype(np.int64)
    end = np.minimum(np.maximum(tail / COARSE_STEP, 0), metres).astype(np.int64)
    to_nose = rules.ahead.take(pairs.rows + nose) + (front - COARSE_STEP * nose)
    to_end = rules.ahead.take(pairs.rows + end) + (tail - COARSE_STEP * end)
    to_nose = np.where(to_nose > front[:, None], to_nose - fleet.length, np.inf)
    to_end = np.where(to_end > tail[:, None], to_end, np.inf)
    gaps = np.minimum(to_nose, to_end) - front[:, None]
    who = np.argmin(gaps, axis=1)
    gap = np.minimum(gaps[np.arange(len(who)), who], FAR)
    return gap, np.where(gap < FAR, fleet.speed[who], 0.0)


def _red(
    fleet: Fleet, pairs: Pairs, lights: Int8[Array, "G"], front: Array
) -> tuple[Float[Array, "n"], Bool[Array, "n"]]:
    """Metres to the line at which a light holds a vehicle, and whether it waits for somebody.

    Lights hold at red, at yellow, and at green while somebody from an earlier green has not left
    the ground ahead. Who has not passed its own give-way line waits as well; nobody else need
    wait for it.
    """
    light, room = pairs.light, pairs.stop - front
    state = np.append(lights, np.int8(0))[light]
    left = (state == RED) & (room < -1.0)
    barred = np.zeros(len(room), bool)
    ahead = left[pairs.other] & (fleet.at[pairs.other] < pairs.meetings.other_end)
    barred[pairs.me[ahead]] = True
    needed = fleet.speed * fleet.speed / (2 * np.where((state == RED) | barred, HARDEST, HARD))
    held = (light >= 0) & (room > -0.5) & (room + 0.5 > needed) & ((state >= YELLOW) | barred)
    before = (light < 0) & np.isfinite(pairs.stop) & (room > -0.3)
    return np.where(held, np.maximum(room, 0.05), FAR), held | before


def _crossings(
    fleet: Fleet, rules: Rules, on_foot: OnFoot, front: Array, tail: Array
) -> Float[Array, "n"]:
    """Metres to the crossing before which a vehicle lets somebody pass."""
    if len(on_foot.crossing) == 0:
        return np.full(len(front), FAR)
    span = rules.overlaps.crossing[fleet.way[:, None], on_foot.crossing]  # (n, m, 2)
    beside = rules.overlaps.beside[fleet.way[:, None], on_foot.crossing]
    pace = np.abs(on_foot.pace)
    apart = (beside - on_foot.beside) * np.sign(on_foot.pace)
    room = span[..., 0] - front[:, None]
    arrive, leave = _times(fleet.speed[:, None], room, span[..., 1] - tail[:, None])
    wide = BODY + on_foot.reach
    meets = ((apart - wide) / pace < leave + 0.5) & ((apart + wide) / pace > arrive - 0.3)
    stops = (room > 0.0) & (fleet.speed[:, None] ** 2 < 2 * HARDEST * room)
    return np.where(meets & stops, np.maximum(room - MARGIN, 0.05), FAR).min(axis=1)


def _kept_clear(
    fleet: Fleet, pairs: Pairs, front: Array, gap: Array, leader: Array
) -> Float[Array, "n"]:
    """Metres to a crossing that a vehicle could not leave, because of those ahead."""
    start, end = pairs.crossing[..., 0], pairs.crossing[..., 1]
    room = start - front[:, None]
    full = (front + gap - fleet.length)[:, None] < end + MARGIN
    full &= (leader < 2.5)[:, None] & (room > 0.0)
    return np.where(full, np.maximum(room - MARGIN, 0.05), FAR).min(axis=1, initial=FAR)


def _times(speed: Array, room: Array, clear: Array) -> tuple[Array, Array]:
    """The earliest time to cover `room` and the likely one to cover `clear`, seconds."""
    square = speed * speed
    arrive = (np.sqrt(square + 2 * PULL * np.maximum(room, 0)) - speed) / PULL
    slow = np.sqrt(square + 2 * EASY * np.maximum(clear, 0)) - speed
    return arrive, np.maximum(slow / EASY, clear / 9.0)


def _meetings(
    fleet: Fleet,
    pairs: Pairs,
    reach: tuple[Array, Array],
    ahead: tuple[Array, Array],
    waits: tuple[Bool[Array, "n"], Float[Array, "n"]],
) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Metres to ground that others have or will have, and the speed at which it moves away."""
    (front, tail), (gap, leader), (held, wish) = reach, ahead, waits
    m, i, j = pairs.meetings, pairs.me, pairs.other
    my_front, my_speed, speed = front[i], fleet.speed[i], fleet.speed[j]
    to_start, to_theirs, from_theirs = (
        m.start - my_front,
        m.other_start - front[j],
        m.other_end - tail[j],
    )
    arrive, leave = _times(my_speed, to_start, m.end - tail[i])
    their_arrive = (np.sqrt(speed * speed + 2 * PULL * np.maximum(to_theirs, 0)) - speed) / PULL
    their_arrive = np.maximum(their_arrive, to_theirs / np.maximum(wish[j], 1.0))
    out = (from_theirs < -0.3) | np.isfinite(fleet.leaves)[j]
    inside = (to_theirs < 0.3) & ~out
    stuck = (leader[j] < 0.5) & (gap[j] < to_theirs + 1.0)  # behind one that stands before it
    coming = ~(inside | out | held[j] | stuck)
    clash = coming & (their_arrive < leave + SURE)
    clash &= from_theirs / np.maximum(speed, 2.0) + 0.5 > arrive
    full = ((gap + front - fleet.length)[i] < m.end + 1.0) & (leader[i] < 2.0) & ~out
    wait = m.gives_way & (clash | full | inside) & (my_front <= m.line + 0.3)
    started = coming & ~m.gives_way & (front[j] > pairs.other_line + 0.4)
    taken = (inside | (started & (their_arrive < arrive))) & (to_start > -0.1)
    moving = taken & m.along & inside & ~wait
    room = np.where(wait, m.line - my_front, FAR)
    room = np.where(taken, np.minimum(room, to_start - 0.3), room)
    room = np.where(moving, to_start + tail[j] - m.other_start, room)
    room = np.maximum(room, 0.05)
    nearest, pace = np.full(len(front), FAR), np.zeros(len(front))
    np.minimum.at(nearest, i, room)
    mine = moving & (room <= nearest[i])
    pace[i[mine]] = speed[mine]
    return nearest, pace
