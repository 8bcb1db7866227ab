import json
from dataclasses import replace

import numpy as np
import pytest

from geoaim.base.geometry import image_corners
from geoaim.mapping.georeference.control_points import ControlPoints, select_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import world_from_pixels
from geoaim.mapping.georeference.uncertainty import predict_uncertainty
from geoaim.web.picking.feedback import assess_points, describe_feedback, pixels_from_world
from tests.mapping.georeference.points import GRID, HEIGHT, SIZE, TILTED, WIDTH, make_points

IMAGE = (HEIGHT, WIDTH)
NONE = ControlPoints(np.empty((0, 2)), np.empty((0, 2)), None, (), ())


def move_point(points, index, metres):
    coordinates = points.coordinates.copy()
    coordinates[index] += metres
    return replace(points, coordinates=coordinates)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 7])
def test_it_says_how_many_points_are_missing(count):
    points = select_points(make_points(noise=1.0), [0, 3, 8, 11, 5, 6, 1][:count])
    feedback = assess_points(points if count else NONE, IMAGE)
    assert feedback.missing == max(4 - count, 0)
    assert feedback.problem is None
    assert (feedback.georeference is not None) == (count >= 2)
    assert len(feedback.residuals) == (count if count >= 3 else 0)
    json.dumps(describe_feedback(feedback), allow_nan=False)


def test_three_points_give_residuals_of_a_similarity_called_preliminary():
    points = select_points(make_points(noise=2.0), [0, 3, 9])
    plain = describe_feedback(assess_points(points, IMAGE))
    assert plain["georeference"]["preliminary"]
    assert plain["georeference"]["model"] == "similarity"
    distances = [row["distance_m"] for row in plain["residuals"]]
    assert 0.0 < max(distances) < 0.05 * 6
    assert [row["leave_one_out_m"] for row in plain["residuals"]] == [None] * 3


def test_enough_points_give_what_the_georeference_gives():
    points = make_points(TILTED, noise=1.0)
    expected = estimate_georeference(points, **SIZE)
    feedback = assess_points(points, IMAGE)
    plain = describe_feedback(feedback)
    assert plain["georeference"]["model"] == expected.model == "homography"
    assert not plain["georeference"]["preliminary"]
    for row, metres, left_out in zip(
        plain["residuals"], expected.residuals, expected.leave_one_out, strict=True
    ):
        np.testing.assert_allclose(row["residual_m"], metres, atol=1e-9)
        np.testing.assert_allclose(row["leave_one_out_m"], left_out)
        resolution = np.linalg.norm(metres) / np.linalg.norm(row["residual_px"])
        assert 0.03 < resolution < 0.08  # about 0.05 m per pixel


def test_ellipses_have_the_radii_of_the_georeference_in_metres_and_in_pixels():
    points = select_points(make_points(TILTED, noise=1.0), [0, 1, 4, 5, 6, 9])
    feedback = assess_points(points, IMAGE)
    corners = image_corners(*IMAGE)
    _, radii = predict_uncertainty(feedback.georeference, corners)
    np.testing.assert_allclose([place.radius_m for place in feedback.places[:4]], radii, rtol=1e-9)
    for place in feedback.places:
        (first, second), pixels = np.array(place.axes_m), np.array(place.axes_px)
        assert abs(first @ second) < 1e-9 * (first @ first)
        lengths = np.linalg.norm([first, second], axis=1) / np.linalg.norm(pixels, axis=1)
        assert ((lengths > 0.03) & (lengths < 0.08)).all()


def test_pixels_from_world_inverts_the_georeference():
    georeference = replace(estimate_georeference(make_points(TILTED), **SIZE), radial=0.02)
    back = pixels_from_world(georeference, world_from_pixels(georeference, GRID))
    np.testing.assert_allclose(back, GRID, atol=1e-6)


def test_the_next_point_lies_far_from_points_that_stand_on_one_side():
    left = select_points(make_points(noise=1.0), [0, 1, 4, 5, 8, 9])
    before = assess_points(left, IMAGE)
    assert before.next_point.u == WIDTH
    assert before.next_point.largest_with_point_m < 0.6 * before.next_point.largest_m
    after = assess_points(select_points(make_points(noise=1.0), [0, 1, 3, 4, 5, 8, 9]), IMAGE)
    assert after.next_point.largest_m < 0.8 * before.next_point.largest_m


def test_a_wrong_point_is_named_and_marked():
    points = move_point(make_points(noise=0.5), 4, [4.0, -3.0])
    feedback = assess_points(points, IMAGE)
    assert [row.name for row in feedback.residuals if not row.used] == ["gcp4"]
    [warning] = feedback.warnings
    assert "gcp4 is left out" in warning.text
    assert warning.names == ("gcp4",)


def test_names_are_found_as_whole_words():
    points = replace(make_points(), names=tuple(f"point {i}" for i in range(1, 13)))
    feedback = assess_points(move_point(points, 10, [40.0, 0.0]), IMAGE)
    assert feedback.warnings[0].names == ("point 11",)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda p: select_points(p, [0, 1, 2, 3]), "nearly on a line"),
        (lambda p: replace(p, pixels=p.pixels * [1, -1] + [0, HEIGHT]), "mirrored"),
        (lambda p: replace(p, coordinates=p.coordinates * 1e-7), "degrees"),
        (lambda p: replace(p, pixels=p.pixels[[0] * len(p.pixels)]), "same pixel"),
        (lambda p: replace(p, pixels=p.pixels + np.array([0.0, 2000.0])), "outside the image"),
        (lambda p: replace(p, crs="EPSG:32635", coordinates=p.coordinates * 1e6), "EPSG:32635"),
        (lambda p: replace(p, frames=(*p.frames[:-1], 7)), "2 frames"),
    ],
)
def test_a_bad_layout_is_a_problem_in_words_and_no_error(change, text):
    feedback = assess_points(change(make_points(noise=0.5)), IMAGE)
    assert text in feedback.problem.text
    assert feedback.georeference is None or feedback.georeference.approximate
    json.dumps(describe_feedback(feedback), allow_nan=False)


def test_points_on_a_line_are_told_to_add_one_off_that_line():
    feedback = assess_points(select_points(make_points(noise=0.5), [0, 1, 2, 3]), IMAGE)
    assert feedback.problem.names == ("gcp0", "gcp1", "gcp2", "gcp3")
    assert feedback.next_point.v == HEIGHT  # the line is near the top
