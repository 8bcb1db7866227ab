"""Ways on foot off the pavements: straight ones to doors, winding ones through a park."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString, Point

from geoaim.synthetic.roads.curves import Line, left_of
from geoaim.synthetic.roads.paving import Paving, outer_kerbs

PATH = 2.0  # m, width of a path to a door
DOOR = (9.0, 16.0)  # m from the middle of a pavement to a door
DOORS = 2  # on each side, where there is room
APART = 15.0  # m between two doors
FOOTPATH = 3.0  # m, width of a way through a park
FEET = (0.2, 0.5, 0.8)  # of a pavement's length: where footpaths leave it, about
DEEP = (12.0, 30.0)  # m from the pavement to where footpaths meet
OUT = 60.0  # m from the pavement, beyond the page
BULGE = 0.2  # of its length by which a footpath leaves the straight line at most


@dataclass(frozen=True, eq=False)
class Net:
    """Paths off a pavement, joined to each other; nodes are the feet, then the others.

    Attributes:
        feet: where they leave the pavement.
        others: how many more nodes there are.
        lines: the paths.
        ends: the nodes at the start and end of each.
        gates: nodes at which people appear and vanish.
        paved: what is walked on.
    """

    feet: tuple[Float[Array, "2"], ...]
    others: int
    lines: tuple[Line, ...]
    ends: tuple[tuple[int, int], ...]
    gates: tuple[int, ...]
    paved: Geometry


def doors(side: LineString, paving: Paving, generator: np.random.Generator) -> list[Net]:
    """Straight paths from a pavement into the plots, where nothing is in their way."""
    plots = shapely.union_all(list(paving.plots))
    found: list[Net] = []
    for at, reach in zip(
        generator.uniform(0.1, 0.9, 12), generator.uniform(*DOOR, 12), strict=True
    ):
        spot, ahead = (
            np.array(side.interpolate(at * side.length + d).coords[0]) for d in (0.0, 0.5)
        )
        x, y = (ahead - spot) / np.hypot(*(ahead - spot))
        for across in (np.array([y, -x]), np.array([-y, x])):
            line = np.stack([spot, spot + reach * across])
            clear = LineString([spot + 5.5 * across, line[1] + 2 * across]).buffer(2.0)
            apart = all(np.hypot(*(spot - other.feet[0])) > APART for other in found)
            if len(found) < DOORS and apart and plots.contains(clear):
                paved = LineString(line).buffer(PATH / 2, cap_style="flat")
                found.append(Net((spot,), 1, (line,), ((0, 1),), (1,), paved))
    return found


def footpaths(side: LineString, paving: Paving, generator: np.random.Generator) -> list[Net]:
    """Winding paths through the green on the outer side of a pavement, and out of the page.

    One runs along the road, now nearer, now further; three lead to it from the pavement, and two on
    from it. Where bends cut each other, nobody turns from one path into the other.
    """
    road = outer_kerbs(paving)
    shares = np.array([*FEET, 0.0, *FEET, 1.0])
    shares += generator.uniform(-0.1, 0.1, 8) * (shares % 1 > 0)
    deep = np.array([0.0, 0.0, 0.0, *generator.uniform(*DEEP, 5)])
    on = generator.choice((4, 5, 6), 2, replace=False)
    shares, deep = np.append(shares, shares[on]), np.append(deep, [OUT, OUT])
    nodes = [_beside(side, road, *where) for where in zip(shares, deep, strict=True)]
    # nodes: 0 to 2 on the pavement, 3 to 7 along the road, 8 and 9 beyond the page
    ends = [(0, 4), (1, 5), (2, 6), *pairwise(range(3, 8)), (int(on[0]), 8), (int(on[1]), 9)]
    lines = tuple(_winding(nodes[a], nodes[b], generator) for a, b in ends)
    paved = shapely.union_all([LineString(line).buffer(FOOTPATH / 2) for line in lines])
    return [Net(tuple(nodes[:3]), 7, lines, tuple(ends), (3, 7, 8, 9), paved)]


def _beside(side: LineString, road: Geometry, share: float, away: float) -> Float[Array, "2"]:
    """The point so many metres from a pavement, away from the road, at a share of its length."""
    before, after = (
        np.array(side.interpolate(max(share * side.length + d, 0)).coords[0]) for d in (-0.5, 0.5)
    )
    spot, across = (before + after) / 2, left_of(after - before)
    across /= np.hypot(*across)
    outwards = road.distance(Point(spot + across)) > road.distance(Point(spot - across))
    return np.asarray(spot + (away if outwards else -away) * across)


def _winding(start: Array, end: Array, generator: np.random.Generator) -> Line:
    """A quadratic Bézier curve with a bend to either side."""
    bend = 2 * generator.uniform(-BULGE, BULGE) * left_of(end - start)
    t = np.linspace(0, 1, 33)[:, None]
    middle = (start + end) / 2 + bend
    return np.asarray((1 - t) ** 2 * start + 2 * t * (1 - t) * middle + t**2 * end)
