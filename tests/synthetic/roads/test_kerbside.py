import numpy as np
import pytest
import shapely
from shapely import LineString
from shapely.affinity import rotate
from shapely.geometry import box

from geoaim.synthetic.roads.kerbside import driven, parked
from geoaim.synthetic.roads.plan import arm_named, make_roads
from geoaim.synthetic.traffic.ways import make_ways

LENGTH, WIDTH = 4.7, 1.8  # m, of the longest parked cars
VAN = 2.1  # m, width of what drives past


@pytest.fixture(scope="module", params=range(6))
def street(request):
    return make_roads("kerbside", np.random.default_rng(request.param))


def cars(roads):
    found = []
    for row in roads.parked:
        places, headings = parked(row, arm_named(roads.layout, row.arm))
        for (x, y), heading in zip(places, headings, strict=True):
            car = box(x - LENGTH / 2, y - WIDTH / 2, x + LENGTH / 2, y + WIDTH / 2)
            found.append(rotate(car, heading, use_radians=True))
    return found


def test_cars_stand_on_the_carriageway_apart_from_each_other_and_from_the_crossing(street):
    standing = cars(street)
    assert len(standing) == sum(row.cars for row in street.parked) > 4
    apart = shapely.distance(standing[:-1], standing[1:])
    assert apart.min() > 0.3
    for car in standing:
        assert street.paving.carriageway.contains(car) or not street.page.contains(car)
        assert car.centroid.distance(shapely.Point(0, 0)) > 12.0


def test_no_way_leads_through_a_parked_car_and_lanes_do(street):
    standing = shapely.union_all(cars(street))
    ways = [LineString(way.line).buffer(VAN / 2) for way in make_ways(street)]
    assert all(way.distance(standing) > 0.3 for way in ways)
    lanes = [LineString(lane.centre).buffer(VAN / 2) for lane in street.lanes]
    assert any(lane.intersects(standing) for lane in lanes)


def test_ways_of_opposite_directions_never_come_close(street):
    there, back = (LineString(way.line) for way in make_ways(street))
    apart = shapely.distance(shapely.points(there.coords), back)
    assert apart.min() > 2.8


def test_ways_stay_in_the_middle_of_lanes_where_nobody_parks(street):
    roads = make_roads("street", np.random.default_rng(0))
    for lane in roads.lanes:
        assert driven(lane, roads.layout.arms, roads.parked) is lane.centre
    for lane in street.lanes:
        line = LineString(driven(lane, street.layout.arms, street.parked))
        away = shapely.distance(shapely.points(lane.centre), line)
        assert away.max() < 1.25
        assert (away < 0.02).mean() > 0.1
