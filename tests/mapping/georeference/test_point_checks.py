from dataclasses import replace

import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.mapping.georeference.control_points import select_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.point_checks import warn_of_small_part
from tests.mapping.georeference.points import GRID, HEIGHT, SIZE, WIDTH, make_points


@pytest.mark.parametrize(
    ("indices", "found"), [([0, 3, 8], "3 control points"), ([0, 1, 2, 3], "nearly on a line")]
)
def test_too_few_points_and_points_on_a_line_are_refused(indices, found):
    with pytest.raises(GeoreferenceError, match=f"{found}.*"):
        estimate_georeference(select_points(make_points(), indices), **SIZE)


def test_nearly_collinear_points_are_refused():
    pixels = np.array([[100.0, 100.0], [700, 420], [1200, 650], [1800, 1000]])
    with pytest.raises(GeoreferenceError, match=r"gcp0, gcp1, gcp2, gcp3 lie nearly on a line"):
        estimate_georeference(make_points(pixels=pixels), **SIZE)


def test_a_tight_cluster_is_refused():
    with pytest.raises(GeoreferenceError, match="close together"):
        estimate_georeference(make_points(pixels=900.0 + GRID / 80.0), **SIZE)


def test_repeats_are_refused_by_name():
    points = make_points()
    points.pixels[3] = points.pixels[7]
    with pytest.raises(GeoreferenceError, match="gcp3, gcp7 have the same pixel"):
        estimate_georeference(points, **SIZE)
    points = make_points()
    points.coordinates[3] = points.coordinates[7]
    with pytest.raises(GeoreferenceError, match="gcp3, gcp7 have the same place"):
        estimate_georeference(points, **SIZE)


def test_swapped_latitude_and_longitude_are_named():
    points = make_points(crs="EPSG:4326", noise=1.0)
    swapped = replace(points, coordinates=points.coordinates[:, ::-1])
    with pytest.raises(GeoreferenceError, match="mirrored: longitude and latitude are swapped"):
        estimate_georeference(swapped, **SIZE)


def test_latitude_beyond_the_pole_is_named():
    points = make_points(crs="EPSG:4326")
    far = np.add(points.coordinates, (80.0, -20.0))
    with pytest.raises(GeoreferenceError, match="are x and y swapped"):
        estimate_georeference(replace(points, coordinates=far[:, ::-1]), **SIZE)


def test_degrees_taken_for_metres_are_named():
    points = make_points(crs="EPSG:4326")
    with pytest.raises(GeoreferenceError, match=r"within 0\.0.* m in EPSG:32635.*crs: EPSG:4326"):
        estimate_georeference(replace(points, crs="EPSG:32635"), **SIZE)


def test_points_of_a_smaller_picture_give_a_warning():
    points = make_points()
    warn_of_small_part(points, (HEIGHT, WIDTH))
    with pytest.warns(GeoaimWarning, match=r"upper left 900 x 475 of 1920 x 1080 .* smaller pict"):
        warn_of_small_part(replace(points, pixels=points.pixels / 2), (HEIGHT, WIDTH))


def test_swapped_easting_and_northing_are_named():
    points = make_points(crs="EPSG:32635", noise=1.0)
    with pytest.raises(GeoreferenceError, match="are x and y swapped"):
        estimate_georeference(replace(points, coordinates=points.coordinates[:, ::-1]), **SIZE)


def test_v_counted_upwards_is_named():
    points = make_points(crs="EPSG:32635", noise=1.0)
    upwards = np.stack([points.pixels[:, 0], HEIGHT - points.pixels[:, 1]], axis=1)
    with pytest.raises(GeoreferenceError, match="mirrored: v counts upwards"):
        estimate_georeference(replace(points, pixels=upwards), **SIZE)


def test_points_outside_the_image_are_named():
    points = make_points(pixels=GRID * 1.1)
    with pytest.raises(GeoreferenceError, match=r"gcp3, gcp7, gcp11 lie outside"):
        estimate_georeference(points, **SIZE)


def test_an_absurd_scale_is_refused():
    points = make_points()
    with pytest.raises(GeoreferenceError, match="metres per pixel"):
        estimate_georeference(replace(points, coordinates=points.coordinates * 1e5), **SIZE)


def test_points_of_two_frames_are_refused():
    points = replace(make_points(), frames=("a.jpg", "b.jpg") * 6)
    with pytest.raises(GeoreferenceError, match=r"2 frames \(a.jpg, b.jpg\)"):
        estimate_georeference(points, **SIZE)
