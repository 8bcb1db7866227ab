import numpy as np
import pytest

from geoaim.synthetic.roads.curves import (
    compute_arc_lengths,
    compute_curvature,
    compute_headings,
    connect_poses,
    offset_polyline,
    resample_polyline,
    sample_arc,
)


def test_curvature_of_a_circle_is_constant():
    line = sample_arc(10.0, (0.0, 3.0))
    np.testing.assert_allclose(compute_curvature(line)[2:-2], 0.1, rtol=1e-2)
    np.testing.assert_allclose(np.hypot(*line.T), 10.0)


def test_resampling_keeps_both_ends():
    line = resample_polyline(np.array([[0.0, 0], [3, 4], [3, 10]]), 0.5)
    np.testing.assert_allclose(np.hypot(*np.diff(line, axis=0).T), 0.5, atol=0.15)
    np.testing.assert_allclose(line[[0, -1]], [[0, 0], [3, 10]])


def test_offset_curve_of_a_circle_is_a_circle():
    inner = offset_polyline(sample_arc(10.0, (0.0, 3.0)), 2.0)
    np.testing.assert_allclose(np.hypot(*inner.T), 8.0, atol=0.01)


@pytest.mark.parametrize("turn", [-np.pi / 2, 0.3, np.pi / 2])
def test_connection_keeps_both_poses_and_starts_straight(turn):
    end = 14.0 * np.array([np.cos(turn / 2), np.sin(turn / 2)])
    line = connect_poses(np.zeros(2), 0.0, end, turn)
    np.testing.assert_allclose(line[[0, -1]], [[0, 0], end], atol=1e-9)
    np.testing.assert_allclose(compute_headings(line)[[0, -1]], [0, turn], atol=0.02)
    assert abs(compute_curvature(line)[0]) < 0.05


def test_connection_ends_with_the_given_curvature():
    line = connect_poses(np.zeros(2), 0.0, np.array([10.0, 6.0]), 1.2, end_curvature=0.1)
    assert compute_curvature(line)[-1] == pytest.approx(0.1, abs=0.03)


def test_arc_lengths_start_at_zero():
    assert compute_arc_lengths(np.array([[0.0, 0], [3, 4], [3, 5]])).tolist() == [0, 5, 6]
