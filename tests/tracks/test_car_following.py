import numpy as np
import pytest
import torch

from geoaim.tracks.car_following import DriverParameters, compute_gap_ratio

DRIVER = DriverParameters(acceleration=1.5, deceleration=2.0, standstill_gap=2.0, headway=1.5)


def test_ratio_is_one_at_the_equilibrium_gap():
    ratio = compute_gap_ratio(DRIVER, np.array([8.0]), np.array([0.0]), np.array([14.0]))
    assert ratio == pytest.approx(1.0)


def test_opening_gap_is_desired_no_smaller_than_at_standstill():
    ratio = compute_gap_ratio(DRIVER, np.array([5.0]), np.array([-50.0]), np.array([2.0]))
    assert ratio == pytest.approx(1.0)


def test_arrays_and_tensors_give_the_same_ratio():
    speed, closing, gap = np.array([[3.0, 9.0, 0.0], [0.5, 4.0, 0.0], [9.0, np.inf, 0.0]])
    tensors = (torch.tensor(values) for values in (speed, closing, gap))
    found = compute_gap_ratio(DRIVER, speed, closing, gap)
    np.testing.assert_array_equal(found, compute_gap_ratio(DRIVER, *tensors).numpy())
