"""The real junction's traffic, and which tracks of drawn places are judged."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.tracking.filmed_cases import FilmedCase
from benchmarks.tracking.real_cars import ACCELERATION, JUNCTIONS, Condition, _drive, _measure_body
from benchmarks.tracking.scores import make_view
from benchmarks.tracking.without_detector import _lie_on_spots, _take_steps
from tests.faults.seeds import make_aim
from tests.tracking.paths import SIZE, detect, drive_straight, make_truth

COUNT = 40


@pytest.mark.parametrize("place", JUNCTIONS)
def test_cars_drive_wait_and_leave_or_are_parked(place):
    wanted, junction = Condition(moving=8, queue=2), JUNCTIONS[place]
    poses = _drive(junction, wanted, COUNT, np.random.default_rng(0))
    waiting, parked = 2 * len(junction.stops), len(junction.parked)
    assert poses.shape == (COUNT, waiting + 8 + parked, 3)
    assert np.ptp(poses[:, -parked:], axis=0).max() == 0
    shifts = np.hypot(*np.diff(poses[..., :2], axis=0).transpose(2, 0, 1))
    early = shifts[: int(0.6 * COUNT) - 1, :waiting]
    assert np.nanmax(early) == 0
    seconds = 0.4 * (COUNT - 1) / wanted.frame_rate
    way = np.nansum(shifts[:, :waiting], axis=0)
    pixels = ACCELERATION / junction.resolution / 2 * seconds**2
    np.testing.assert_allclose(way, pixels, rtol=0.1)
    assert np.nanmin(shifts[:, waiting : waiting + 8]) > 5


def test_a_car_is_as_large_as_what_is_opaque():
    sprite = np.zeros((20, 40, 4), np.uint8)
    sprite[2:17, 3:37, 3] = 255
    sprite[17, :, 3] = 100
    assert _measure_body(sprite) == (34, 15)


def test_a_track_on_a_drawn_car_is_not_judged_unless_it_is_of_a_vehicle():
    truth = make_truth(drive_straight(70, 42, np.pi, 8.0), drive_straight(70, 30, np.pi, 1.0))
    _, matrices = detect(truth)
    inverse = np.linalg.inv(matrices)
    both = make_view(truth, inverse, SIZE, np.array([True, True]))
    first = make_view(truth, inverse, SIZE, np.array([True, False]))
    step = int(np.flatnonzero(both.visible.all(axis=0))[0])
    spots = truth.states[:, step, :2]
    on_spot = _lie_on_spots(both, first, spots)
    assert not on_spot[0].any()
    assert on_spot[1, step]
    assert not _lie_on_spots(both, first, np.empty((0, 2))).any()
    case = FilmedCase("one", Path("no.mp4"), make_aim(), truth, inverse, SIZE)
    part = _take_steps(case, np.array([step, step + 1]))
    np.testing.assert_array_equal(part.truth.times, truth.times[step : step + 2])
    np.testing.assert_array_equal(part.frame_from_world, inverse[step : step + 2])
