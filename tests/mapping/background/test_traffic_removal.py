import numpy as np

from geoaim.mapping.background.traffic_removal import (
    average_frames_at,
    compute_median,
    continue_ground,
    count_frames,
    estimate_noise,
    find_alike,
    find_beyond,
    find_seams,
    find_traffic,
    measure_difference,
)
from tests.mapping.background.clips import CAR, SIZE, queue

WHITE = np.full((3, 4, 3), 250, np.uint8)
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
    cars = [None if 10 <= k < 20 else 40 + k % 5 * 9 - 18 for k in range(30)]
    images, middle = cover_marking(cars, marking=170), (CAR[1] + 9, CAR[0] + 9)
    images[15, *middle] = images[15, 90, 90] = 190  # single pixels: no regions
    traffic = find(images)
    assert traffic.contested[middle]
    assert not traffic.contested[90, 90]
    assert traffic.masks[15, 90, 90]
    assert not traffic.masks[15, *middle]


def test_traffic_that_reaches_into_a_box_is_masked_at_its_rim(ground):
    stack = np.stack([ground] * 8)
    stack[5, 50:70, 60:90] = 240
    seen = np.ones(stack.shape[:3], bool)
    seen[5, :, 80:] = False  # the box of a vehicle beside
    masks = find_traffic(stack, seen).masks
    assert masks[5, 52:68, 64:81].all()
    assert not masks[5, :, 82:].any()
    assert not masks[4].any()


def doubt_car():
    doubtful = np.zeros(SIZE, bool)
    doubtful[INSIDE] = True
    return doubtful


def test_ground_that_two_frames_show_replaces_a_car_in_doubt(ground):
    parked = queue(ground)[0]
    stack = np.stack([parked, ground, parked, ground])
    seen = np.ones((4, *SIZE), bool)
    result, left = continue_ground(stack, seen, parked, doubt_car(), 10)
    assert not left[INSIDE].any()
    assert np.abs(result[INSIDE].astype(int) - ground[INSIDE]).max() <= 10


def test_a_frame_is_not_taken_where_it_does_not_see_the_image(ground):
    parked = queue(ground)[0]
    seen = np.ones((2, *SIZE), bool)
    seen[1] = False
    result, left = continue_ground(np.stack([parked, ground]), seen, parked, doubt_car(), 10)
    assert (result[INSIDE] == parked[INSIDE]).all()
    assert left[INSIDE].mean() > 0.5


def test_half_a_car_that_no_frame_shows_is_a_seam_and_a_whole_one_is_not(ground):
    parked = queue(ground)[0]
    stack, seen = np.stack([parked, ground]), np.ones((2, *SIZE), bool)
    half = parked.copy()
    middle = (CAR[0] + CAR[2]) // 2
    half[:, middle:] = ground[:, middle:]
    differs = [[measure_difference(f, image) > 10 for f in stack] for image in (parked, half)]
    assert not find_seams(np.array(differs[0]), seen).any()
    seams = find_seams(np.array(differs[1]), seen)
    assert seams[CAR[1] + 3 : CAR[3] - 3, middle - 2 : middle + 2].all()
    assert seams.mean() < 0.1


def test_only_frames_before_and_after_the_background_was_seen_are_beyond_it():
    masks = np.array([True, False, True, False, True])[:, None, None]
    seen = np.ones_like(masks)
    beyond = find_beyond(masks, seen, np.arange(5))
    assert beyond.ravel().tolist() == [True, False, False, False, True]
    in_time = find_beyond(masks, seen, np.array([1, 0, 2, 4, 3]))
    assert not in_time.any()


def test_median_and_noise_are_those_of_the_frames_that_see_a_pixel():
    generator = np.random.default_rng(0)
    stack = np.rint(generator.normal(100, 5, (22, 40, 40, 3))).astype(np.uint8)
    seen = np.ones((22, 40, 40), bool)
    seen[::2, :, 20:] = False
    median = compute_median(stack.copy(), seen)
    np.testing.assert_allclose(median[:, 20:], np.median(stack[1::2, :, 20:], axis=0), atol=1)
    assert 4 < estimate_noise(stack, seen, median) < 12


def test_frames_that_look_alike_are_averaged_and_others_left_out():
    stack, seen = np.stack([WHITE - 4, WHITE, WHITE // 2]), np.ones((3, 3, 4), bool)
    seen[0, 0] = False
    alike = find_alike(stack, seen, WHITE, 8)
    assert [same.all() for same in alike[:, 1:]] == [True, True, False]
    assert not alike[0, 0].any()
    where = np.eye(3, 4, dtype=bool)
    mean = average_frames_at(stack, alike, where, WHITE // 3)
    assert (mean[~where] == WHITE[0, 0] // 3).all()
    assert mean[where][:, 0].tolist() == [250, 248, 248]


def test_the_default_stays_where_no_frame_is_selected():
    nowhere, everywhere = np.zeros((1, 3, 4), bool), np.ones((3, 4), bool)
    assert (average_frames_at(WHITE[None] // 2, nowhere, everywhere, WHITE) == WHITE).all()


def test_frames_are_counted_beyond_what_a_byte_holds():
    assert (count_frames(np.ones((300, 2, 2), bool)) == 300).all()
