import warnings
from dataclasses import replace

import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.base.geometry import transform_points
from geoaim.mapping.georeference import outliers
from geoaim.mapping.georeference.control_points import select_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import world_from_pixels
from geoaim.mapping.georeference.posterior import fit_posterior
from geoaim.mapping.georeference.transform_models import PointPairs
from tests.mapping.georeference.points import GRID, SIZE, TRUTH, make_points


def test_one_wrong_point_is_left_out_and_named():
    points = make_points(noise=1.0)
    points.coordinates[5] += (3.0, -2.0)
    with pytest.warns(GeoaimWarning, match="gcp5 is left out"):
        result = estimate_georeference(points, **SIZE)
    assert np.flatnonzero(~result.used).tolist() == [5]
    assert np.hypot(*result.residuals[5]) == pytest.approx(np.hypot(3, 2), abs=0.4)


def test_a_point_kilometres_off_is_left_out():
    points = make_points(noise=1.0)
    points.coordinates[2] += (4000.0, -9000.0)
    with pytest.warns(GeoaimWarning, match="gcp2 is left out"):
        result = estimate_georeference(points, **SIZE)
    np.testing.assert_allclose(
        world_from_pixels(result, GRID), transform_points(TRUTH, GRID), atol=0.3
    )


def test_two_wrong_points_are_refused_by_name():
    points = make_points(noise=1.0)
    points.coordinates[5] += (3.0, -2.0)
    points.coordinates[9] += (-3.0, -4.0)
    with pytest.raises(GeoreferenceError, match=r"contradict.*(gcp5|gcp9)"):
        estimate_georeference(points, **SIZE)


def test_points_left_on_a_line_by_a_wrong_one_are_refused():
    points = select_points(make_points(noise=1.0), [0, 1, 2, 3, 6])
    points.coordinates[4] += (400.0, -300.0)
    left_out = pytest.warns(GeoaimWarning, match="gcp6 is left out")
    with left_out, pytest.raises(GeoreferenceError, match="nearly on a line"):
        estimate_georeference(points, **SIZE)


def test_points_of_coarse_coordinates_agree_within_their_accuracy():
    refused = []
    for accuracy in (0.0, 0.4):
        refused.append(0)
        for seed in range(12):
            points = select_points(make_points(noise=8.0, seed=seed), [0, 2, 4, 6, 9, 11])
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error", GeoaimWarning)
                    estimate_georeference(replace(points, accuracy=accuracy), **SIZE)
            except (GeoreferenceError, GeoaimWarning):
                refused[-1] += 1
    assert refused[0] > 4
    assert refused[1] <= 1  # the test errs in one of 200 by design


def test_of_many_points_the_wrong_one_is_found_without_leaving_each_out(monkeypatch):
    fits = []
    monkeypatch.setattr(
        outliers, "fit_posterior", lambda *given: fits.append(1) or fit_posterior(*given)
    )
    side = np.linspace(-1, 1, 12)
    image = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    ground = image + 0.001 * np.random.default_rng(0).normal(size=image.shape)
    ground[100] += 0.1
    names = tuple(map(str, range(len(image))))
    with pytest.warns(GeoaimWarning, match="^100 is left out"):
        used = outliers.reject_outlier(names, PointPairs(image, ground), 0.001)
    assert np.flatnonzero(~used).tolist() == [100]
    assert len(fits) < len(image)
