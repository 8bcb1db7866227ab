"""Values far from their pixel's own ground are left out, with boxes and without."""

import numpy as np
import pytest

from geoaim.mapping.background.outlying_values import mask_outliers, measure_spread
from geoaim.mapping.background.traffic_search import remove_traffic
from geoaim.mapping.video.detections import read_detections
from tests.mapping.background.clips import SIZE, boxes_of_queue, frames_of, queue

COUNT = 16


def make_stack(ground, spread=1.0):
    generator = np.random.default_rng(5)
    noise = generator.normal(0, spread, (COUNT, *ground.shape))
    return (ground + noise).clip(0, 255).astype(np.uint8)


def measure_error(background, ground):
    return np.abs(background.image.astype(float) - ground)


def test_a_value_far_from_the_ground_is_masked_and_the_others_are_not(ground):
    stack = make_stack(ground)
    stack[3, 50:52, 70:72] += 40
    seen, masks = np.ones((2, COUNT, *SIZE), bool)
    masks[:] = False
    mask_outliers(stack, seen, masks, ground, 8)
    assert masks[3, 49:53, 69:73].all()
    assert masks.sum() == 16


def test_what_varies_by_itself_keeps_half_of_its_values(ground):
    leaves = np.s_[:, 60:90, 20:60]
    stack = make_stack(ground)
    stack[leaves] = make_stack(ground, 25.0)[leaves]
    seen, masks = np.ones((2, COUNT, *SIZE), bool)
    masks[:] = False
    mask_outliers(stack, seen, masks, ground, 8)
    assert (masks[leaves].mean(0) < 0.5).mean() > 0.99


def test_the_spread_is_that_of_the_values_that_are_used():
    differences = np.full((9, 2, 3), 4, np.uint8)
    differences[5:] = 200
    used = np.ones((9, 2, 3), bool)
    used[5:, 0] = False
    spread = measure_spread(differences, used)
    np.testing.assert_allclose(spread, 1.4826 * 4, rtol=1e-6)
    assert (differences[5:] == 200).all()


def test_cars_of_a_few_pixels_leave_no_dots(ground):
    images = np.stack(queue(ground, count=COUNT))
    for k in range(COUNT):  # too small for a region of 3 x 3 pixels
        images[k, 110:112, 5 + 11 * k : 8 + 11 * k] = 20
    background = remove_traffic(frames_of(list(images)), size=SIZE)
    assert measure_error(background, ground)[108:114].max() < 4


@pytest.mark.parametrize("standing", [0.6, 0.85])
@pytest.mark.parametrize("damage", [{"missing": 0.1}, {"scale": 0.9}])
def test_damaged_boxes_cost_nothing(ground, standing, damage):
    frames = frames_of(queue(ground, standing=standing))
    damaged = read_detections(boxes_of_queue(standing=standing, **damage))
    background = remove_traffic(frames, size=SIZE, detections=damaged)
    assert measure_error(background, ground)[35:105].max() < 6
    assert not background.contested.any()


def test_frames_without_an_entry_are_left_out_of_both_passes(ground):
    entries = boxes_of_queue()
    entries[4] = entries[11] = None
    background = remove_traffic(
        frames_of(queue(ground)), size=SIZE, detections=read_detections(entries)
    )
    assert background.frames_used == 28
    assert measure_error(background, ground)[35:105].max() < 6
