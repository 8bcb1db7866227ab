import numpy as np
import pytest

from geoaim.synthetic.scenery.texture import blend, darken, make_natural_noise, rasterize_polygons


def test_natural_noise_has_the_slope_asked_for():
    field = make_natural_noise((256, 256), 1.5, np.random.default_rng(0))
    power = np.abs(np.fft.fft2(field))[1:64, 0] ** 2
    slope = np.polyfit(np.log(np.arange(1, 64)), np.log(power), 1)[0]
    assert slope == pytest.approx(-3.0, abs=0.4)
    assert field.std() == pytest.approx(1.0, abs=1e-3)
    assert abs(field.mean()) < 1e-3


def test_mask_covers_the_polygon_and_leaves_its_holes():
    square = np.array([[10.0, 10], [90, 10], [90, 90], [10, 90]])
    hole = np.array([[40.0, 40], [60, 40], [60, 60], [40, 60]])
    mask = rasterize_polygons((100, 100), [[square, hole]])
    assert mask[20, 20] == 255
    assert mask[50, 50] == 0
    assert mask[5, 5] == 0
    assert mask.sum() / 255 == pytest.approx(80 * 80 - 20 * 20, rel=0.02)


def test_laying_half_of_a_colour_meets_it_half_way():
    image = np.full((40, 4, 3), 100, np.float32)
    blend(image, np.full((40, 4), 0.5, np.float32), (200, 0, 100))
    np.testing.assert_allclose(image, np.broadcast_to([150, 50, 100], image.shape))


def test_darkening_takes_a_share_of_the_light():
    image = np.full((4, 4, 3), 100, np.float32)
    darken(image, np.eye(4, dtype=np.float32), 0.25)
    np.testing.assert_allclose(image[..., 0], 100 - 25 * np.eye(4))
