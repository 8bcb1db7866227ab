import numpy as np

from geoaim.mapping.background.traffic_removal import find_traffic
from tests.mapping.background.clips import CAR, SIZE, queue

INSIDE = np.s_[CAR[1] : CAR[3], CAR[0] : CAR[2]]


def cover_marking(cars, *, marking):
    """Thirty frames of a marking as large as a car, which cars of a grey level cover (or None)."""
    generator = np.random.default_rng(3)
    images = np.full((30, *SIZE, 3), 110.0)
    for image, car in zip(images, cars, strict=True):
        image[INSIDE] = marking if car is None else car
    return (images + generator.normal(0, 2, images.shape)).clip(0, 255).astype(np.uint8)


def find(images):
    return find_traffic(images.copy(), np.ones(images.shape[:3], bool))


def test_traffic_is_found_in_frames_that_see_only_a_part(ground):
    images = np.stack(queue(ground))
    seen = np.ones(images.shape[:3], bool)
    seen[::2, :, 180:] = False
    traffic = find_traffic(images.copy(), seen)
    assert not traffic.masks[::2, :, 181:].any()
    assert np.abs(traffic.background.astype(int) - ground).mean() < 3


def test_a_car_that_leaves_before_the_last_frame_is_removed_whatever_the_order(ground):
    parked = queue(ground, count=20, standing=1.0)
    images = np.stack([*parked[:19], queue(ground, count=20, standing=0.1)[-1]])
    order = np.random.default_rng(0).permutation(20)
    traffic = find_traffic(images[order], np.ones(images.shape[:3], bool), np.argsort(order))
    assert np.abs(traffic.background[INSIDE].astype(int) - ground[INSIDE]).mean() < 6


def test_ground_that_is_seen_again_and_again_is_not_contested():
    cars = [68 if k in (4, 11, 17, 22, 29) else None for k in range(30)]
    traffic = find(cover_marking(cars, marking=170))  # its outline is as strong as the cars'
    assert np.abs(traffic.background[INSIDE].astype(int) - 170).max() < 4
    assert not traffic.contested.any()


def test_ground_that_is_seen_once_is_contested_unless_the_cars_have_stronger_outlines():
    shades = np.arange(30) % 5 * 9 - 18
    for car, marking, share in ((40, 170, 1.0), (10, 125, 0.0)):
        cars = [None if 10 <= k < 20 else max(car + shades[k], 0) for k in range(30)]
        traffic = find(cover_marking(cars, marking=marking))
        assert np.abs(traffic.background[INSIDE].astype(int) - marking).max() < 4
        assert traffic.contested[INSIDE].mean() == share


def test_no_value_is_left_out_where_the_ground_is_contested():
    cars = [68 if k in (4, 29) else None for k in range(30)]
    images, middle = cover_marking(cars, marking=170), (CAR[1] + 9, CAR[0] + 9)
    images[8, *middle] = images[8, 90, 90] = 190  # single pixels: no regions
    traffic = find(images)
    assert traffic.contested[middle]
    assert not traffic.contested[90, 90]
    assert traffic.masks[8, 90, 90]
    assert not traffic.masks[8, *middle]


def test_traffic_that_reaches_into_a_box_is_masked_at_its_rim(ground):
    stack = np.stack([ground] * 8)
    stack[5, 50:70, 60:90] = 240
    seen = np.ones(stack.shape[:3], bool)
    seen[5, :, 80:] = False  # the box of a vehicle beside
    masks = find_traffic(stack, seen).masks
    assert masks[5, 52:68, 64:81].all()
    assert not masks[5, :, 82:].any()
    assert not masks[4].any()
