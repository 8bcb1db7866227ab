"""The benchmark of tracking: its scores on paths with exact states, and its smallest video."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.tracking import benchmark as tracking
from benchmarks.tracking import hard as tracking_hard
from benchmarks.tracking import peers as tracking_peers
from benchmarks.tracking import real as tracking_real
from benchmarks.tracking.cases import DetectorErrors, make_drawn_case
from benchmarks.tracking.filmed_cases import FilmedCase
from benchmarks.tracking.models_without_detector import keep_vehicles_in_view
from benchmarks.tracking.scores import compute_iou, make_view, measure_errors, score_tracks
from geoaim.base.geometry import transform_points
from geoaim.tracking import track_boxes
from tests.faults.seeds import make_aim
from tests.tracking.paths import SIZE, detect, drive_straight, make_truth, turn_left

pytestmark = pytest.mark.slow

HAS_TRACKEVAL = find_spec("trackeval") is not None


@pytest.fixture(scope="module")
def views():
    truth = make_truth(turn_left(10, 20, 6.0, 12.0), drive_straight(70, 42, np.pi, 8.0))
    frames, matrices = detect(truth)
    found = track_boxes(frames, matrices, truth.times, truth.world, SIZE)
    every = [np.ones(len(tracks.ids), bool) for tracks in (truth, found)]
    inverse = np.linalg.inv(matrices)
    return [make_view(t, inverse, SIZE, k) for t, k in zip((truth, found), every, strict=True)]


def test_errors_of_the_truth_are_zero(views):
    truth = views[0]
    agents, steps = np.nonzero(truth.visible)
    pairs = np.column_stack([agents, agents, steps])
    exact = measure_errors(truth.tracks, truth.tracks, pairs)
    assert all(value == 0 or np.isnan(value) for value in exact.values())


def test_tracks_score_well_by_trackeval(views):
    pytest.importorskip("trackeval")
    row = score_tracks(*views)
    assert row["HOTA"] > 0.85
    assert row["IDF1"] > 0.95
    assert row["position m"] < 0.1


def test_boxes_without_overlap_have_no_iou():
    assert compute_iou(np.array([[0.0, 0, 1, 1]]), np.array([[2.0, 2, 3, 3]])) == 0


def test_a_made_video_is_located(monkeypatch):
    monkeypatch.setitem(tracking.VIDEOS, "tiny", (270, 480))
    case = tracking.make_case("street", 1, "tiny", seconds=0.4, resolution=0.2)
    error = case.world_from_frame @ case.frame_from_world
    assert len(case.boxes) == 10
    np.testing.assert_allclose(
        error / error[:, 2:, 2:], np.broadcast_to(np.eye(3), (10, 3, 3)), atol=1.0
    )


def test_a_drawn_case_has_boxes_where_agents_are():
    errors = DetectorErrors(0.0, 0.0, 0.0)
    case = make_drawn_case("street", 1, (270, 480), seconds=0.4, errors=errors)
    visible = make_view(case.truth, case.frame_from_world, case.size, np.array([True])).visible
    assert [len(boxes.boxes) for boxes in case.boxes] == visible.sum(axis=0).tolist()
    row = next(tracking.measure_case(case, lambda *_: case.truth), {}) if HAS_TRACKEVAL else {}
    assert row.get("IDF1", 1) == 1


def test_averages_are_by_method_and_group():
    rows = [
        {"method": "a", "agents of": "vehicle", "video": "x", "HOTA": value} for value in (0.5, 1.0)
    ]
    assert tracking.average_rows(rows)[0]["HOTA"] == 0.75


def test_peers_are_listed_where_they_are_installed():
    found, floor = set(tracking_peers.list_peers()), {"Kalman and Hungarian"}
    assert floor <= found <= {"ByteTrack", "OC-SORT", *floor}


def test_real_boxes_are_tracked_without_their_ids(data_folder):
    row = tracking_real.measure_songdo(data_folder / tracking_real.FOLDER)
    assert row["position m"] < 0.4
    assert row["vehicles in several tracks"] == row["tracks of several vehicles"] == 0


def test_hard_boxes_are_made_and_gaps_of_peers_are_filled():
    case = tracking_hard.make_lanes_case(1, seconds=2.0, errors=DetectorErrors(doubled=0.5))
    few = tracking_hard.take_frames(case, 12)
    assert len(few.boxes) == len(few.truth.times) == 5
    step = [0, 1, 2, 4, 6]
    sides = dict.fromkeys(tracking_peers.SIDES, np.array(step, float))
    filled = tracking_peers._fill_gaps(
        pd.DataFrame({"id": "a", "type": "car", "step": step} | sides)
    )
    np.testing.assert_array_equal(filled["left"], np.arange(7))


def test_models_learn_from_true_tracks_of_vehicles_in_view():
    truth = make_truth(drive_straight(70, 42, np.pi, 8.0), drive_straight(70, 30, np.pi, 1.0))
    truth = replace(truth, types=("car", "pedestrian"))
    _, matrices = detect(truth)
    inverse = np.linalg.inv(matrices)
    case = FilmedCase(
        "one", Path("no.mp4"), make_aim(), truth, inverse, (2 * SIZE[0], SIZE[1] // 2)
    )
    kept = keep_vehicles_in_view(case)
    pixels = transform_points(inverse, truth.states[0, :, :2][:, None])[:, 0]
    assert (kept.present[0] == (truth.present[0] & (pixels[:, 0] < SIZE[1] // 2))).all()
    assert 0 < kept.present[0].sum() < truth.present[0].sum()
    assert not kept.present[1].any()
