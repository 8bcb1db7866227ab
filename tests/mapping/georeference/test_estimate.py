import warnings
from dataclasses import replace

import numpy as np
import pytest

from geoaim.bench.georeference import HEIGHT, WIDTH, run_cell
from geoaim.errors import GeoaimWarning, GeoreferenceError
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import (
    distort_points,
    georeference,
    predict_uncertainty,
    undistort_points,
    world_points,
)
from geoaim.mapping.georeference.from_telemetry import approximate_georeference, local_georeference
from geoaim.mapping.georeference.transform_models import (
    apply,
    ellipse_factor,
    fit_candidates,
    fit_posterior,
    fit_terms,
)
from geoaim.world import World, lonlat_from_world, world_from_lonlat

SIZE = {"height": HEIGHT, "width": WIDTH}
GRID = np.stack(np.meshgrid([150.0, 700, 1250, 1800], [120.0, 520, 950]), -1).reshape(-1, 2)
TURN = 0.05 * np.array([[np.cos(0.5), np.sin(0.5)], [np.sin(0.5), -np.cos(0.5)]])
TRUTH = np.block([[TURN, np.array([[30.0], [-20.0]])], [np.zeros((1, 2)), np.ones((1, 1))]])
TILTED = TRUTH @ np.array([[1.0, 0, 0], [0, 1, 0], [6e-5, -3e-5, 1]])
UTM = World("EPSG:32635", (536800.0, 5972500.0))


def made(truth=TRUTH, pixels=GRID, noise=0.0, crs=None, seed=0):
    generator = np.random.default_rng(seed)
    coordinates = transform_points(truth, pixels)
    if crs == "EPSG:32635":
        coordinates = coordinates + UTM.origin
    elif crs == "EPSG:4326":
        coordinates = lonlat_from_world(UTM, coordinates)
    picked = pixels + noise * generator.normal(size=pixels.shape)
    count = len(pixels)
    names = tuple(f"gcp{i}" for i in range(count))
    return ControlPoints(picked, coordinates, crs, names, (None,) * count)


def only(points, indices):
    names = tuple(points.names[i] for i in indices)
    return replace(
        points, pixels=points.pixels[indices], coordinates=points.coordinates[indices],
        names=names, frames=(None,) * len(names),
    )  # fmt: skip


@pytest.mark.parametrize(("truth", "model"), [(TRUTH, "similarity"), (TILTED, "homography")])
def test_exact_points_give_the_exact_transform_by_the_least_model(truth, model):
    result = georeference(made(truth), **SIZE)
    assert result.model == model
    assert result.radial == 0.0
    np.testing.assert_allclose(world_points(result, GRID), transform_points(truth, GRID), atol=2e-3)
    assert result.used.all()
    assert result.leave_one_out.max() < 0.01


def test_a_stretched_image_is_affine():
    stretched = TRUTH @ np.diag([1.0, 1.06, 1.0])
    assert georeference(made(stretched, noise=1.0), **SIZE).model == "affine"


def test_no_error_is_never_claimed():
    result = georeference(only(made(TILTED), [0, 3, 8, 11]), **SIZE)
    sigma, radius = predict_uncertainty(result, image_corners(**SIZE))
    assert sigma.min() > 0.02
    assert (radius > 2.4 * sigma).all()


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32635"])
def test_world_is_chosen_near_the_points(crs):
    result = georeference(made(crs=crs), **SIZE)
    assert result.world.crs == "EPSG:32635"
    lonlat = lonlat_from_world(result.world, world_points(result, GRID))
    np.testing.assert_allclose(lonlat, lonlat_from_world(UTM, transform_points(TRUTH, GRID)),
                               atol=1e-7)  # fmt: skip
    assert np.abs(result.world_from_image[:2, 2]).max() < 300.0


def test_a_given_world_is_kept():
    world = World("EPSG:32635", (536000.0, 5972000.0))
    result = georeference(made(crs="EPSG:4326"), world=world, **SIZE)
    assert result.world == world
    np.testing.assert_allclose(
        world_points(result, GRID), np.add(transform_points(TRUTH, GRID), (800.0, 500.0)), atol=1e-2
    )


def test_leave_one_out_agrees_with_a_true_refit():
    generator = np.random.default_rng(3)
    points = generator.uniform(-0.7, 0.7, (9, 2))
    targets = points + 1e-3 * generator.normal(size=(9, 2))
    posterior = fit_posterior(points, targets, 1e-3, 2.0)
    ridge = posterior.precision * posterior.noise**2
    for candidate, size in zip(fit_candidates(points, targets, posterior), (4, 6, 8), strict=True):
        keep = np.arange(9) != 4
        theta = fit_terms(points[keep], targets[keep], list(range(size)), ridge)
        assert candidate.parameters[size:].tolist() == [0.0] * (9 - size)
        refit = targets[4] - apply(theta, points[4:5])[0]
        np.testing.assert_allclose(candidate.leave_one_out[4], refit, rtol=0.02, atol=2e-6)


def test_a_lens_is_seen_and_straightened():
    bent = made()
    bent = replace(bent, pixels=distort_points(GRID, -0.06, **SIZE))
    result = georeference(bent, **SIZE)
    assert result.radial == pytest.approx(-0.06, abs=0.003)
    np.testing.assert_allclose(world_points(result, bent.pixels), bent.coordinates, atol=0.02)


def test_undistort_undoes_distort():
    there = distort_points(GRID, 0.05, **SIZE)
    np.testing.assert_allclose(undistort_points(there, 0.05, **SIZE), GRID, atol=1e-9)


def test_one_wrong_point_is_left_out_and_named():
    points = made(noise=1.0)
    points.coordinates[5] += (3.0, -2.0)
    with pytest.warns(GeoaimWarning, match="gcp5 is left out"):
        result = georeference(points, **SIZE)
    assert np.flatnonzero(~result.used).tolist() == [5]
    assert np.hypot(*result.residuals[5]) == pytest.approx(np.hypot(3, 2), abs=0.4)


def test_a_point_kilometres_off_is_left_out():
    points = made(noise=1.0)
    points.coordinates[2] += (4000.0, -9000.0)
    with pytest.warns(GeoaimWarning, match="gcp2 is left out"):
        result = georeference(points, **SIZE)
    np.testing.assert_allclose(world_points(result, GRID), transform_points(TRUTH, GRID), atol=0.3)


def test_two_wrong_points_are_refused_by_name():
    points = made(noise=1.0)
    points.coordinates[5] += (3.0, -2.0)
    points.coordinates[9] += (-3.0, -4.0)
    with pytest.raises(GeoreferenceError, match=r"contradict.*(gcp5|gcp9)"):
        georeference(points, **SIZE)


def test_four_points_that_fit_only_an_unlikely_picture_are_refused():
    points = only(made(), [0, 3, 8, 11])
    points.coordinates[1] += (30.0, 15.0)
    with pytest.raises(GeoreferenceError, match="gcp0, gcp3, gcp8, gcp11"):
        georeference(points, **SIZE)


def test_an_understated_accuracy_is_said():
    with pytest.warns(GeoaimWarning, match="stated accuracy"):
        result = georeference(made(noise=6.0), accuracy=0.5, **SIZE)
    assert result.noise > 0.15


@pytest.mark.parametrize(
    ("indices", "found"), [([0, 3, 8], "3 control points"), ([0, 1, 2, 3], "nearly on a line")]
)
def test_too_few_or_in_a_row_are_refused(indices, found):
    with pytest.raises(GeoreferenceError, match=f"{found}.*"):
        georeference(only(made(), indices), **SIZE)


def test_nearly_collinear_points_are_refused():
    pixels = np.array([[100.0, 100.0], [700, 420], [1200, 650], [1800, 1000]])
    with pytest.raises(GeoreferenceError, match=r"gcp0, gcp1, gcp2, gcp3 lie nearly on a line"):
        georeference(made(pixels=pixels), **SIZE)


def test_a_tight_cluster_is_refused():
    with pytest.raises(GeoreferenceError, match="close together"):
        georeference(made(pixels=900.0 + GRID / 80.0), **SIZE)


def test_repeats_are_refused_by_name():
    points = made()
    points.pixels[3] = points.pixels[7]
    with pytest.raises(GeoreferenceError, match="gcp3, gcp7 have the same pixel"):
        georeference(points, **SIZE)
    points = made()
    points.coordinates[3] = points.coordinates[7]
    with pytest.raises(GeoreferenceError, match="gcp3, gcp7 have the same place"):
        georeference(points, **SIZE)


def test_swapped_latitude_and_longitude_are_named():
    points = made(crs="EPSG:4326", noise=1.0)
    swapped = replace(points, coordinates=points.coordinates[:, ::-1])
    with pytest.raises(GeoreferenceError, match="mirrored: longitude and latitude are swapped"):
        georeference(swapped, **SIZE)


def test_latitude_beyond_the_pole_is_named():
    points = made(crs="EPSG:4326")
    far = np.add(points.coordinates, (80.0, -20.0))
    with pytest.raises(GeoreferenceError, match="x and y are swapped"):
        georeference(replace(points, coordinates=far[:, ::-1]), **SIZE)


def test_swapped_easting_and_northing_are_named():
    points = made(crs="EPSG:32635", noise=1.0)
    with pytest.raises(GeoreferenceError, match="x and y are swapped: give easting, northing"):
        georeference(replace(points, coordinates=points.coordinates[:, ::-1]), **SIZE)


def test_v_counted_upwards_is_named():
    points = made(crs="EPSG:32635", noise=1.0)
    upwards = np.stack([points.pixels[:, 0], HEIGHT - points.pixels[:, 1]], axis=1)
    with pytest.raises(GeoreferenceError, match="mirrored: v counts upwards"):
        georeference(replace(points, pixels=upwards), **SIZE)


def test_points_outside_the_image_are_named():
    points = made(pixels=GRID * 1.1)
    with pytest.raises(GeoreferenceError, match=r"gcp3, gcp7, gcp11 lie outside"):
        georeference(points, **SIZE)


def test_an_absurd_scale_is_refused():
    points = made()
    with pytest.raises(GeoreferenceError, match="metres per pixel"):
        georeference(replace(points, coordinates=points.coordinates * 1e5), **SIZE)


def test_points_of_two_frames_are_refused():
    points = replace(made(), frames=("a.jpg", "b.jpg") * 6)
    with pytest.raises(GeoreferenceError, match=r"2 frames \(a.jpg, b.jpg\)"):
        georeference(points, **SIZE)


def test_a_world_and_local_points_do_not_meet():
    with pytest.raises(GeoreferenceError, match="plane of their own"):
        georeference(made(), world=UTM, **SIZE)


@pytest.mark.parametrize("layout", ["spread", "clustered"])
@pytest.mark.parametrize("stated", [True, False])
def test_predicted_uncertainty_covers_the_truth(layout, stated):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeoaimWarning)
        cell = run_cell(layout, "as expected", 8, trials=25, stated=stated)
    assert cell["coverage"]["corners"] >= 88.0


def test_ellipse_factor_of_known_f_quantiles():
    assert ellipse_factor(4.0) ** 2 / 2.0 == pytest.approx(6.9443, abs=1e-3)  # F(2, 4)
    assert ellipse_factor(2.0) ** 2 / 2.0 == pytest.approx(19.0, abs=1e-9)


def test_telemetry_looking_straight_down_gives_an_approximate_place():
    result = approximate_georeference(
        latitude=53.9, longitude=27.56, height_above_ground=100.0, yaw=np.pi / 2.0,
        field_of_view=np.radians(73.7), size=(HEIGHT, WIDTH),
    )  # fmt: skip
    assert result.approximate
    centre, top = world_points(result, np.array([[960.0, 540.0], [960.0, 0.0]]))
    there = world_from_lonlat(result.world, np.array([[27.56, 53.9]]))[0]
    np.testing.assert_allclose(centre, there, atol=1e-6)
    east, north = top - centre
    assert north == pytest.approx(540 * 150.0 / 1920, rel=0.01)
    assert abs(east) < 0.05 * north
    sigma, _ = predict_uncertainty(result, image_corners(**SIZE))
    assert 6.0 < sigma.min() <= sigma.max() < 15.0
    with pytest.raises(GeoreferenceError, match="does not fix a place"):
        approximate_georeference(latitude=np.nan, longitude=0, height_above_ground=1, yaw=0,
                                 field_of_view=1, size=(1, 1))  # fmt: skip


def test_a_plane_of_its_own_has_its_origin_at_the_centre():
    result = local_georeference(resolution=0.1, size=(HEIGHT, WIDTH))
    np.testing.assert_allclose(world_points(result, np.array([[0.0, 0.0]])), [[-96.0, 54.0]])
    assert result.world == World(None)


def test_points_left_on_a_line_by_a_wrong_one_are_refused():
    points = only(made(noise=1.0), [0, 1, 2, 3, 6])
    points.coordinates[4] += (400.0, -300.0)
    left_out = pytest.warns(GeoaimWarning, match="gcp6 is left out")
    with left_out, pytest.raises(GeoreferenceError, match="nearly on a line"):
        georeference(points, accuracy=1.5, **SIZE)


def test_points_in_the_wrong_order_are_refused():
    points = made(noise=1.0)
    order = np.random.default_rng(1).permutation(len(GRID))
    with pytest.raises(GeoreferenceError, match=r"No place fits|mirrored|contradict"):
        georeference(replace(points, coordinates=points.coordinates[order]), **SIZE)
