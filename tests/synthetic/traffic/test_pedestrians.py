import numpy as np
import shapely

from geoaim.synthetic.traffic.pedestrians import CELL_M, make_pavement_map, sample_pavement


def test_distance_is_that_to_the_edge_of_the_pavement(roads):
    pavement = make_pavement_map(roads)
    middle = next(edge.line for edge in roads.footpaths.edges if edge.crossing < 0)
    points = middle[roads.extent.buffer(5.0).covers(shapely.points(middle))]
    parts = [roads.paving.pavement, roads.paving.driveway, roads.footpaths.surface]
    edge = shapely.union_all(parts).boundary
    distance, inwards = sample_pavement(pavement, points)
    np.testing.assert_allclose(distance, edge.distance(shapely.points(points)), atol=2 * CELL_M)
    assert np.hypot(*inwards.T).max() < 1.01


def test_distance_is_zero_on_the_road(roads):
    distance, _ = sample_pavement(make_pavement_map(roads), roads.lanes[0].centreline)
    assert (distance[-20:] == 0).all()
