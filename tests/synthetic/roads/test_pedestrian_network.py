from itertools import pairwise

import numpy as np
import shapely

from geoaim.synthetic.roads.pedestrian_network import PedestrianNetwork, WalkEdge, find_route


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
