import warnings

import pytest

from geoaim.bench.georeference import Cell, run_cell
from geoaim.errors import GeoaimWarning
from geoaim.geometry import image_corners
from geoaim.mapping.georeference.control_points import select_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import predict_uncertainty
from tests.mapping.georeference.points import SIZE, TILTED, make_points


def test_exact_points_still_have_an_uncertainty():
    result = estimate_georeference(select_points(make_points(TILTED), [0, 3, 8, 11]), **SIZE)
    sigma, radius = predict_uncertainty(result, image_corners(**SIZE))
    assert sigma.min() > 0.02
    assert (radius > 2.4 * sigma).all()


@pytest.mark.parametrize("layout", ["spread", "clustered"])
def test_predicted_uncertainty_covers_the_truth(layout):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeoaimWarning)
        cell = run_cell(Cell(layout, "as expected", 8), trials=25)
    assert cell["coverage"]["corners"] >= 88.0
