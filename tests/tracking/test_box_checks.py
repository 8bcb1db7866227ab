"""Boxes that cannot be: doubled ones, sizes on the map, speeds of tracks."""

import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.tracking import track_boxes
from geoaim.tracking.box_checks import drop_doubled_boxes
from tests.tracking.paths import SIZE, detect, drive_straight, make_truth

CARS = [(10, 12, 0.0), (60, 24, np.pi), (12, 36, 0.3)]


@pytest.fixture(scope="module")
def cars():
    return make_truth(*(drive_straight(x, y, turn, 8.0) for x, y, turn in CARS))


def test_doubled_boxes_of_any_class_are_dropped(cars):
    frames, matrices = detect(cars)
    generator = np.random.default_rng(1)
    doubled = [
        DetectedBoxes(
            np.concatenate([f.boxes, f.boxes + generator.normal(0, 2, f.boxes.shape)]),
            types=f.types + ("van",) * len(f.types),
        )
        for f in frames
    ]
    cleaned, count, _ = drop_doubled_boxes(doubled)
    assert [len(one.boxes) for one in cleaned] == [len(one.boxes) for one in frames]
    assert count == sum(len(one.boxes) for one in frames)
    with pytest.warns(GeoaimWarning, match="lie on another one"):
        found = track_boxes(doubled, matrices, cars.times, cars.world, SIZE)
    assert len(found.ids) == len(cars.ids)


def test_a_part_of_a_box_is_dropped_and_an_agent_beside_it_kept():
    whole, part, person = [100, 100, 190, 140], [100, 100, 150, 140], [105, 105, 115, 115]
    boxes = DetectedBoxes(
        np.array([whole, part, person], float), types=("car", "car", "pedestrian")
    )
    [cleaned], count, _ = drop_doubled_boxes([boxes])
    np.testing.assert_array_equal(cleaned.boxes, [whole, person])
    assert count == 1


@pytest.mark.parametrize(("side", "kept"), [(40.0, 2), (12.0, 1)])
def test_people_side_by_side_are_kept_unless_noise_may_part_their_boxes(side, kept):
    one = np.array([100.0, 100.0, 100.0 + side, 100.0 + side])
    boxes = DetectedBoxes(np.array([one, one + 0.4 * side]), types=("pedestrian", "cyclist"))
    [cleaned], count, _ = drop_doubled_boxes([boxes])
    assert len(cleaned.boxes) == kept
    assert count == 2 - kept


def test_two_who_walk_together_are_kept_though_half_of_their_boxes_overlaps():
    boxes = np.array([[100.0, 100, 136, 180], [98, 68, 130, 184]])  # 0.57 of their union
    [cleaned], count, _ = drop_doubled_boxes([DetectedBoxes(boxes, types=("pedestrian",) * 2)])
    assert (len(cleaned.boxes), count) == (2, 0)


@pytest.mark.parametrize("factor", [0.3, 4.0])
def test_sizes_that_cannot_be_are_refused(cars, factor):
    frames, matrices = detect(cars)
    scaled = matrices @ np.diag([factor, factor, 1.0])
    with pytest.raises(TracksError, match=r"boxes of car are .* m on the map, which cannot be"):
        track_boxes(frames, scaled, cars.times, cars.world, SIZE)


def test_few_false_boxes_of_a_rare_type_do_not_refuse_the_video(cars):
    frames, matrices = detect(cars)
    person = np.array([[300.0, 300.0, 312.0, 312.0]])
    mixed = [
        DetectedBoxes(np.concatenate([f.boxes, person]), types=(*f.types, "truck"))
        if number % 4 == 0
        else f
        for number, f in enumerate(frames)
    ]
    with pytest.warns(GeoaimWarning, match=r"boxes of truck are .*, which cannot be; they are few"):
        found = track_boxes(mixed, matrices, cars.times, cars.world, SIZE)
    assert len(found.ids) == len(cars.ids)


def test_half_the_size_is_said(cars):
    frames, matrices = detect(cars)
    with pytest.warns(GeoaimWarning, match="which is unusual"):
        track_boxes(frames, matrices @ np.diag([0.5, 0.5, 1]), cars.times, cars.world, SIZE)


def test_scores_under_the_usual_one_start_tracks_where_all_are_low(cars):
    frames, matrices = detect(cars)
    low = [DetectedBoxes(f.boxes, scores=np.full(len(f.boxes), 0.3), types=f.types) for f in frames]
    assert len(track_boxes(low, matrices, cars.times, cars.world, SIZE).ids) == len(cars.ids)
