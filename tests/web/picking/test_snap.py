import cv2
import numpy as np
import pytest

from geoaim.web.picking.snap import snap_to_corner

SIDE, FINE = 60, 16


def draw_ground(corner, kind, angle, generator, *, blur=0.0, noise=0.0):
    """A corner at known coordinates, drawn 16 times as fine and averaged."""
    places = (np.indices((SIDE * FINE,) * 2)[::-1] + 0.5) / FINE
    x, y = places - np.reshape(corner, (2, 1, 1))
    a, b = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    inside = {"kerb": (a > 0) & (b > 0), "squares": (a > 0) ^ (b > 0), "edge": a > 0}[kind]
    image = cv2.resize(inside.astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), blur) if blur else image
    image = 70 + 80 * image + generator.normal(0, noise, image.shape)
    return np.repeat(image.clip(0, 255).round().astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize(
    ("kind", "blur", "noise", "median", "most"),
    [
        ("kerb", 0.7, 2.0, 0.2, 0.4),
        ("kerb", 1.5, 5.0, 0.35, 0.7),
        ("squares", 0.7, 2.0, 0.1, 0.2),
        ("squares", 1.5, 5.0, 0.25, 0.5),
    ],
)
def test_clicks_move_to_the_corner_of_a_blurred_and_noisy_picture(kind, blur, noise, median, most):
    generator, errors = np.random.default_rng(0), []
    for _ in range(30):
        corner = generator.uniform(28, 32, 2)
        angle = generator.uniform(0, 2 * np.pi)
        image = draw_ground(corner, kind, angle, generator, blur=blur, noise=noise)
        found = snap_to_corner(image, tuple(corner + generator.uniform(-3, 3, 2)))
        errors.append(np.linalg.norm(np.subtract(found, corner)))
    assert np.median(errors) < median
    assert np.percentile(errors, 90) < most


def test_squares_without_noise_have_no_bias_and_any_position_in_a_large_image():
    generator = np.random.default_rng(1)
    image = np.full((400, 500, 3), 100, np.uint8)
    image[200:, 300:] = image[:200, :300] = 180
    assert snap_to_corner(image, (303.0, 196.0)) == pytest.approx((300.0, 200.0), abs=0.02)
    small = draw_ground((30.25, 29.5), "squares", 0.4, generator)[..., 0]
    assert snap_to_corner(small, (32.0, 28.0)) == pytest.approx((30.25, 29.5), abs=0.06)


@pytest.mark.parametrize("noise", [0.0, 3.0, 12.0])
def test_an_edge_and_plain_ground_have_no_corner(noise):
    generator, found = np.random.default_rng(2), 0
    for _ in range(40):
        edge = draw_ground((30.3, 30.2), "edge", generator.uniform(0, 6), generator, noise=noise)
        plain = np.clip(generator.normal(90, noise, (SIDE, SIDE)), 0, 255).astype(np.uint8)
        found += sum(snap_to_corner(image, (30.0, 30.0)) is not None for image in (edge, plain))
    assert found <= 2  # of 80


def test_a_corner_beyond_the_radius_is_not_taken():
    image = draw_ground((30.0, 30.0), "squares", 0.3, np.random.default_rng(3))
    assert snap_to_corner(image, (15.0, 30.0), radius=8.0) is None
    assert snap_to_corner(image, (25.0, 30.0), radius=8.0) is not None


def test_clicks_at_the_border_and_outside():
    image = draw_ground((30.0, 30.0), "squares", 0.3, np.random.default_rng(4))
    for pixel in [(0.0, 0.0), (60.0, 60.0), (0.0, 45.0)]:
        snap_to_corner(image, pixel)
    assert snap_to_corner(image[:6, :6], (3.0, 3.0)) is None
    with pytest.raises(ValueError, match="outside 60 x 60"):
        snap_to_corner(image, (61.0, 3.0))
