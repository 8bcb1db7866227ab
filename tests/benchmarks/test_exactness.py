import numpy as np
import pytest
import shapely
import torch

from benchmarks.rendering.exactness import compute_pixel_coverage


def _boxes(count, seed=0):
    """Boxes of all sizes in and around the unit square."""
    generator = np.random.default_rng(seed)
    turn, half = generator.uniform(0, 7, (count, 1)), generator.uniform(0.02, 2, (count, 1))
    angle = turn + np.array([0.6, 2.5, 0.6 + np.pi, 2.5 + np.pi])
    middle = generator.uniform(-1, 2, (count, 1, 2))
    return middle + half[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)


def test_coverage_is_the_area_in_the_pixel():
    corners, square = _boxes(500), shapely.box(0, 0, 1, 1)
    expected = [shapely.Polygon(box).intersection(square).area for box in corners]
    np.testing.assert_allclose(compute_pixel_coverage(torch.tensor(corners)), expected, atol=1e-12)
    result = compute_pixel_coverage(torch.tensor(corners, dtype=torch.float32))
    np.testing.assert_allclose(result, expected, atol=3e-4)


@pytest.mark.parametrize(
    ("corners", "area"),
    [([[0, 0], [0, 1], [1, 1], [1, 0]], -1), ([[0, 0], [1, 0], [1, 1], [0, 1]], 1)],
)
def test_orientation_is_the_sign_and_edges_may_lie_on_the_border(corners, area):
    assert compute_pixel_coverage(torch.tensor([corners], dtype=torch.float64)).item() == area


def test_gradient_agrees_with_finite_differences():
    corners = torch.tensor(_boxes(300, seed=1))
    share = compute_pixel_coverage(corners)
    some = corners[(share > 0.01) & (share < 0.99)].requires_grad_()
    assert len(some) > 50
    assert torch.autograd.gradcheck(compute_pixel_coverage, some, eps=1e-6, atol=1e-4)
