import pytest

from geoaim.base.errors import GeoaimWarning
from geoaim.base.geometry import image_corners
from geoaim.mapping.georeference.control_points import select_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.uncertainty import map_uncertainty, predict_uncertainty
from tests.mapping.georeference.points import SIZE, TILTED, make_points


def test_exact_points_still_have_an_uncertainty():
    with pytest.warns(GeoaimWarning, match=r"the camera is tilted, or a point is wrong"):
        result = estimate_georeference(select_points(make_points(TILTED), [0, 3, 8, 11]), **SIZE)
    sigma, radius = predict_uncertainty(result, image_corners(**SIZE))
    assert sigma.min() > 0.02
    assert (radius > 2.4 * sigma).all()


def test_the_map_names_the_worst_corner_and_a_point_there_helps():
    points = make_points(TILTED, noise=1.0)
    few = select_points(points, [0, 1, 2, 4, 5, 6, 8, 9])
    result = estimate_georeference(few, **SIZE)
    found, corners = map_uncertainty(result), image_corners(**SIZE)
    worst = found["worst_corner_m"]
    assert worst == pytest.approx(predict_uncertainty(result, corners)[1].max())
    assert found["worst_corner"].endswith("right")
    assert found["middle_m"] < found["median_m"] < worst
    assert found["worst_corner_with_point_there_m"] < 0.7 * worst
    assert found["median_with_point_there_m"] < found["median_m"]
