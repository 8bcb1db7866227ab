import numpy as np

from geoaim.mapping.background.traffic_removal import find_traffic
from tests.mapping.background.clips import queue


def test_traffic_is_found_in_frames_that_see_only_a_part(ground):
    images = np.stack(queue(ground))
    seen = np.ones(images.shape[:3], bool)
    seen[::2, :, 180:] = False
    traffic = find_traffic(images.copy(), seen)
    assert not traffic.masks[::2, :, 180:].any()
    assert np.abs(traffic.background.astype(int) - ground).mean() < 3
