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

from geoaim.synthetic.roads.curves import Polyline, resample_polyline
from geoaim.synthetic.roads.footpaths import Footpaths, draw_footpaths
from geoaim.synthetic.roads.paving import VERGE_WIDTH_M, Crossing, Paving, outline_road

SPAWN_MARGIN_M = 8.0  # outside the drawn extent, where pavements end
MIN_PAVEMENT_M = 20.0  # shorter pieces within the extent are left out
NODE_TOLERANCE_M = 0.5  # positions on a pavement that are closer share a node


@dataclass(frozen=True)
class WalkEdge:
    """An edge of the pedestrian network, walked in either direction.

    Attributes:
        line: equally spaced points, plan metres.
        crossing: index of the crossing that it leads over; -1: a pavement or footpath.
        start: node at its start.
        end: node at its end.
    """

    line: Polyline
    crossing: int
    start: int
    end: int


@dataclass(frozen=True, eq=False)
class PedestrianNetwork:
    """What pedestrians walk on.

    Attributes:
        edges: pavements, crossings and footpaths between nodes.
        spawn_nodes: where pedestrians enter and leave: outside the extent, doors, ends of paths.
        surface: the paved ground of the footpaths.
    """

    edges: tuple[WalkEdge, ...]
    spawn_nodes: tuple[int, ...]
    surface: Geometry


@dataclass(frozen=True)
class _Junctions:
    """Positions where something joins a pavement (J of them).

    Attributes:
        pavement: index of the pavement.
        s: metres along the pavement.
        node: node at the position.
    """

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
        paving: surfaces.
        crossings: of the roads and the driveway.
        extent: the part of the plan that is drawn.
        pavement_width: metres.
        generator: of the footpaths.
        park: whether footpaths lead through a park, not to doors.

    Returns:
        The network.
    """
    road = outline_road(paving)
    pavements = _cut_pavements(road, extent, pavement_width)
    groups = [draw_footpaths(line, paving, generator, park=park) for line in pavements]
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
        network: with E edges.
        start: a node.
        end: a node.
        factors: (E,) by which the length of each edge is multiplied.

    Returns:
        The line of each edge in the direction of travel, and its crossing (-1: none); empty if
        there is no route.
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
    pavements: list[LineString], crossings: tuple[Crossing, ...], paths: list[Footpaths]
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
