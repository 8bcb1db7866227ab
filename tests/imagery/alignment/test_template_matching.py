import numpy as np

from geoaim.aim.aim import AIM
from geoaim.base.world import World
from geoaim.imagery.alignment.template_matching import (
    compute_orientation,
    match_windows,
    reduce_to_grey,
)
from tests.conftest import textured


def test_orientation_is_that_of_the_edge_from_either_side():
    grey = np.random.default_rng(0).uniform(100, 140, (80, 80)).astype(np.float32)
    known = np.ones(grey.shape, bool)
    one = compute_orientation(
        np.where(np.arange(80) < 40, 200, 100).astype(np.float32) + 0 * grey, known, 0.5
    )
    two = compute_orientation(
        np.where(np.arange(80) < 40, 100, 200).astype(np.float32) + 0 * grey, known, 0.5
    )
    edge = np.s_[20:60, 38:42]
    assert one[edge][..., 0].mean() > 0.1
    np.testing.assert_allclose(np.sign(one[edge][..., 0]), np.sign(two[edge][..., 0]))


def test_windows_are_found_to_a_fraction_of_a_pixel():
    grey = textured(np.random.default_rng(4), 240, 240)[..., 0].astype(np.float32)
    known = np.ones(grey.shape, bool)
    fields = [
        compute_orientation(view, known, 0.5) for view in (grey, np.roll(grey, (3, -2), (0, 1)))
    ]
    found = match_windows(*fields, side=64, search=6, stride=48)
    assert len(found.centers) > 10
    np.testing.assert_allclose(np.nanmedian(found.shifts, axis=0), [-2, 3], atol=0.1)


def test_a_rounding_error_of_the_resolution_changes_no_grey_value():
    image = textured(np.random.default_rng(0), 40, 60)
    exact, rounded = (
        AIM.from_image(image, np.diag([size, -size, 1.0]), World(None), "test")
        for size in (0.2, 0.20000000000000284)
    )
    expected = reduce_to_grey(exact, 0.4).grey
    assert expected.shape == (20, 30)
    np.testing.assert_array_equal(reduce_to_grey(rounded, 0.4).grey, expected)
