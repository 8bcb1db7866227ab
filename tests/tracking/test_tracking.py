"""Tracking of made boxes: what is found, bridged, refused and stated."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.tracking.cases import DetectorErrors
from geoaim.base.errors import TracksError
from geoaim.base.geometry import wrap_angle
from geoaim.base.world import World
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.tracking import track_boxes
from geoaim.tracking.ground_detections import place_boxes
from geoaim.tracking.noise import estimate_noise
from geoaim.tracking.standing import Directions
from tests.tracking.paths import (
    ERRORS,
    SIZE,
    WORLD_FROM_FRAME,
    detect,
    drive_straight,
    make_truth,
    turn_left,
)

EXACT = DetectorErrors(0.0, 0.0, 0.0)


def track(truth, errors=ERRORS, lanes=None, change=lambda frames: frames):
    frames, matrices = detect(truth, errors)
    return track_boxes(change(frames), matrices, truth.times, truth.world, SIZE, lanes=lanes)


def pair(truth, found):
    """The track of each agent, by the nearest position at the middle of the time."""
    step = len(truth.times) // 2
    places = found.states[:, step, :2]
    return [int(np.nanargmin(np.hypot(*(places - p).T))) for p in truth.states[:, step, :2]]


@pytest.fixture(scope="module")
def junction():
    """Two cars that turn and pass one that stands, and a pedestrian."""
    return make_truth(
        turn_left(10, 20, 6.0, 12.0),
        drive_straight(70, 42, np.pi, 8.0),
        drive_straight(40, 46, np.pi, 0.0),
        drive_straight(20, 10, 1.0, 1.3),
        kinds=("car", "van", "car", "pedestrian"),
        sizes=[(4.6, 1.9), (5.6, 2.1), (4.3, 1.8), (0.5, 0.5)],
    )


def test_agents_are_found_with_their_states(junction):
    found = track(junction)
    order = pair(junction, found)
    assert sorted(order) == list(range(len(found.ids)))
    error = found.states[order] - junction.states
    assert np.nanmedian(np.hypot(error[..., 0], error[..., 1])) < 0.05
    moving = [0, 1]
    assert np.degrees(np.nanmedian(np.abs(wrap_angle(error[moving, :, 2])))) < 1.5
    assert np.nanmedian(np.abs(error[..., 3])) < 0.15
    np.testing.assert_allclose(found.sizes[order], junction.sizes, atol=0.2)
    assert [found.types[row] for row in order] == list(junction.types)


def test_states_that_bridge_misses_are_marked_and_less_certain(junction):
    def leave_out(frames):
        gap = range(40, 65)  # a second
        return [DetectedBoxes(np.empty((0, 4))) if n in gap else f for n, f in enumerate(frames)]

    found = track(junction, EXACT, change=leave_out)
    assert len(found.ids) == 4
    assert found.present[:, 40:65].all()
    assert not found.seen[:, 40:65].any()
    assert found.seen[:, :40].all()
    assert (found.uncertainty[:, 52, 0] > 2 * found.uncertainty[:, 20, 0]).all()
    error = found.states[pair(junction, found), 52, :2] - junction.states[:, 52, :2]
    assert np.hypot(*error.T).max() < 0.4


def test_observed_states_do_not_know_later_frames(junction):
    whole = track(junction, EXACT)
    first = replace(
        junction,
        times=junction.times[:60],
        states=junction.states[:, :60],
        present=junction.present[:, :60],
    )
    cut = track(first, EXACT)
    rows = [row for row, kind in enumerate(whole.types) if kind != "car"]
    difference = whole.observed[rows, :60] - cut.observed[rows]
    difference[..., 2] = wrap_angle(difference[..., 2])
    np.testing.assert_array_equal(np.isnan(difference), np.isnan(cut.observed[rows]))
    assert np.nanmax(np.abs(difference)) < 0.02  # sizes and noise are those of whole tracks
    assert not np.allclose(whole.states[rows, 50:60], cut.states[rows, 50:60], atol=1e-6)
    assert np.isnan(whole.observed[:, 0]).any()


def test_standing_vehicles_have_the_heading_of_a_lane_or_none(junction):
    alone = make_truth(drive_straight(40, 30, 0.0, 0.0))
    found = track(alone, EXACT)
    assert abs(np.sin(found.states[0, 0, 2])) < 0.05  # along the box, in either sense
    assert found.uncertainty[0, 0, 1] == np.pi
    assert np.isnan(found.observed).all()
    lane = Directions(np.array([[40.0, 30.0]]), np.array([0.02]), np.array([2.0]))
    found = track(alone, EXACT, lanes=lane)
    np.testing.assert_allclose(found.states[0, :, 2], 0.02)
    assert np.isfinite(found.observed[0, -1]).all()


def test_boxes_at_the_border_are_completed():
    truth = make_truth(drive_straight(-8, 30, 0.0, 8.0))
    found = track(truth, EXACT)
    assert len(found.ids) == 1
    steps = np.flatnonzero(found.present[0])
    error = found.states[0, steps, 0] - truth.states[0, steps, 0]
    assert np.abs(error[5:]).max() < 0.3


def test_oriented_boxes_give_the_heading_of_what_stands():
    corners = np.array([[[100.0, 100], [180, 140], [162, 176], [82, 136]]])
    box = DetectedBoxes(np.array([[82.0, 100, 180, 176]]), corners, types=("car",))
    matrices = np.broadcast_to(WORLD_FROM_FRAME, (20, 3, 3))
    found = track_boxes([box] * 20, matrices, np.arange(20) / 25, World(None), SIZE)
    heading = found.states[0, 0, 2]
    assert abs(np.tan(heading) + 0.5) < 1e-6  # v points down
    np.testing.assert_allclose(found.sizes[0], [4.47, 2.01], atol=0.05)


def test_noise_is_estimated_from_the_boxes(junction):
    frames, matrices = detect(junction, DetectorErrors(0.0, 0.0, 3.0))
    placed = place_boxes(frames, matrices, SIZE)
    assert estimate_noise(placed, np.full(len(placed.step), -1)) == 2.0
    agent = np.array([["car", "van", "pedestrian"].index(kind) for kind in placed.types])
    agent[(placed.types == "car") & (placed.position[:, 1] > 44)] = 3
    np.testing.assert_allclose(estimate_noise(placed, agent), 3 / np.sqrt(2), rtol=0.1)


def test_frames_without_a_transform_are_bridged(junction):
    frames, matrices = detect(junction, EXACT)
    matrices = matrices.copy()
    matrices[30:40] = np.nan
    found = track_boxes(frames, matrices, junction.times, junction.world, SIZE)
    assert len(found.ids) == 4
    assert not found.seen[:, 30:40].any()


def test_detections_that_give_no_track_are_refused(junction):
    frames = [DetectedBoxes(np.empty((0, 4)))] * len(junction.times)
    matrices = np.broadcast_to(WORLD_FROM_FRAME, (len(frames), 3, 3))
    with pytest.raises(TracksError, match="0 detections in 100 of 100 frames give no track"):
        track_boxes(frames, matrices, junction.times, junction.world, SIZE)


def test_memory_grows_with_what_is_seen_and_not_with_its_square():
    boxes = np.array([[120.0, 100 * n, 180, 100 * n + 40] for n in range(1, 6)])
    frames = [
        DetectedBoxes(boxes + [6 * (step % 25), 0] * 2) if step % 25 > 2 else None
        for step in range(150)
    ]
    matrices = np.broadcast_to(WORLD_FROM_FRAME, (150, 3, 3))
    found = track_boxes(frames, matrices, np.arange(150) / 25, World(None), SIZE)
    assert len(found.ids) == 30
    assert len(found.to_dataframe()) == found.present.sum() == 30 * 22
    assert "states" not in vars(found)  # N times T values are not made unless they are asked for
    np.testing.assert_array_equal(found.states[found.present], found.get_rows("states"))
