"""Where ways share ground: who follows whom, who gives way to whom, and who meets people.

Everything that traffic needs to know of the plan is worked out here once, as tables that a step
of the simulation only looks up.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray as Array

from geoaim.synthetic.roads.curves import POINT_SPACING_M
from geoaim.synthetic.roads.paving import Crossing, outline_crossing
from geoaim.synthetic.traffic.ways import Way

COARSE = 2  # every so many points of two ways are compared
WIDE = 2.8  # m between two ways where vehicles on them would touch
LANE = 2.3  # m from a way where somebody who drives along it is in its lane
ALONG = 0.5  # cosine of the angle above which two ways run side by side
MERGE = 8.0  # m after which one who has joined a way simply drives ahead on it
GROUP = 7.0  # m: places to give way that are closer to each other are passed in one go
WAIT = 1.0  # m before the shared ground where one waits
BACK = 14.0  # m: a give-way line that lies so little before the ground is where one waits
APART = 16.0  # m between two stretches on which the same two ways meet
PARKED = 1.6  # m along a way out of a bay that the vehicle's end reaches while it stands
BOTH = 2  # two ways meet at most this often


@dataclass(frozen=True)
class Meetings:
    """Stretches of ground that two ways share, each seen from both ways (M meetings).

    Attributes:
        line: metres along a way to where one waits for the other way's vehicles.
        start: metres along the way to where the shared ground begins.
        end: metres to where it ends.
        other_start: the same on the other way.
        other_end: the same on the other way.
        gives_way: whether vehicles of the way wait for those of the other.
        along: whether both drive in one direction there.
    """

    line: Float[Array, "M"]
    start: Float[Array, "M"]
    end: Float[Array, "M"]
    other_start: Float[Array, "M"]
    other_end: Float[Array, "M"]
    gives_way: Bool[Array, "M"]
    along: Bool[Array, "M"]


@dataclass(frozen=True)
class Overlaps:
    """What R ways share with each other and with C crossings.

    Attributes:
        ahead: (R, R, K) metres along way A of somebody at the k-th metre of way B who drives in
            A's lane; infinite where he does not.
        meeting: (R, R, 2) numbers of the meetings of two ways; -1 where there is none.
        meetings: what they are.
        crossing: (R, C, 2) metres along a way to where a crossing begins and ends; NaN: nowhere.
        beside: (R, C) metres from the crossing's first end to the way.
        sense: (R, C) 1 where the way leads to the left of those who walk from the first end,
            -1 where to their right.
    """

    ahead: Float32[Array, "R R K"]
    meeting: Int[Array, "R R 2"]
    meetings: Meetings
    crossing: Float[Array, "R C 2"]
    beside: Float[Array, "R C"]
    sense: Float[Array, "R C"]


@dataclass(frozen=True)
class _Stretch:
    """Common ground of ways a and b: metres along both."""

    a: int
    b: int
    on_a: tuple[float, float]
    on_b: tuple[float, float]
    along: bool


def find_overlaps(
    ways: tuple[Way, ...], crossings: tuple[Crossing, ...], *, ring: bool
) -> Overlaps:
    """Compare all ways with each other and with the crossings."""
    count = len(ways)
    points = [way.line[::COARSE] for way in ways]
    directions = [_directions(way)[::COARSE] for way in ways]
    longest = max(len(line) for line in points)
    ahead = np.full((count, count, longest), np.inf, np.float32)
    stretches = []
    for a, b in combinations(range(count), 2):
        (ax, ay), (bx, by) = points[a].T, points[b].T
        apart = np.sqrt((ax[:, None] - bx) ** 2 + (ay[:, None] - by) ** 2)
        same = directions[a] @ directions[b].T
        ahead[a, b, : len(bx)] = _ahead(apart, same, points[a], points[b], directions[a])
        ahead[b, a, : len(ax)] = _ahead(apart.T, same.T, points[b], points[a], directions[b])
        stretches += _stretches(a, b, apart, same)
    for a in range(count):
        ahead[a, a, : len(points[a])] = COARSE * POINT_SPACING_M * np.arange(len(points[a]))
    meeting, meetings = _meetings(ways, stretches, ring=ring)
    return Overlaps(ahead, meeting, meetings, *_crossings(ways, crossings))


def _directions(way: Way) -> Float[Array, "L 2"]:
    return np.stack([np.cos(way.heading), np.sin(way.heading)], axis=1)


def _ahead(
    apart: Array, same: Array, points: Array, others: Array, direction: Array
) -> Float[Array, "K"]:
    """Where on way A each point of way B lies, for those in A's lane and direction."""
    near = np.argmin(apart, axis=0)
    columns = np.arange(apart.shape[1])
    offset = ((others - points[near]) * direction[near]).sum(axis=1)
    inside = (apart[near, columns] < LANE) & (same[near, columns] > ALONG)
    return np.where(inside, COARSE * POINT_SPACING_M * near + offset, np.inf)


def _stretches(a: int, b: int, apart: Array, same: Array) -> list[_Stretch]:
    """The stretches of common ground of two ways, save that where they start as one."""
    close = apart < WIDE
    rows = np.flatnonzero(np.diff(np.concatenate([[0], close.any(axis=1), [0]])))
    found = []
    for first, last in zip(rows[::2].tolist(), (rows[1::2] - 1).tolist(), strict=True):
        columns = np.flatnonzero(close[first : last + 1].any(axis=0))
        if first == 0 and columns[0] == 0:
            continue
        near = np.argmin(apart[last])
        along = bool(same[last, near] > ALONG)
        on_a, on_b = (first, last), (int(columns[0]), int(columns[-1]))
        if along:  # once they drive one behind the other, there is nothing to wait for
            together = np.flatnonzero((apart[first:last] < 0.7).any(axis=1))
            joined = first + (int(together[0]) if len(together) else 0) + round(MERGE)
            on_a = (first, min(last, joined))
            on_b = (on_b[0], min(on_b[1], int(np.argmin(apart[on_a[1]]))))
        found.append(_Stretch(a, b, _metres(on_a), _metres(on_b), along))
    return _joined(found)


def _joined(stretches: list[_Stretch]) -> list[_Stretch]:
    """Stretches that are not apart enough for a vehicle to wait between them are one."""
    joined: list[_Stretch] = []
    for stretch in stretches:
        before = joined[-1] if joined else None
        if before is not None and stretch.on_a[0] - before.on_a[1] < APART:
            on_a = before.on_a[0], stretch.on_a[1]
            both = (*before.on_b, *stretch.on_b)
            along = before.along and stretch.along
            joined[-1] = _Stretch(stretch.a, stretch.b, on_a, (min(both), max(both)), along)
        else:
            joined.append(stretch)
    return joined


def _metres(span: tuple[int, int]) -> tuple[float, float]:
    return COARSE * POINT_SPACING_M * span[0], COARSE * POINT_SPACING_M * span[1]


def _meetings(
    ways: tuple[Way, ...], stretches: list[_Stretch], *, ring: bool
) -> tuple[Int[Array, "R R 2"], Meetings]:
    """Each stretch from both sides: who gives way, and where he waits."""
    index = np.full((len(ways), len(ways), BOTH), -1)
    rows: list[tuple[float, ...]] = []
    owners: list[int] = []
    for stretch in stretches:
        first = _goes_first(ways, stretch, ring=ring)
        for me, other, mine, theirs in (
            (stretch.a, stretch.b, stretch.on_a, stretch.on_b),
            (stretch.b, stretch.a, stretch.on_b, stretch.on_a),
        ):
            free = np.flatnonzero(index[me, other] < 0)
            if len(free) == 0:
                raise AssertionError(f"{ways[me].name} and {ways[other].name} meet too often")
            index[me, other, free[0]] = len(rows)
            mine, theirs = _from_bay(ways[me], mine), _from_bay(ways[other], theirs)
            rows.append((*mine, *theirs, float(me != first), float(stretch.along)))
            owners.append(me)
    table = np.array(rows).reshape(-1, 6)
    gives_way = table[:, 4] > 0
    line = _lines(ways, np.array(owners, int), table[:, 0], table[:, 1], gives_way)
    start, end, other_start, other_end = table[:, :4].T
    along = table[:, 5] > 0
    return index, Meetings(line, start, end, other_start, other_end, gives_way, along)


def _from_bay(way: Way, span: tuple[float, float]) -> tuple[float, float]:
    """Who stands in a bay is not yet on the ground that he shares with others."""
    return (max(span[0], PARKED + 0.4), span[1]) if not way.entry else span


def _goes_first(ways: tuple[Way, ...], stretch: _Stretch, *, ring: bool) -> int:
    """On a ring, whoever is on it already; elsewhere the lower rank, then the lower number."""
    a, b = ways[stretch.a], ways[stretch.b]
    if ring:
        since_a, since_b = stretch.on_a[0] - a.stop, stretch.on_b[0] - b.stop
        return stretch.a if since_a > since_b else stretch.b
    rank_a = a.rank[round(stretch.on_a[0] / POINT_SPACING_M)]
    rank_b = b.rank[round(stretch.on_b[0] / POINT_SPACING_M)]
    return stretch.a if rank_a <= rank_b else stretch.b


def _lines(
    ways: tuple[Way, ...], owner: Array, start: Array, end: Array, gives_way: Array
) -> Float[Array, "M"]:
    """Where one waits: before the first of the stretches that must be passed in one go."""
    line = start - WAIT
    for number, way in enumerate(ways):
        mine = np.flatnonzero((owner == number) & gives_way)
        reach, first = -np.inf, 0.0
        for k in mine[np.argsort(start[mine], kind="stable")]:
            if start[k] > reach + GROUP:
                first = start[k] - WAIT
                if not way.signal and 0 <= first - way.stop < BACK:
                    first = way.stop
            line[k] = max(first, PARKED if not way.entry else 0.0)
            reach = max(reach, end[k])
    return line


def _crossings(
    ways: tuple[Way, ...], crossings: tuple[Crossing, ...]
) -> tuple[Float[Array, "R C 2"], Float[Array, "R C"], Float[Array, "R C"]]:
    """Where each way crosses each crossing, how far along the crossing, and in which sense."""
    span = np.full((len(ways), len(crossings), 2), np.nan)
    beside, sense = np.full_like(span[..., 0], np.nan), np.ones_like(span[..., 0])
    for c, crossing in enumerate(crossings):
        area = outline_crossing(crossing)
        first, last = crossing.ends
        ahead = (last - first) / np.hypot(*(last - first))
        for r, way in enumerate(ways):
            inside = np.flatnonzero(shapely.contains_xy(area, *way.line.T))
            if len(inside):
                span[r, c] = POINT_SPACING_M * inside[0], POINT_SPACING_M * inside[-1]
                beside[r, c] = ((way.line[inside].mean(axis=0) - first) * ahead).sum()
                x, y = way.line[inside[-1]] - way.line[inside[0]]
                sense[r, c] = 1.0 if ahead[0] * y - ahead[1] * x > 0 else -1.0
    return span, beside, sense
