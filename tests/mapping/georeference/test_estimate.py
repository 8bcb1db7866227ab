from dataclasses import replace

import numpy as np
import pytest

from geoaim.base.errors import GeoreferenceError
from geoaim.base.geometry import transform_points
from geoaim.base.world import World, lonlat_from_world, transform_crs
from geoaim.mapping.georeference.control_points import select_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import world_from_pixels
from geoaim.mapping.georeference.transform_models import distort_points
from geoaim.mapping.georeference.uncertainty import map_uncertainty, predict_uncertainty
from tests.mapping.georeference.points import GRID, SIZE, TILTED, TRUTH, UTM, make_points


@pytest.mark.parametrize(("truth", "model"), [(TRUTH, "similarity"), (TILTED, "homography")])
def test_exact_points_give_the_exact_transform_by_the_simplest_model(truth, model):
    result = estimate_georeference(make_points(truth), **SIZE)
    assert result.model == model
    assert result.radial == 0.0
    np.testing.assert_allclose(
        world_from_pixels(result, GRID), transform_points(truth, GRID), atol=2e-3
    )
    assert result.used.all()
    assert result.leave_one_out.max() < 0.01


def test_a_stretched_image_needs_a_homography():
    stretched = TRUTH @ np.diag([1.0, 1.06, 1.0])
    found = estimate_georeference(make_points(stretched, noise=1.0), **SIZE)
    assert found.model == "homography"
    assert found.probabilities["homography"] > 0.99


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32635"])
def test_world_is_chosen_near_the_points(crs):
    result = estimate_georeference(make_points(crs=crs), **SIZE)
    assert result.world.crs == "EPSG:32635"
    lonlat = lonlat_from_world(result.world, world_from_pixels(result, GRID))
    np.testing.assert_allclose(lonlat, lonlat_from_world(UTM, transform_points(TRUTH, GRID)),
                               atol=1e-7)  # fmt: skip
    assert np.abs(result.world_from_image[:2, 2]).max() < 300.0


def test_a_given_world_is_kept():
    world = World("EPSG:32635", (536000.0, 5972000.0))
    result = estimate_georeference(make_points(crs="EPSG:4326"), world=world, **SIZE)
    assert result.world == world
    np.testing.assert_allclose(
        world_from_pixels(result, GRID),
        np.add(transform_points(TRUTH, GRID), (800.0, 500.0)),
        atol=1e-2,
    )


def test_lens_distortion_is_estimated_and_removed():
    bent = make_points()
    bent = replace(bent, pixels=distort_points(GRID, -0.06, **SIZE))
    result = estimate_georeference(bent, **SIZE)
    assert result.radial == pytest.approx(-0.06, abs=0.003)
    np.testing.assert_allclose(world_from_pixels(result, bent.pixels), bent.coordinates, atol=0.02)


def test_four_points_that_need_an_unusual_transform_are_refused():
    points = select_points(make_points(), [0, 3, 8, 11])
    points.coordinates[1] += (30.0, 15.0)
    with pytest.raises(GeoreferenceError, match="gcp0, gcp3, gcp8, gcp11"):
        estimate_georeference(points, **SIZE)


def test_local_points_and_a_world_with_a_crs_are_refused():
    with pytest.raises(GeoreferenceError, match="plane of their own"):
        estimate_georeference(make_points(), world=UTM, **SIZE)


def test_points_in_the_wrong_order_are_refused():
    points = make_points(noise=1.0)
    order = np.random.default_rng(1).permutation(len(GRID))
    with pytest.raises(GeoreferenceError, match=r"No place fits|mirrored|contradict"):
        estimate_georeference(replace(points, coordinates=points.coordinates[order]), **SIZE)


@pytest.mark.filterwarnings("ignore:EPSG.27700 to:geoaim.base.errors.GeoaimWarning")
def test_the_accuracy_of_the_transformation_enters_the_uncertainty():
    points = make_points()
    world = World("EPSG:32630", (530_000.0, 5_700_000.0))
    lonlat = lonlat_from_world(world, points.coordinates - points.coordinates.mean(axis=0))
    national = transform_crs("EPSG:4326", "EPSG:27700", lonlat)
    same = replace(points, coordinates=lonlat, crs="EPSG:4326")
    other = replace(points, coordinates=national, crs="EPSG:27700")
    exact, datum = (estimate_georeference(x, **SIZE, world=world) for x in (same, other))
    assert exact.datum_accuracy == 0.0
    assert datum.datum_accuracy in (1.0, 2.0)  # with the grid OSTN15 and without
    middle = np.array([[SIZE["width"] / 2, SIZE["height"] / 2]])
    sigma, bound = predict_uncertainty(datum, middle)
    assert sigma[0] >= datum.datum_accuracy
    assert bound[0] >= 2.4 * datum.datum_accuracy
    assert map_uncertainty(datum)["worst_corner_with_point_there_m"] >= 2.4
    assert predict_uncertainty(exact, middle)[1][0] < 1.0


def test_points_of_unequal_accuracy_count_by_it():
    generator = np.random.default_rng(5)
    sigma = np.where(np.arange(len(GRID)) % 2, 0.02, 0.3)[:, None]  # m
    points = make_points()
    noise = sigma * generator.normal(size=(12, 2))
    points = replace(points, coordinates=points.coordinates + noise, accuracy=0.3)
    known = replace(points, information=np.eye(2) / sigma[:, :, None] ** 2)
    errors, stated = [], []
    for some in (points, known):
        found = estimate_georeference(some, **SIZE)
        offset = world_from_pixels(found, GRID) - transform_points(TRUTH, GRID)
        errors.append(np.linalg.norm(offset, axis=1).mean())
        stated.append(predict_uncertainty(found, GRID)[1].mean())
    assert errors[1] < 0.5 * errors[0]
    assert stated[1] < 0.5 * stated[0]


def test_equal_information_changes_nothing_and_redundancy_widens_the_statement():
    points = make_points(noise=1.0)
    alike = replace(points, information=np.broadcast_to(7.0 * np.eye(2), (12, 2, 2)))
    plain, equal, redundant = (
        estimate_georeference(some, **SIZE)
        for some in (points, alike, replace(points, redundancy=3.0))
    )
    np.testing.assert_allclose(equal.world_from_image, plain.world_from_image, rtol=1e-9)
    np.testing.assert_allclose(equal.leave_one_out, plain.leave_one_out, rtol=1e-6)
    once, thrice = (predict_uncertainty(one, GRID)[1] for one in (plain, redundant))
    np.testing.assert_allclose(thrice, np.sqrt(3.0) * once, rtol=1e-2)


def test_a_common_error_moves_nothing_and_widens_the_statement_everywhere():
    points = make_points(noise=1.0)
    plain, common = (
        estimate_georeference(some, **SIZE) for some in (points, replace(points, common_error=0.5))
    )
    np.testing.assert_array_equal(common.world_from_image, plain.world_from_image)
    sigma, wider = (predict_uncertainty(one, GRID)[0] for one in (plain, common))
    np.testing.assert_allclose(wider, np.hypot(sigma, 0.5), rtol=1e-2)


def test_a_further_point_is_not_promised_to_be_better_than_picking():
    corner = GRID[[0, 1, 4, 5]] / 2  # exact, so that their own noise looks like nothing
    found = map_uncertainty(estimate_georeference(make_points(pixels=corner), **SIZE))
    assert found["worst_corner_with_point_there_m"] > 2 * 0.5 * 0.05  # two sigma of half a pixel
