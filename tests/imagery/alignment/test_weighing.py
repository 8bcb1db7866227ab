import numpy as np

from geoaim.base.geometry import translation
from geoaim.imagery.alignment.result import ImageryAlignment
from geoaim.imagery.alignment.weighing import forget_undetermined_direction, weigh_alignment

SHIFT = np.array([5.0, 2.0])


def _align(covariance):
    return ImageryAlignment(translation(*SHIFT), "translation", covariance, np.zeros(2))


def test_sure_reference_moves_all_the_way():
    moved, covariance = weigh_alignment(_align(np.eye(2) * 1e-6), np.eye(2) * 56, np.eye(2) * 1e-6)
    np.testing.assert_allclose(moved.shift, SHIFT, atol=1e-5)
    np.testing.assert_allclose(covariance, 2e-6 * np.eye(2), rtol=1e-3, atol=1e-12)


def test_imagery_stays_along_the_road_where_the_reference_is_unsure():
    moved, covariance = weigh_alignment(_align(np.eye(2) * 1e-6), np.eye(2), np.diag([1e-6, 100.0]))
    np.testing.assert_allclose(moved.shift, [5.0, 2.0 / 101], atol=1e-3)
    np.testing.assert_allclose(np.diag(covariance), [2e-6, 100 / 101], rtol=1e-3)


def test_weights_are_those_of_gaussian_products():
    generator = np.random.default_rng(1)
    own, reference, relative = (matrix @ matrix.T for matrix in generator.normal(size=(3, 2, 2)))
    moved, covariance = weigh_alignment(_align(relative), own, reference)
    precision = np.linalg.inv(own) + np.linalg.inv(reference + relative)
    np.testing.assert_allclose(covariance, np.linalg.inv(precision))
    expected = covariance @ np.linalg.inv(reference + relative) @ SHIFT
    np.testing.assert_allclose(moved.shift, expected)


def test_undetermined_direction_has_no_weight():
    alignment = forget_undetermined_direction(_align(np.diag([0.04, 25.0])))
    moved, covariance = weigh_alignment(alignment, np.eye(2) * 4, np.zeros((2, 2)))
    np.testing.assert_allclose(moved.shift, [5 * 4 / 4.04, 0.0], atol=1e-3)
    np.testing.assert_allclose(covariance[1, 1], 4.0, rtol=1e-3)
    known = _align(np.eye(2) * 0.04)
    assert forget_undetermined_direction(known) is known
