import numpy as np
import pytest

from geoaim.mapping.background.warping import measure_warp_blur, sharpen_mean


def shifted(right: float) -> np.ndarray:
    return np.array([[1.0, 0, right], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize(("right", "expected"), [(0.0, 0.0), (3.0, 0.0), (0.5, 0.25), (0.2, 0.16)])
def test_warp_blur_is_that_of_the_phase(right, expected):
    np.testing.assert_allclose(
        measure_warp_blur(shifted(right), (64, 64)), [expected, 0.0], atol=1e-9
    )


def test_warp_blur_of_a_rotated_frame_is_that_of_uniform_phases():
    angle = 0.1
    matrix = np.eye(3)
    matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    np.testing.assert_allclose(measure_warp_blur(matrix, (500, 500)), 1 / 6, atol=0.02)


@pytest.mark.parametrize("wave", [0.3, 0.8, 1.2])
def test_a_sharpened_mean_of_bilinear_warps_keeps_a_wave(wave):
    columns = np.arange(200)
    truth = 128 + 60 * np.sin(wave * columns)
    phases = np.arange(20) / 20
    warped = []
    for phase in phases:  # the wave as seen by a camera shifted by the phase, and brought back
        seen = 128 + 60 * np.sin(wave * (columns - phase))
        warped.append((1 - phase) * seen + phase * np.roll(seen, -1))
    mean = np.tile(np.mean(warped, axis=0).astype(np.float32), (9, 1))[..., None]
    soft = np.array([np.mean(phases * (1 - phases)), 0.0])
    inner = slice(10, -10)
    kept = np.std(sharpen_mean(mean, soft)[4, inner, 0]) / np.std(truth[inner])
    assert kept == pytest.approx(1, abs=0.01)
    assert np.std(mean[4, inner, 0]) < np.std(truth[inner])
