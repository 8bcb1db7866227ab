"""What boxes of detections or regions miss is found by the frames."""

import numpy as np
import pytest

from geoaim.mapping.background.missed_boxes import find_missed_vehicles
from geoaim.mapping.background.traffic_search import remove_traffic
from geoaim.mapping.video.detections import read_detections
from tests.mapping.background.clips import SIZE, boxes_of_queue, frames_of, queue


def measure_error(background, ground):
    return np.abs(background.image.astype(float) - ground)


def test_cars_of_a_few_pixels_leave_no_dots(ground):
    images = np.stack(queue(ground, count=16))
    for k in range(16):  # too small for a region of 3 x 3 pixels
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


def test_frames_without_an_entry_are_left_out(ground):
    entries = boxes_of_queue()
    entries[4] = entries[11] = None
    background = remove_traffic(
        frames_of(queue(ground)), size=SIZE, detections=read_detections(entries)
    )
    assert background.frames_used == 28
    assert measure_error(background, ground)[35:105].max() < 6


def test_what_boxes_miss_of_a_vehicle_that_always_stands_is_contested(ground):
    entries = boxes_of_queue(standing=1.0)
    for k in range(1, 30, 3):
        entries[k] = entries[k][1:]
    images = queue(ground, standing=1.0)
    detections = read_detections(entries)
    background = remove_traffic(frames_of(images), size=SIZE, detections=detections)
    assert background.contested[40:60, 60:100].all()


def test_a_false_box_hides_nothing_but_itself(ground):
    stack = np.stack(queue(ground))
    seen = np.ones(stack.shape[:3], bool)
    boxes = [np.empty((0, 4))] * len(stack)
    boxes[3] = np.array([[10.0, 5.0, 40.0, 25.0]])
    seen[3, 5:25, 10:40] = False
    assert not find_missed_vehicles(stack, seen, boxes).any()
