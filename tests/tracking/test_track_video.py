"""The sample's video, its boxes and the exact ground: tracks like those of the sample."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import geoaim
from geoaim.aim.aim import AIM
from geoaim.base.errors import GeoaimWarning, RegistrationError
from geoaim.base.geometry import image_corners, to_opencv, transform_points
from geoaim.base.progress import no_progress
from geoaim.cli import app
from geoaim.mapping.video.video import open_video
from geoaim.tracking import frame_poses, track_video
from geoaim.tracking.frame_poses import locate_frames, place_reference
from geoaim.tracking.report import summarize_tracking

SAMPLES = Path(__file__).parents[2] / "samples"
FRAMES = 30
CLASSES = ("car", "van", "truck", "bus", "pedestrian", "cyclist")


@pytest.fixture(scope="module")
def video():
    whole = open_video(SAMPLES / "hover.mp4")
    frames = [replace(frame) for frame in islice(whole, FRAMES)]
    arrays = [frame.image for frame in frames]
    return open_video(arrays, rate=whole.rate)


def test_tracks_of_the_sample_lie_where_they_should(aim, video):
    boxes = geoaim.read_detections(SAMPLES / "boxes", classes=CLASSES)
    tracks = track_video(video, aim, boxes)
    truth = geoaim.read_tracks(SAMPLES / "tracks.csv")
    step = int(np.argmin(np.abs(tracks.times - 0.6)))
    now = int(np.argmin(np.abs(truth.times - tracks.times[step])))
    there = truth.states[truth.present[:, now], now]
    here = tracks.states[tracks.present[:, step], step]
    distance = np.hypot(*(here[:, None, :2] - there[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
    assert len(here) >= 5
    assert np.median(distance) < 0.15
    lines = summarize_tracking(tracks, aim)
    assert lines["on the map"].endswith("of the states")
    assert lines["bridged states"] == "0.0%, between two detections"


def test_boxes_that_are_not_turned_with_their_vehicles_are_doubted(aim, video):
    read = geoaim.read_detections(SAMPLES / "boxes", classes=CLASSES)

    def lay_across(frame):
        own = read(frame)
        ends = own.boxes.reshape(-1, 2, 2)
        middle, half = ends.mean(axis=1), np.diff(ends, axis=1)[:, 0] / 2
        return replace(own, boxes=np.hstack([middle - half[:, ::-1], middle + half[:, ::-1]]))

    with pytest.warns(GeoaimWarning, match="lie across their paths .* Four corners turn them"):
        track_video(video, aim, lay_across)


def test_a_frame_is_placed_in_an_aim_that_is_turned_and_scaled(aim, video):
    turned = replace(
        aim,
        image=np.ascontiguousarray(np.rot90(cv2.resize(aim.image, None, fx=0.8, fy=0.8))),
        coverage=np.ones((1024, 576), np.uint16),
        contested=np.zeros((1024, 576), bool),
        world_from_image=np.eye(3),
    )
    frame = next(iter(video))
    matrix, placement = place_reference(frame, turned, None)
    u, v = image_corners(720, 1280).T
    expected = np.column_stack([0.8 * v, 0.8 * (1280 - u)])
    np.testing.assert_allclose(transform_points(matrix, image_corners(720, 1280)), expected, atol=1)
    assert placement.uncertainty < 0.2


def test_the_frame_that_a_map_was_built_of_is_not_searched_in_it(aim, video, monkeypatch):
    def search(*_):
        raise RegistrationError("another placement fits 20% as much of the image")

    monkeypatch.setattr(frame_poses, "place_reference", search)
    built = {"reference_index": 4, "reference_time_s": 4 / video.rate}
    truth = np.load(SAMPLES / "truth.npz")["world_from_frame"][:FRAMES]
    matrix = truth[4]
    warped = cv2.warpPerspective(
        aim.image, to_opencv(np.linalg.inv(matrix) @ aim.world_from_image), (1280, 720)
    )
    report = {"source": video.source, "registration": built}
    own = replace(aim, image=warped, world_from_image=matrix / matrix[2, 2], report=report)
    poses = locate_frames(video, own, None, no_progress)
    corners = image_corners(720, 1280)
    error = transform_points(poses.world_from_frame, corners) - transform_points(truth, corners)
    assert np.abs(error).max() < 0.05
    moved = replace(own, image=np.roll(own.image, 3, axis=1))  # another video of that name
    with pytest.raises(RegistrationError, match="another placement"):
        locate_frames(video, moved, None, no_progress)


def test_an_aim_of_other_ground_is_refused(aim, video):
    noise = np.random.default_rng(0).integers(0, 255, (90, 160, 3)).astype(np.uint8)
    other = AIM.from_image(cv2.resize(noise, (1280, 720)), np.eye(3), aim.world, "noise")
    with pytest.raises(RegistrationError, match="does not match the AIM"):
        place_reference(next(iter(video)), other, None)


def test_the_command_refuses_columns_of_another_form(tmp_path):
    arguments = ["track", "v.mp4", "--aim", "a.tif", "--detections", "d.csv", "--columns", "x"]
    result = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "t.csv")])
    assert result.exit_code != 0
    assert "are not of the form" in result.output
