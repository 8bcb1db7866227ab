import numpy as np
import pytest

from geoaim.base.geometry import wrap_angle
from geoaim.tracking.headings import compute_headings, follow_rear_axle, observe_headings
from tests.tracking.paths import CAR, RATE, drive_straight, turn_left


def differentiate(path):
    return np.gradient(path, 1 / RATE, axis=0)


def find_headings(states):
    return compute_headings(states[:, :2], differentiate(states[:, :2]), CAR[0])


def measure_error(headings, states):
    return np.degrees(np.abs(wrap_angle(headings - states[:, 2])))


def test_the_rear_axle_keeps_to_its_circle():
    states = turn_left(0, 0, 5.0, 8.0)
    error = measure_error(find_headings(states), states)
    assert error[40:].max() < 1.0  # the first heading is that of the motion, 9° off
    motion = np.arctan2(*differentiate(states[:, :2]).T[::-1])
    assert measure_error(motion, states)[50] > 8


def test_a_standing_vehicle_keeps_its_heading_in_noise():
    generator = np.random.default_rng(0)
    driving = drive_straight(0, 0, 0.7, 5.0, steps=50)
    standing = np.repeat(driving[-1:], 200, axis=0)
    states = np.concatenate([driving, standing])
    noisy = states[:, :2] + 0.02 * generator.standard_normal((len(states), 2))
    headings = follow_rear_axle(noisy, 0.7, 0.3 * CAR[0])
    assert np.degrees(np.abs(headings - 0.7)).max() < 5


def test_noise_does_not_turn_what_stands_before_or_between_its_ways():
    generator = np.random.default_rng(0)
    start = drive_straight(0, 0, 0.7, 5.0, steps=50)
    again = drive_straight(*start[-1, :2], 0.7, 5.0, steps=50)
    standing = [np.repeat(row[None], 200, axis=0) for row in (start[0], again[0])]
    states = np.concatenate([standing[0], start, standing[1], again])
    noise = np.zeros((len(states), 2))
    for step in range(1, len(noise)):  # as errors of boxes that last
        noise[step] = 0.98 * noise[step - 1] + 0.02 * generator.standard_normal(2)
    states[:200, 3] = states[250:450, 3] = 0
    noise[states[:, 3] > 0] = 0
    velocity = states[:, 3:] * [np.cos(0.7), np.sin(0.7)]
    headings = compute_headings(states[:, :2] + noise, velocity, CAR[0])
    assert np.degrees(np.ptp(headings[:200])) < 0.1
    assert measure_error(headings, states).max() < 5


def test_a_vehicle_that_turns_back_drives_in_reverse():
    forward = drive_straight(0, 0, 0.0, 4.0, steps=75)
    rest = np.repeat(forward[-1:], 25, axis=0)
    back = drive_straight(forward[-1, 0], 0, 0.0, -2.0, steps=50)
    states = np.concatenate([forward, rest, back])
    assert measure_error(find_headings(states), states).max() < 3
    swapped = np.concatenate([back - back[-1] * [1, 0, 0, 0], rest * [0, 1, 1, 1], forward])
    assert measure_error(find_headings(swapped), swapped).max() < 3


def test_what_never_moves_has_no_heading():
    states = drive_straight(0, 0, 1.0, 0.0)
    assert find_headings(states) is None
    assert np.isnan(observe_headings(states[:, :2], CAR[0], None)).all()


@pytest.mark.parametrize("standing", [None, 0.7])
def test_observed_headings_do_not_know_what_follows(standing):
    states = np.concatenate([drive_straight(0, 0, 0.7, 5.0, steps=60), turn_left(9, 8, 5.0, 8.0)])
    whole = observe_headings(states[:, :2], CAR[0], standing)
    cut = observe_headings(states[:40, :2], CAR[0], standing)
    np.testing.assert_array_equal(whole[:40], cut)
    assert np.isnan(whole[0]) == (standing is None)
    np.testing.assert_allclose(whole[10:60], 0.7, atol=1e-9)
