import numpy as np

from geoaim.mapping.background.traffic_removal import find_traffic
from tests.mapping.background.clips import CAR, queue


def test_traffic_is_found_in_frames_that_see_only_a_part(ground):
    images = np.stack(queue(ground))
    seen = np.ones(images.shape[:3], bool)
    seen[::2, :, 180:] = False
    traffic = find_traffic(images.copy(), seen)
    assert not traffic.masks[::2, :, 180:].any()
    assert np.abs(traffic.background.astype(int) - ground).mean() < 3


def test_a_car_that_leaves_before_the_last_frame_is_removed_whatever_the_order(ground):
    parked = queue(ground, count=20, standing=1.0)
    images = np.stack([*parked[:19], queue(ground, count=20, standing=0.1)[-1]])
    order = np.random.default_rng(0).permutation(20)
    traffic = find_traffic(images[order], np.ones(images.shape[:3], bool), np.argsort(order))
    inside = np.s_[CAR[1] : CAR[3], CAR[0] : CAR[2]]
    assert np.abs(traffic.background[inside].astype(int) - ground[inside]).mean() < 6
