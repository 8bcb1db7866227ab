"""Where people walk: along pavements, over crossings, on paths off them; and routes over these."""

import heapq
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString, Point, Polygon
from shapely.ops import substring

from geoaim.synthetic.roads.curves import Line, even
from geoaim.synthetic.roads.paths import doors, footpaths
from geoaim.synthetic.roads.paving import VERGE, Crossing, Paving, outer_kerbs

BEYOND = 8.0  # m past the page where people appear and vanish


@dataclass(frozen=True)
class Leg:
    """A piece of a walk, walked in either direction.

    Attributes:
        line: points at equal steps, plan metres.
        crossing: number of the crossing that it leads over; -1: a pavement or path.
        start: node at its start.
        end: node at its end.
    """

    line: Line
    crossing: int
    start: int
    end: int


@dataclass(frozen=True, eq=False)
class Walks:
    """The net that people walk on.

    Attributes:
        legs: its edges.
        gates: nodes at which people appear and vanish: the page's edge, doors, ends of footpaths.
        paths: paved ways to doors and through parks.
    """

    legs: tuple[Leg, ...]
    gates: tuple[int, ...]
    paths: Geometry


def make_walks(
    paving: Paving,
    crossings: tuple[Crossing, ...],
    page: Polygon,
    wide: float,
    generator: np.random.Generator,
    *,
    park: bool = False,
) -> Walks:
    """Lines along the pavements (`wide` metres), joined by crossings, with paths off them.

    Paths lead to doors, or through a park.
    """
    whole = outer_kerbs(paving)
    middle = whole.buffer((VERGE + wide) / 2, quad_segs=16).exterior
    inside = shapely.line_merge(middle.intersection(page.buffer(BEYOND)))
    sides = [line for line in shapely.get_parts(inside) if line.length > 20]
    off = footpaths if park else doors
    nets = [net for side in sides for net in off(side, paving, generator)]
    feet = [(side, at) for side, line in enumerate(sides) for at in (0.0, line.length)]
    rims = len(feet)
    ends = [end for crossing in crossings for end in crossing.ends]
    ends += [foot for net in nets for foot in net.feet]
    feet += [_nearest(sides, end) for end in ends]
    node = _same_place(feet)
    legs = [*_over(sides, crossings, feet[rims:], node[rims:])]
    along_drive = _same_side(crossings, feet[rims:], node[rims:])
    legs += _along(sides, feet, node, along_drive)
    free, used = len(feet) + 2 * len(crossings), rims + 2 * len(crossings)
    gates = node[:rims]
    for net in nets:
        mine = [*node[used : used + len(net.feet)], *range(free, free + net.others)]
        free, used = free + net.others, used + len(net.feet)
        gates += [mine[k] for k in net.gates]
        legs += [
            Leg(even(line), -1, mine[a], mine[b])
            for line, (a, b) in zip(net.lines, net.ends, strict=True)
        ]
    paved = shapely.union_all([whole, paving.pavement])
    paths = shapely.union_all([net.paved for net in nets]).difference(paved)
    return Walks(tuple(legs), tuple(gates), paths)


def route(walks: Walks, start: int, end: int, favour: Float[Array, "_"]) -> list[tuple[Line, int]]:
    """The way between two gates: lines and crossings; each leg counts `favour` times its length.

    Dijkstra's; empty where no way leads there.
    """
    edges: dict[int, list[tuple[int, int]]] = {}
    legs = zip(walks.legs, favour, strict=True)
    costs = [len(leg.line) * weight for leg, weight in legs]  # a point each half metre
    for number, leg in enumerate(walks.legs):
        edges.setdefault(leg.start, []).append((leg.end, number))
        edges.setdefault(leg.end, []).append((leg.start, number))
    queue, came = [(0.0, start)], {start: (0.0, -1, -1)}
    while queue:
        cost, node = heapq.heappop(queue)
        for after, number in edges.get(node, []):
            total = cost + costs[number]
            if after not in came or total < came[after][0]:
                came[after] = (total, node, number)
                heapq.heappush(queue, (total, after))
    found: list[tuple[Line, int]] = []
    while end != start and end in came:
        _, before, number = came[end]
        leg = walks.legs[number]
        found.append((leg.line if leg.end == end else leg.line[::-1], leg.crossing))
        end = before
    return found[::-1]


def _nearest(sides: list[LineString], point: Float[Array, "2"]) -> tuple[int, float]:
    """The side that passes nearest to a point, and metres along it."""
    side = int(np.argmin([side.distance(Point(point)) for side in sides]))
    return side, float(sides[side].project(Point(point)))


def _same_place(feet: list[tuple[int, float]]) -> list[int]:
    """A node for each foot; feet within half a metre of each other share one."""
    node: list[int] = []
    for k, (side, at) in enumerate(feet):
        twins = [j for j in range(k) if feet[j][0] == side and abs(feet[j][1] - at) < 0.5]
        node.append(node[twins[0]] if twins else k)
    return node


def _same_side(
    crossings: tuple[Crossing, ...], feet: list[tuple[int, float]], node: list[int]
) -> dict[frozenset[int], int]:
    """Crossings that lie in a pavement's own line, by the nodes at their ends."""
    pairs = {}
    for number in range(len(crossings)):
        if feet[2 * number][0] == feet[2 * number + 1][0]:
            pairs[frozenset(node[2 * number : 2 * number + 2])] = number
    return pairs


def _over(
    sides: list[LineString],
    crossings: tuple[Crossing, ...],
    feet: list[tuple[int, float]],
    node: list[int],
) -> list[Leg]:
    """For each crossing that joins two pavements: to the kerb, over, from the kerb."""
    legs, free = [], max(2 * len(sides) + len(feet), 0)
    for number, crossing in enumerate(crossings):
        pair = range(2 * number, 2 * number + 2)
        if feet[pair[0]][0] == feet[pair[1]][0]:
            continue
        kerbs = [free + k for k in pair]
        legs.append(Leg(even(crossing.ends), number, *kerbs))
        for k, kerb, end in zip(pair, kerbs, crossing.ends, strict=True):
            foot = np.array(sides[feet[k][0]].interpolate(feet[k][1]).coords[0])
            legs.append(Leg(even(np.stack([foot, end])), -1, node[k], kerb))
    return legs


def _along(
    sides: list[LineString],
    feet: list[tuple[int, float]],
    node: list[int],
    crossings: dict[frozenset[int], int],
) -> list[Leg]:
    """The pavements' lines, cut at all feet."""
    legs = []
    for number, side in enumerate(sides):
        marks = sorted({(feet[k][1], k) for k in set(node) if feet[k][0] == number})
        for (start, a), (end, b) in pairwise(marks):
            line = even(np.array(substring(side, start, end).coords))
            legs.append(Leg(line, crossings.get(frozenset((a, b)), -1), a, b))
    return legs
