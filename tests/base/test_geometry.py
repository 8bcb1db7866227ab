import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoaim.base.geometry import (
    from_opencv,
    image_corners,
    to_opencv,
    transform_boxes,
    transform_points,
)

numbers = st.floats(-100.0, 100.0)
TILTED = np.array([[1.1, 0.2, 30.0], [-0.1, 0.9, 5.0], [1e-4, 2e-4, 1.0]])


@given(st.lists(numbers, min_size=18, max_size=18))
def test_from_opencv_undoes_to_opencv(values):
    matrices = np.array(values).reshape(2, 3, 3)
    np.testing.assert_allclose(from_opencv(to_opencv(matrices)), matrices, atol=1e-9)


def test_translation_is_the_same_in_both_origins():
    shift = np.array([[1.0, 0.0, 7.0], [0.0, 1.0, -3.0], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(to_opencv(shift), shift)


def test_opencv_warp_puts_a_pixel_where_the_transform_says():
    image = np.zeros((40, 40), np.uint8)
    image[10, 5] = 255
    centre = np.array([[5.5, 10.5]])
    u, v = transform_points(np.diag([3.0, 3.0, 1.0]), centre)[0]
    warped = cv2.warpPerspective(image, to_opencv(np.diag([3.0, 3.0, 1.0])), (120, 120))
    row, column = np.unravel_index(warped.argmax(), warped.shape)
    assert (column + 0.5, row + 0.5) == (u, v)


def test_opencv_homography_of_pixel_centres_becomes_one_of_corners():
    centres = np.array([[10.5, 20.5], [90.5, 15.5], [80.5, 70.5], [5.5, 60.5]])
    mapped = transform_points(TILTED, centres)
    found, _ = cv2.findHomography(centres - 0.5, mapped - 0.5)
    found = from_opencv(found)
    np.testing.assert_allclose(transform_points(found, centres), mapped, atol=1e-4)


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=5))
def test_inverse_brings_points_back(points):
    points = np.array(points)
    there = transform_points(TILTED, points)
    np.testing.assert_allclose(transform_points(np.linalg.inv(TILTED), there), points, atol=1e-6)


def test_points_are_divided_by_their_depth():
    matrix = np.array([[1.0, 0, 0], [0, 1.0, 0], [0.5, 0, 1.0]])
    np.testing.assert_array_equal(transform_points(matrix, np.array([[2.0, 4.0]])), [[1.0, 2.0]])


def test_batch_of_matrices_maps_batch_of_points():
    matrices = np.stack([np.eye(3), np.diag([2.0, 3.0, 1.0])])
    points = np.ones((2, 4, 2))
    mapped = transform_points(matrices, points)
    np.testing.assert_array_equal(mapped[0], np.ones((4, 2)))
    np.testing.assert_array_equal(mapped[1], np.tile([2.0, 3.0], (4, 1)))


def test_box_corners_go_round_from_the_top_left():
    corners = transform_boxes(np.eye(3), np.array([[1.0, 2.0, 5.0, 9.0]]))
    np.testing.assert_array_equal(corners, [[[1, 2], [5, 2], [5, 9], [1, 9]]])


def test_box_corners_are_mapped_as_points_are():
    boxes = np.array([[[1.0, 2.0, 5.0, 9.0], [0.0, 0.0, 1.0, 1.0]]] * 3)
    matrices = np.stack([np.eye(3), TILTED, np.diag([2.0, 2.0, 1.0])])
    corners = transform_boxes(matrices, boxes)
    assert corners.shape == (3, 2, 4, 2)
    top_left = transform_points(matrices, boxes[..., :2])
    np.testing.assert_allclose(corners[:, :, 0], top_left)


def test_no_boxes_give_no_corners():
    assert transform_boxes(np.eye(3), np.zeros((0, 4))).shape == (0, 4, 2)


@pytest.mark.parametrize("shape", [(1, 1), (1080, 1920)])
def test_image_corners_span_the_image(shape):
    corners = image_corners(*shape)
    assert tuple(corners.max(axis=0) - corners.min(axis=0)) == shape[::-1]
