"""The network that pedestrians walk on: pavements, crossings, footpaths; and routes over it."""

from dataclasses import dataclass
from itertools import pairwise

import networkx as nx
import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString, Point, Polygon
from shapely.ops import substring

from benchmarks.synthetic.roads.curves import Polyline, resample_polyline, rotate_90
from benchmarks.synthetic.roads.paving import VERGE_WIDTH_M, Crossing, Paving, outline_road

SPAWN_MARGIN_M = 8.0  # outside the drawn extent, where pavements end
MIN_PAVEMENT_M = 20.0  # shorter pieces within the extent are left out
NODE_TOLERANCE_M = 0.5  # positions on a pavement that are closer share a node
DOOR_PATH_WIDTH_M = 2.0
DOOR_DISTANCE_M = (9.0, 16.0)  # distance from the middle of a pavement to a door
MAX_DOORS = 2  # doors along a pavement
MIN_DOOR_SPACING_M = 15.0
DOOR_TRIALS = 12
PARK_PATH_WIDTH_M = 3.0
PARK_ENTRANCES = (0.2, 0.5, 0.8)  # shares of a pavement's length, about
PARK_DEPTH_M = (12.0, 30.0)  # distance from the pavement to where park paths meet
PARK_EXIT_M = 60.0  # distance from the pavement to the ends of park paths, outside the drawn extent
MAX_BULGE = 0.2  # how far a park path leaves the straight line, as a share of its length


@dataclass(frozen=True)
class WalkEdge:
    """An edge of the pedestrian network, walked in either direction."""

    line: Polyline  # equally spaced points, plan metres
    crossing: int  # index of the crossing that it leads over; -1: a pavement or footpath
    start: int  # node at its start
    end: int  # node at its end


@dataclass(frozen=True, eq=False)
class PedestrianNetwork:
    """What pedestrians walk on."""

    edges: tuple[WalkEdge, ...]  # pavements, crossings and footpaths between nodes
    # nodes where pedestrians enter and leave: outside the extent, doors, ends of paths
    spawn_nodes: tuple[int, ...]
    surface: Geometry  # the paved ground of the footpaths


@dataclass(frozen=True, eq=False)
class _Footpaths:
    """Connected footpaths off a pavement; their nodes are numbered, those on the pavement first."""

    # points where they leave the pavement, plan metres
    pavement_nodes: tuple[Float[Array, "2"], ...]
    other_nodes: int  # number of further nodes
    lines: tuple[Polyline, ...]
    ends: tuple[tuple[int, int], ...]  # nodes at the start and end of each line
    spawn_nodes: tuple[int, ...]  # nodes where pedestrians enter and leave
    surface: Geometry  # the paved ground


@dataclass(frozen=True)
class _Junctions:
    """Positions where something joins a pavement: pavement, metres along it, and node of each."""

    pavement: list[int]
    s: list[float]
    node: list[int]


def make_pedestrian_network(
    paving: Paving,
    crossings: tuple[Crossing, ...],
    extent: Polygon,
    pavement_width: float,
    generator: np.random.Generator,
    *,
    park: bool = False,
) -> PedestrianNetwork:
    """Connect the pavements by crossings, and add footpaths off them.

    Args:
        paving: surfaces of the place, plan metres.
        crossings: crossings of the roads and of the driveway.
        extent: the part of the plan that is drawn.
        pavement_width: metres.
        generator: draws where footpaths lie.
        park: whether footpaths lead through a park, not to doors.

    Returns:
        The network.
    """
    road = outline_road(paving)
    pavements = _cut_pavements(road, extent, pavement_width)
    draw_paths = _draw_park_paths if park else _draw_door_paths
    groups = [draw_paths(line, paving, generator) for line in pavements]
    paths = [group for on_pavement in groups for group in on_pavement]
    junctions = _join_pavements(pavements, crossings, paths)
    first = 2 * len(pavements)  # junction of the first crossing's first end
    edges = _make_crossing_edges(pavements, crossings, junctions)
    edges += _make_pavement_edges(pavements, crossings, junctions)
    spawn_nodes = junctions.node[:first]
    used, free = first + 2 * len(crossings), len(junctions.node) + 2 * len(crossings)
    for group in paths:
        count = len(group.pavement_nodes)
        nodes = [*junctions.node[used : used + count], *range(free, free + group.other_nodes)]
        used, free = used + count, free + group.other_nodes
        spawn_nodes += [nodes[k] for k in group.spawn_nodes]
        edges += [
            WalkEdge(resample_polyline(line), -1, nodes[a], nodes[b])
            for line, (a, b) in zip(group.lines, group.ends, strict=True)
        ]
    paved = shapely.union_all([road, paving.pavement])
    surface = shapely.union_all([group.surface for group in paths]).difference(paved)
    return PedestrianNetwork(tuple(edges), tuple(spawn_nodes), surface)


def find_route(
    network: PedestrianNetwork, start: int, end: int, factors: Float[Array, "E"]
) -> list[tuple[Polyline, int]]:
    """Find the shortest route between two nodes.

    Args:
        network: a network with E edges.
        start: a node.
        end: a node.
        factors: (E,) factors by which the lengths of the edges are multiplied.

    Returns:
        The line (plan metres) of each edge in the direction of travel, and the index of its
        crossing (-1: none); empty if there is no route.
    """
    graph = nx.MultiGraph()
    for edge, factor in zip(network.edges, factors, strict=True):
        graph.add_edge(edge.start, edge.end, cost=len(edge.line) * factor, edge=edge)
    try:
        nodes = nx.dijkstra_path(graph, start, end, weight="cost")
    except nx.NetworkXNoPath:
        return []
    route = []
    for a, b in pairwise(nodes):
        edge = min(graph[a][b].values(), key=lambda attributes: attributes["cost"])["edge"]
        route.append((edge.line if edge.end == b else edge.line[::-1], edge.crossing))
    return route


def _cut_pavements(road: Polygon, extent: Polygon, pavement_width: float) -> list[LineString]:
    """The middles of the pavements, as far as pedestrians are simulated."""
    middle = road.buffer((VERGE_WIDTH_M + pavement_width) / 2, quad_segs=16).exterior
    inside = shapely.line_merge(middle.intersection(extent.buffer(SPAWN_MARGIN_M)))
    return [line for line in shapely.get_parts(inside) if line.length > MIN_PAVEMENT_M]


def _join_pavements(
    pavements: list[LineString], crossings: tuple[Crossing, ...], paths: list[_Footpaths]
) -> _Junctions:
    """Junctions at both ends of each pavement, of each crossing, and where footpaths leave."""
    pavement = [index for index in range(len(pavements)) for _ in range(2)]
    s = [end for line in pavements for end in (0.0, line.length)]
    points = [end for crossing in crossings for end in crossing.ends]
    for point in [*points, *(node for group in paths for node in group.pavement_nodes)]:
        nearest = int(np.argmin([line.distance(Point(point)) for line in pavements]))
        pavement.append(nearest)
        s.append(float(pavements[nearest].project(Point(point))))
    node: list[int] = []
    for k in range(len(s)):
        same = (j for j in range(k) if pavement[j] == pavement[k])
        near = next((j for j in same if abs(s[j] - s[k]) < NODE_TOLERANCE_M), None)
        node.append(k if near is None else node[near])
    return _Junctions(pavement, s, node)


def _make_crossing_edges(
    pavements: list[LineString], crossings: tuple[Crossing, ...], junctions: _Junctions
) -> list[WalkEdge]:
    """For each crossing between two pavements: to the kerb, over the road, from the kerb."""
    edges = []
    for number, crossing in enumerate(crossings):
        pair = [2 * (len(pavements) + number) + k for k in range(2)]
        if junctions.pavement[pair[0]] == junctions.pavement[pair[1]]:
            continue
        kerbs = [len(junctions.node) + 2 * number + k for k in range(2)]
        edges.append(WalkEdge(resample_polyline(crossing.ends), number, *kerbs))
        for k, kerb, end in zip(pair, kerbs, crossing.ends, strict=True):
            pavement = pavements[junctions.pavement[k]]
            start = np.array(pavement.interpolate(junctions.s[k]).coords[0])
            line = resample_polyline(np.stack([start, end]))
            edges.append(WalkEdge(line, -1, junctions.node[k], kerb))
    return edges


def _make_pavement_edges(
    pavements: list[LineString], crossings: tuple[Crossing, ...], junctions: _Junctions
) -> list[WalkEdge]:
    """The pavements, split at all junctions; some pieces are crossings of a driveway."""
    crossing_of = {}
    for number in range(len(crossings)):
        a, b = (2 * (len(pavements) + number) + k for k in range(2))
        if junctions.pavement[a] == junctions.pavement[b]:
            crossing_of[frozenset((junctions.node[a], junctions.node[b]))] = number
    edges = []
    for index, pavement in enumerate(pavements):
        nodes = [k for k in set(junctions.node) if junctions.pavement[k] == index]
        for (start, a), (end, b) in pairwise(sorted((junctions.s[k], k) for k in nodes)):
            line = resample_polyline(np.array(substring(pavement, start, end).coords))
            edges.append(WalkEdge(line, crossing_of.get(frozenset((a, b)), -1), a, b))
    return edges


def _draw_door_paths(
    pavement: LineString, paving: Paving, generator: np.random.Generator
) -> list[_Footpaths]:
    """Straight footpaths to at most `MAX_DOORS` doors, where the plots have room for them."""
    plots = shapely.union_all(list(paving.plots))
    paths: list[_Footpaths] = []
    shares = generator.uniform(0.1, 0.9, DOOR_TRIALS)
    lengths = generator.uniform(*DOOR_DISTANCE_M, DOOR_TRIALS)
    for share, length in zip(shares, lengths, strict=True):
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
                paths.append(_Footpaths((start,), 1, (line,), ((0, 1),), (1,), paved))
    return paths


def _draw_park_paths(
    pavement: LineString, paving: Paving, generator: np.random.Generator
) -> list[_Footpaths]:
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
    return [_Footpaths(tuple(nodes[:3]), 7, lines, tuple(ends), (3, 7, 8, 9), paved)]


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
