import numpy as np
import pytest

from benchmarks.synthetic.scenery.sprites import draw_pedestrian, draw_vehicle


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
