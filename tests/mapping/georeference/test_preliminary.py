from dataclasses import replace

import numpy as np
import pytest

from geoaim.base.errors import GeoreferenceError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.mapping.georeference.control_points import select_points
from geoaim.mapping.georeference.estimate import estimate_preliminary
from geoaim.mapping.georeference.uncertainty import predict_uncertainty
from tests.mapping.georeference.points import SIZE, TILTED, TRUTH, make_points


@pytest.mark.parametrize("chosen", [[0, 11], [0, 3, 9], [0, 1, 2, 3]])
def test_exact_points_of_a_similarity_give_it(chosen):
    found = estimate_preliminary(select_points(make_points(), chosen), **SIZE)
    corners = image_corners(**SIZE)
    expected = transform_points(TRUTH, corners)
    places = transform_points(found.world_from_image, corners) + found.world.origin
    np.testing.assert_allclose(places, expected, atol=1e-6)
    assert found.approximate
    assert found.model == "similarity"
    np.testing.assert_allclose(found.residuals, 0.0, atol=1e-9)


def test_its_uncertainty_holds_the_error_of_tilted_frames():
    corners = image_corners(**SIZE)
    held = []
    for seed in range(40):
        points = select_points(make_points(TILTED, noise=2.0, seed=seed), [0, 3, 9])
        found = estimate_preliminary(points, **SIZE)
        places = transform_points(found.world_from_image, corners) + found.world.origin
        error = np.linalg.norm(places - transform_points(TILTED, corners), axis=1)
        held.append(error <= predict_uncertainty(found, corners)[1])
    assert np.mean(held) > 0.9


def test_one_point_and_repeated_points_are_refused():
    points = make_points()
    with pytest.raises(GeoreferenceError, match="1 control points were given; 2 are needed"):
        estimate_preliminary(select_points(points, [0]), **SIZE)
    with pytest.raises(GeoreferenceError, match="gcp0, gcp1 have the same pixel"):
        estimate_preliminary(replace(points, pixels=points.pixels[[0] * 12]), **SIZE)
