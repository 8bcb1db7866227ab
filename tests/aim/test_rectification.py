import cv2
import numpy as np
import pytest

from geoaim.aim.aim import AIM
from geoaim.aim.rectification import rectify
from geoaim.base.errors import AimError
from geoaim.base.geometry import transform_points
from tests.aim.test_aim import TURNED, UTM, make_aim

OBLIQUE = np.array([[0.05, 0.01, 3.7], [0.004, -0.05, 21.3], [2e-4, 4e-4, 1.0]])


def painted(points: np.ndarray) -> np.ndarray:
    """A smooth colour for any place in the world, so that a resampled image can be predicted."""
    x, y = points[..., 0], points[..., 1]
    waves = [np.sin(x), np.cos(y), np.sin(x + y)]
    return np.rint(127.5 + 100 * np.stack(waves, axis=-1)).astype(np.uint8)


def pixel_centres(height: int, width: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def painted_aim(height: int, width: int, place: np.ndarray) -> AIM:
    centres = pixel_centres(height, width).reshape(-1, 2)
    image = painted(transform_points(place, centres)).reshape(height, width, 3)
    coverage = np.full((height, width), 9, np.uint16)
    return AIM(image, place, UTM, coverage, np.zeros((height, width), bool))


@pytest.mark.parametrize("place", [TURNED, OBLIQUE], ids=["affine", "oblique"])
@pytest.mark.parametrize("resolution", [0.025, 0.05, 0.15])
def test_rectified_pixels_show_their_own_position(place, resolution):
    found = rectify(painted_aim(200, 300, place), resolution)
    height, width = found.coverage.shape
    points = transform_points(found.world_from_image, pixel_centres(height, width).reshape(-1, 2))
    truth = painted(points).reshape(height, width, 3).astype(float)
    seen = (found.coverage == 9).astype(np.uint8)
    inside = cv2.erode(seen, np.ones((5, 5)), borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    assert inside.sum() > 1000
    assert np.abs(found.image - truth)[inside].max() <= 2.0
    assert abs((found.image - truth)[inside].mean()) < 0.1


def test_rectified_grid_is_north_up_on_whole_multiples_around_the_image():
    aim = painted_aim(200, 300, OBLIQUE)
    found = rectify(aim)
    step = found.world_from_image[0, 0]
    np.testing.assert_array_equal(found.world_from_image[:2, :2], [[step, 0.0], [0.0, -step]])
    np.testing.assert_allclose(found.world_from_image[:2, 2] / step % 1 % 1, 0, atol=1e-9)
    assert (found.corners.min(axis=0) <= aim.corners.min(axis=0) + 1e-6).all()
    assert (found.corners.max(axis=0) >= aim.corners.max(axis=0) - 1e-6).all()
    assert (found.coverage == 0).any()
    assert (found.image[found.coverage == 0] == 0).all()


def test_default_resolution_is_the_median_pixel_to_two_digits():
    place = np.diag([0.05234, -0.05234, 1.0])
    assert rectify(painted_aim(200, 300, place)).world_from_image[0, 0] == 0.052


def test_north_up_aim_at_its_own_resolution_is_unchanged():
    aim = painted_aim(200, 300, np.array([[0.05, 0, 10], [0, -0.05, 30], [0, 0, 1.0]]))
    found = rectify(aim)
    np.testing.assert_array_equal(found.image, aim.image)
    np.testing.assert_allclose(found.world_from_image, aim.world_from_image, atol=1e-12)


def test_coarser_grid_averages_instead_of_picking():
    aim = painted_aim(256, 256, np.diag([0.1, -0.1, 1.0]))
    aim.image[:] = np.where(np.indices((256, 256)).sum(0)[..., None] % 2, 200, 100)
    found = rectify(aim, 0.8)
    assert np.abs(found.image.astype(int) - 150).max() <= 2


def test_colours_do_not_bleed_in_from_uncovered_pixels():
    aim = painted_aim(100, 100, np.diag([0.1, -0.1, 1.0]))
    aim.image[:] = 180
    aim.coverage[:, 50:] = 0
    aim.image[:, 50:] = 0
    for resolution in (0.07, 0.3):
        found = rectify(aim, resolution)
        assert np.abs(found.image[found.coverage > 0].astype(int) - 180).max() <= 1


def test_coverage_and_contested_are_resampled_with_the_image():
    aim = painted_aim(100, 100, np.diag([0.1, -0.1, 1.0]))
    aim.contested[20:40, 60:80] = True
    aim.coverage[20:40, 60:80] = 500
    found = rectify(aim, 0.05)
    np.testing.assert_array_equal(found.contested, found.coverage == 500)
    assert found.contested.sum() == 40 * 40


def test_resolution_that_makes_too_many_pixels_is_refused_with_one_that_works():
    aim = painted_aim(200, 300, TURNED)
    with pytest.raises(AimError, match=r"use a resolution of (0\.\d+) m or more") as caught:
        rectify(aim, 1e-5)
    rectify(aim, float(str(caught.value).split("resolution of ")[1].split(" m")[0]) * 50)


@pytest.mark.parametrize("resolution", [0.0, -1.0, np.nan, np.inf])
def test_a_resolution_that_is_not_positive_is_refused(resolution):
    with pytest.raises(ValueError, match="positive number of metres"):
        rectify(make_aim(), resolution)
