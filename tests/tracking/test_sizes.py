import numpy as np
import pytest

from geoaim.tracking.sizes import estimate_size, get_typical_size, predict_extents, vote_type


def test_upright_boxes_of_a_turning_car_give_its_size():
    generator = np.random.default_rng(0)
    turn = np.linspace(0, np.pi / 2, 60)
    extent = predict_extents(np.array([5.2, 2.1]), turn) + 0.1 * generator.standard_normal((60, 2))
    extent[::10] *= 1.5  # boxes of something else
    np.testing.assert_allclose(estimate_size(extent, turn, 0.1, "car"), [5.2, 2.1], atol=0.15)


def test_boxes_at_45_degrees_tell_the_sum_alone():
    extent = predict_extents(np.array([4.5, 1.8]), np.full(40, np.pi / 4))
    size = estimate_size(extent, np.full(40, np.pi / 4), 0.05, "car")
    np.testing.assert_allclose(size, [4.5, 1.8], atol=0.05)


def test_without_boxes_the_size_is_typical():
    size = estimate_size(np.empty((0, 2)), np.empty(0), 0.1, "bus")
    np.testing.assert_allclose(size, get_typical_size("bus"))


@pytest.mark.parametrize(
    ("size", "kind"),
    [((0.6, 0.5), "pedestrian"), ((1.8, 4.4), "car"), ((12, 2.6), "bus"), ((1.7, 0.7), "cyclist")],
)
def test_unknown_types_are_chosen_by_size(size, kind):
    assert vote_type(["", ""], np.tile(size, (2, 1))) == kind


@pytest.mark.parametrize("size", [(0.6, 0.5), (1.7, 0.7)])
def test_in_coarse_pixels_what_is_small_is_a_part_of_a_car(size):
    assert vote_type([""], np.array([size]), resolution=0.43) == "car"
    assert vote_type(["cyclist"], np.array([size]), resolution=0.43) == "cyclist"


def test_types_are_those_that_the_detector_gives_most():
    assert vote_type(["car", "van", "car", ""], np.ones((4, 2))) == "car"
    assert vote_type([""], np.zeros((1, 2))) == "unknown"
