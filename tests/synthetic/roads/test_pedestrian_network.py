from itertools import pairwise

import numpy as np
import pytest
import shapely
from shapely import LineString

from geoaim.synthetic.roads.pedestrian_network import PedestrianNetwork, WalkEdge, find_route
from geoaim.synthetic.roads.plan import make_roads


@pytest.fixture(scope="module", params=range(4))
def park(request):
    return make_roads("park", np.random.default_rng(request.param))


def test_every_spawn_node_is_reached_from_every_other(roads):
    network = roads.footpaths
    factors = np.ones(len(network.edges))
    for start in network.spawn_nodes:
        for end in network.spawn_nodes:
            if end != start:
                route = find_route(network, start, end, factors)
                assert route
                for (before, _), (after, _) in pairwise(route):
                    assert np.hypot(*(before[-1] - after[0])) < 1.0


def test_route_avoids_edges_with_a_high_factor(roads):
    network = roads.footpaths
    start, end = network.spawn_nodes[0], network.spawn_nodes[2]
    factors = np.ones(len(network.edges))
    crossed = {crossing for _, crossing in find_route(network, start, end, factors)}
    for k, edge in enumerate(network.edges):
        if edge.crossing >= 0 and edge.crossing in crossed:
            factors[k] = 100.0
    avoiding = {crossing for _, crossing in find_route(network, start, end, factors)}
    assert avoiding != crossed or not any(crossing >= 0 for crossing in crossed)


def test_route_between_unconnected_nodes_is_empty():
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    edges = WalkEdge(line, -1, 0, 1), WalkEdge(line, -1, 2, 3)
    network = PedestrianNetwork(edges, (0, 1, 2, 3), shapely.Polygon())
    assert find_route(network, 0, 3, np.ones(2)) == []


def test_all_spawn_nodes_of_a_park_are_connected(park):
    network = park.footpaths
    factors = np.ones(len(network.edges))
    for node in network.spawn_nodes[1:]:
        route = find_route(network, network.spawn_nodes[0], node, factors)
        ends = [line[[0, -1]] for line, _ in route]
        assert len(route) > 0
        for before, after in pairwise(ends):
            assert np.hypot(*(before[1] - after[0])) < 2.0  # m: ends are moved onto the pavement


def test_park_paths_lead_through_the_park_and_out_of_the_extent(park):
    green = shapely.union_all(list(park.paving.plots))
    assert park.footpaths.surface.intersection(green).area > 0.05 * green.area
    lines = [LineString(edge.line) for edge in park.footpaths.edges if edge.crossing < 0]
    off = [line for line in lines if line.intersection(green).length > 0.3 * line.length]
    assert len(off) == 2 * 9  # on both sides
    assert len(park.footpaths.spawn_nodes) == 2 * (2 + 4)  # ends of pavements and of paths
    assert park.car_park is None


def test_paths_to_doors_end_on_plots():
    roads = make_roads("junction", np.random.default_rng(2))
    green = shapely.union_all(list(roads.paving.plots))
    ends = [
        shapely.Point(edge.line[-1])
        for edge in roads.footpaths.edges
        if edge.end in roads.footpaths.spawn_nodes and edge.start not in roads.footpaths.spawn_nodes
    ]
    doors = [end for end in ends if green.contains(end)]
    assert len(doors) >= 2
    assert all(roads.footpaths.surface.distance(door) < 1e-6 for door in doors)
