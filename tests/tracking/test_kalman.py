from copy import deepcopy

import numpy as np

from geoaim.tracking.kalman import filter_tracks, make_rows, predict, smooth_tracks

TIMES = np.cumsum(np.r_[0.0, np.tile([0.03, 0.05], 30)])  # a variable frame rate


def run(positions, sigma=0.1):
    """Filter and smooth tracks (N, T, 2), NaN where there is no detection."""
    track, step = np.nonzero(np.isfinite(positions[..., 0]))
    rows, noise = make_rows(track, step), np.ones(len(positions))
    measured = positions[track, step][rows.detection]
    filtered = filter_tracks(TIMES, rows, measured, np.full(len(measured), sigma), noise)
    return rows, deepcopy(filtered), smooth_tracks(TIMES, rows, filtered, noise)


def test_a_straight_path_has_its_velocity_at_a_variable_rate():
    path = TIMES[:, None] * [3.0, -4.0] + [10.0, 20.0]
    _, filtered, smoothed = run(path[None], sigma=0.001)
    np.testing.assert_allclose(smoothed.mean[:, 0], path, atol=1e-3)
    np.testing.assert_allclose(filtered.mean[10:, 1], np.tile([3.0, -4.0], (51, 1)), atol=1e-2)
    np.testing.assert_allclose(filtered.mean[-1], smoothed.mean[-1])


def test_smoothing_lessens_errors_and_states_them():
    generator = np.random.default_rng(0)
    path = TIMES[:, None] * [3.0, -4.0]
    noisy = path + 0.1 * generator.standard_normal((200, len(TIMES), 2))
    rows, *motions = run(noisy)
    middle = rows.step == 30
    errors = [np.std(motion.mean[middle, 0] - path[30]) for motion in motions]
    stated = [np.sqrt(motion.covariance[30, 0, 0]) for motion in motions]
    assert errors[1] < errors[0] < 0.1
    np.testing.assert_allclose(errors, stated, rtol=0.25)  # they assume noise in the acceleration


def test_gaps_are_bridged_and_ends_are_not_extrapolated():
    path = np.tile(np.nan, (1, len(TIMES), 2))
    seen = np.r_[5:20, 40:50]
    path[0, seen] = TIMES[seen, None] * [3.0, 0.0]
    rows, _, smoothed = run(path, sigma=0.01)
    np.testing.assert_array_equal(rows.step, np.arange(5, 50))
    np.testing.assert_allclose(smoothed.mean[25, 0], [TIMES[30] * 3, 0], atol=0.02)
    assert smoothed.covariance[25, 0, 0] > 4 * smoothed.covariance[7, 0, 0]


def test_predictions_grow_uncertain():
    mean = np.array([[[0.0, 0], [2, 1]]])
    mean, covariance = predict(mean, np.zeros((1, 2, 2)), 3.0, np.ones(1))
    np.testing.assert_allclose(mean[0, 0], [6, 3])
    np.testing.assert_allclose(covariance[0], [[9, 4.5], [4.5, 3]])
