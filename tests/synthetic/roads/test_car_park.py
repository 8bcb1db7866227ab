import numpy as np

from geoaim.synthetic.roads.approaches import Approach
from geoaim.synthetic.roads.car_park import make_car_park, make_manoeuvres, outline_car_park_part

EAST = Approach("east", 0.0, 0.0, ("S",), 1)


def test_car_park_lies_right_of_the_outbound_lanes():
    car_park = make_car_park(EAST, 40.0)
    outline = outline_car_park_part(car_park, (-3.0, 3.0), (0.0, 10.0))
    np.testing.assert_allclose(outline[0], [37.0, -EAST.half_width], atol=1e-9)
    np.testing.assert_allclose(outline[2], [43.0, -EAST.half_width - 10.0], atol=1e-9)


def test_each_open_bay_has_a_path_into_it_and_one_out_of_it():
    car_park = make_car_park(EAST, 40.0)
    names = [manoeuvre.name for manoeuvre in make_manoeuvres(car_park, EAST)]
    assert names == [f"{way} bay {k}" for k in car_park.open_bays for way in ("into", "out of")]


def test_vehicles_reverse_out_of_a_bay_and_drive_away_forward():
    out = make_manoeuvres(make_car_park(EAST, 40.0), EAST)[1]
    assert not out.forward[0]
    assert out.forward[-1]
    assert np.diff(out.forward.astype(int)).sum() == 1
