import numpy as np
import pytest

from geoaim.synthetic.scenery.sprites import (
    draw_bare_tree,
    draw_pedestrian,
    draw_tree,
    draw_vehicle,
)
from geoaim.synthetic.scenery.texture import make_natural_noise

GRAIN = make_natural_noise((256, 256), 0.5, np.random.default_rng(1))


@pytest.mark.parametrize(("length", "width"), [(4.4, 1.8), (8.0, 2.45), (12.0, 2.5)])
def test_vehicle_has_its_size(length, width):
    sprite = draw_vehicle(length, width, (200, 30, 30), 0.05)
    v, u = np.nonzero(sprite[..., 3] > 127)
    assert np.ptp(u) + 1 == pytest.approx(length / 0.05, abs=2)
    assert np.ptp(v) + 1 == pytest.approx(width / 0.05, abs=5)


def test_cyclist_is_longer_than_a_pedestrian():
    sprites = (draw_pedestrian((60, 60, 90), 0.05, cycle=cycle) for cycle in (True, False))
    long, short = (sprite[..., 3] > 127 for sprite in sprites)
    assert np.ptp(np.nonzero(long)[1]) > 2 * np.ptp(np.nonzero(short)[1])


def test_crown_is_lit_from_the_sun():
    crown = draw_tree(60, (100, 140, 70), (1.0, 0.0), GRAIN, np.random.default_rng(2))
    solid = crown[..., 3] > 250
    columns = np.arange(crown.shape[1]) > crown.shape[1] / 2
    right, left = (crown[..., 1][solid & half].mean() for half in (columns, ~columns))
    assert right > left + 8


def test_same_generator_grows_the_same_tree():
    one, again = (draw_bare_tree(40, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(one, again)
    assert 0.02 < (one[..., 3] > 60).mean() < 0.6
