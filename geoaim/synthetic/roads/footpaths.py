"""Footpaths off the pavements: straight ones to doors, winding ones through a park."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString, Point

from geoaim.synthetic.roads.curves import Polyline, rotate_90
from geoaim.synthetic.roads.paving import Paving, outline_road

DOOR_PATH_WIDTH_M = 2.0
DOOR_DISTANCE_M = (9.0, 16.0)  # from the middle of a pavement to a door
MAX_DOORS = 2  # along a pavement
MIN_DOOR_SPACING_M = 15.0
DOOR_TRIALS = 12
PARK_PATH_WIDTH_M = 3.0
PARK_ENTRANCES = (0.2, 0.5, 0.8)  # shares of a pavement's length, about
PARK_DEPTH_M = (12.0, 30.0)  # from the pavement to where park paths meet
PARK_EXIT_M = 60.0  # from the pavement to the ends of park paths, outside the drawn extent
MAX_BULGE = 0.2  # of its length, by which a park path leaves the straight line


@dataclass(frozen=True, eq=False)
class Footpaths:
    """Connected footpaths off a pavement.

    Nodes are numbered: first those on the pavement, then the others.

    Attributes:
        pavement_nodes: where the footpaths leave the pavement, plan metres.
        other_nodes: number of further nodes.
        lines: the footpaths.
        ends: the nodes at the start and end of each.
        spawn_nodes: nodes where pedestrians enter and leave.
        surface: the paved ground.
    """

    pavement_nodes: tuple[Float[Array, "2"], ...]
    other_nodes: int
    lines: tuple[Polyline, ...]
    ends: tuple[tuple[int, int], ...]
    spawn_nodes: tuple[int, ...]
    surface: Geometry


def draw_footpaths(
    pavement: LineString, paving: Paving, generator: np.random.Generator, *, park: bool
) -> list[Footpaths]:
    """Draw the footpaths off a pavement.

    Args:
        pavement: its middle.
        paving: surfaces of the place.
        generator: of the footpaths.
        park: whether they lead through a park, not to doors.

    Returns:
        Groups of footpaths that are not connected to each other.
    """
    draw = _draw_park_paths if park else _draw_door_paths
    return draw(pavement, paving, generator)


def _draw_door_paths(
    pavement: LineString, paving: Paving, generator: np.random.Generator
) -> list[Footpaths]:
    """Straight footpaths to at most `MAX_DOORS` doors, where the plots have room for them."""
    plots = shapely.union_all(list(paving.plots))
    paths: list[Footpaths] = []
    for share, length in zip(
        generator.uniform(0.1, 0.9, DOOR_TRIALS),
        generator.uniform(*DOOR_DISTANCE_M, DOOR_TRIALS),
        strict=True,
    ):
        s = share * pavement.length
        start, ahead = (np.array(pavement.interpolate(s + d).coords[0]) for d in (0.0, 0.5))
        left = rotate_90((ahead - start) / np.hypot(*(ahead - start)))
        for across in (-left, left):
            line = np.stack([start, start + length * across])
            needed = LineString([start + 5.5 * across, line[1] + 2 * across]).buffer(2.0)
            spacings = [np.hypot(*(start - path.pavement_nodes[0])) for path in paths]
            is_apart = all(spacing > MIN_DOOR_SPACING_M for spacing in spacings)
            if len(paths) < MAX_DOORS and is_apart and plots.contains(needed):
                paved = LineString(line).buffer(DOOR_PATH_WIDTH_M / 2, cap_style="flat")
                paths.append(Footpaths((start,), 1, (line,), ((0, 1),), (1,), paved))
    return paths


def _draw_park_paths(
    pavement: LineString, paving: Paving, generator: np.random.Generator
) -> list[Footpaths]:
    """Winding footpaths through the park beside a pavement.

    One runs along the road, at a varying distance; three connect it to the pavement, and two lead
    from it out of the drawn extent. Where two bends intersect there is no node.
    """
    road = outline_road(paving)
    shares = np.array([*PARK_ENTRANCES, 0.0, *PARK_ENTRANCES, 1.0])
    shares += generator.uniform(-0.1, 0.1, 8) * (shares % 1 > 0)
    depths = np.array([0.0, 0.0, 0.0, *generator.uniform(*PARK_DEPTH_M, 5)])
    exits = generator.choice((4, 5, 6), 2, replace=False)
    shares = np.append(shares, shares[exits])
    depths = np.append(depths, [PARK_EXIT_M, PARK_EXIT_M])
    nodes = [_locate_off_pavement(pavement, road, *at) for at in zip(shares, depths, strict=True)]
    # nodes: 0 to 2 on the pavement, 3 to 7 along the road, 8 and 9 outside the extent
    ends = [(0, 4), (1, 5), (2, 6), *pairwise(range(3, 8))]
    ends += [(int(exits[0]), 8), (int(exits[1]), 9)]
    lines = tuple(_draw_bend(nodes[a], nodes[b], generator) for a, b in ends)
    paved = shapely.union_all([LineString(line).buffer(PARK_PATH_WIDTH_M / 2) for line in lines])
    return [Footpaths(tuple(nodes[:3]), 7, lines, tuple(ends), (3, 7, 8, 9), paved)]


def _locate_off_pavement(
    pavement: LineString, road: Geometry, share: float, depth: float
) -> Float[Array, "2"]:
    """The point `depth` metres off a pavement, away from the road, at a share of its length."""
    s = share * pavement.length
    before, after = (np.array(pavement.interpolate(max(s + d, 0)).coords[0]) for d in (-0.5, 0.5))
    point, left = (before + after) / 2, rotate_90(after - before)
    left /= np.hypot(*left)
    is_left = road.distance(Point(point + left)) > road.distance(Point(point - left))
    return np.asarray(point + (depth if is_left else -depth) * left)


def _draw_bend(start: Array, end: Array, generator: np.random.Generator) -> Polyline:
    """A quadratic Bézier curve that bends to either side."""
    bend = 2 * generator.uniform(-MAX_BULGE, MAX_BULGE) * rotate_90(end - start)
    t = np.linspace(0, 1, 33)[:, None]
    middle = (start + end) / 2 + bend
    return np.asarray((1 - t) ** 2 * start + 2 * t * (1 - t) * middle + t**2 * end)
