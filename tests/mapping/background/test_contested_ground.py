import numpy as np

from geoaim.mapping.background.contested_ground import (
    continue_ground,
    find_beyond,
    find_seams,
    remove_outlines,
)
from tests.mapping.background.clips import CAR, SIZE, queue

INSIDE = np.s_[CAR[1] : CAR[3], CAR[0] : CAR[2]]


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
    assert not find_seams(stack, seen, parked, 10).any()
    seams = find_seams(stack, seen, half, 10)
    assert seams[CAR[1] + 3 : CAR[3] - 3, middle - 2 : middle + 2].all()
    assert seams.mean() < 0.1


def test_an_outline_that_frames_without_the_car_do_not_show_is_removed(ground):
    masks = np.zeros((4, *SIZE), bool)
    masks[:2, CAR[1] : CAR[3], CAR[0] : CAR[2]] = True
    seen = np.ones_like(masks)
    outlined = ground.copy()
    outlined[CAR[1] - 1, CAR[0] : CAR[2]] = 0
    stack = np.stack([outlined, outlined, ground, ground])
    assert (remove_outlines(stack, seen, masks, outlined, 10) == ground).all()


def test_only_frames_before_and_after_the_background_was_seen_are_beyond_it():
    masks = np.array([True, False, True, False, True])[:, None, None]
    seen = np.ones_like(masks)
    beyond = find_beyond(masks, seen, np.arange(5))
    assert beyond.ravel().tolist() == [True, False, False, False, True]
    in_time = find_beyond(masks, seen, np.array([1, 0, 2, 4, 3]))
    assert not in_time.any()
