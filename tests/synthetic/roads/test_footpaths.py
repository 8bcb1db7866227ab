from itertools import pairwise

import numpy as np
import pytest
import shapely
from shapely import LineString

from geoaim.synthetic.roads.pedestrian_network import find_route
from geoaim.synthetic.roads.plan import make_roads


@pytest.fixture(scope="module", params=range(4))
def park(request):
    return make_roads("park", np.random.default_rng(request.param))


def test_all_gates_of_a_park_can_be_walked_to(park):
    walks = park.footpaths
    even = np.ones(len(walks.edges))
    for gate in walks.spawn_nodes[1:]:
        legs = find_route(walks, walks.spawn_nodes[0], gate, even)
        ends = [line[[0, -1]] for line, _ in legs]
        assert len(legs) > 0
        for before, after in pairwise(ends):
            assert np.hypot(*(before[1] - after[0])) < 2.0  # m: feet are moved onto the pavement


def test_footpaths_lead_through_the_green_and_out_of_the_page(park):
    green = shapely.union_all(list(park.paving.plots))
    assert park.footpaths.surface.intersection(green).area > 0.05 * green.area
    lines = [LineString(leg.line) for leg in park.footpaths.edges if leg.crossing < 0]
    off = [line for line in lines if line.intersection(green).length > 0.3 * line.length]
    assert len(off) == 2 * 9  # on both sides
    assert len(park.footpaths.spawn_nodes) == 2 * (2 + 4)  # ends of pavements and of paths
    assert park.car_park is None


def test_paths_to_doors_end_among_the_plots():
    roads = make_roads("junction", np.random.default_rng(2))
    green = shapely.union_all(list(roads.paving.plots))
    ends = [
        shapely.Point(leg.line[-1])
        for leg in roads.footpaths.edges
        if leg.end in roads.footpaths.spawn_nodes and leg.start not in roads.footpaths.spawn_nodes
    ]
    doors = [end for end in ends if green.contains(end)]
    assert len(doors) >= 2
    assert all(roads.footpaths.surface.distance(door) < 1e-6 for door in doors)
