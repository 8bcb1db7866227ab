import numpy as np
import pytest

from geoaim.mapping.georeference.transform_models import (
    distort_points,
    fit_similarity,
    undistort_points,
)
from tests.mapping.georeference.points import GRID, SIZE


def test_undistort_inverts_distort():
    there = distort_points(GRID, 0.05, **SIZE)
    np.testing.assert_allclose(undistort_points(there, 0.05, **SIZE), GRID, atol=1e-9)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_similarity_is_fitted_without_its_worst_point(mirrored):
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.2]])
    targets = points * ([2.0, -2.0] if mirrored else 2.0) + [3.0, 4.0]
    targets[4] += 1000.0
    matrix, error = fit_similarity(points, targets, mirrored=mirrored)
    np.testing.assert_allclose(matrix, [[2, 0, 3], [0, 2, 4], [0, 0, 1]], atol=1e-9)
    assert error == pytest.approx(0, abs=1e-9)
