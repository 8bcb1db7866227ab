"""Vehicles without boxes: on the sample's video, and how evidence is weighed."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import geoaim
from geoaim.base.errors import TracksError
from geoaim.base.geometry import transform_points
from geoaim.base.progress import no_progress
from geoaim.cli import app
from geoaim.detection.network import Peaks
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.mapping.video.video import open_video
from geoaim.tracking.association import Tracklets
from geoaim.tracking.find_vehicles import (
    EVEN,
    _choose,
    _find_dark,
    _Found,
    _pick_peaks,
    _sample_inside,
    _weigh,
    keep_certain,
    measure_certainty,
    search_frames,
)
from geoaim.tracking.frame_poses import locate_frames
from geoaim.tracking.ground_detections import place_boxes
from geoaim.tracking.shadows import find_dark_boxes, find_shadows

SAMPLES = Path(__file__).parents[2] / "samples"
FRAMES = 20


@pytest.fixture(scope="module")
def video():
    whole = open_video(SAMPLES / "hover.mp4")
    return open_video([frame.image for frame in islice(whole, FRAMES)], rate=whole.rate)


@pytest.fixture(scope="module")
def poses(aim, video):
    return locate_frames(video, aim, None, no_progress)


def find_distances(aim, video, poses):
    """Distances of moving vehicles in the last frame that was searched from the nearest box, m."""
    found = search_frames(video, aim, poses)
    step = max(k for k, boxes in enumerate(found) if boxes is not None)
    truth = geoaim.read_tracks(SAMPLES / "tracks.csv")
    now = int(np.argmin(np.abs(truth.times - poses.times[step])))
    is_car = np.array([kind in ("car", "van", "truck", "bus") for kind in truth.types])
    moving = is_car & truth.present[:, now] & (np.abs(truth.states[:, now, 3]) > 2)
    places = truth.states[moving, now, :2]
    matrix = poses.world_from_frame[step]
    pixels = transform_points(np.linalg.inv(matrix), places)
    places = places[((pixels > 40) & (pixels < [1240, 680])).all(axis=1)]
    assert len(places)
    middles = transform_points(matrix, found[step].get_corners().mean(axis=1))
    return np.hypot(*(places[:, None] - middles[None]).transpose(2, 0, 1)).min(axis=1)


def test_moving_vehicles_of_the_sample_are_found_where_they_are(aim, video, poses):
    distance = find_distances(aim, video, poses)
    assert np.median(distance) < 0.6
    assert (distance < 1.2).mean() > 0.7


def test_four_frames_a_second_are_searched(aim, video, poses):
    found = search_frames(video, aim, poses)
    searched = [step for step, boxes in enumerate(found) if boxes is not None]
    assert len(found) == FRAMES
    np.testing.assert_allclose(np.diff(poses.times[searched]), 0.25, atol=0.05)


def test_a_map_that_tells_nothing_leaves_what_the_network_sees(aim, video, poses):
    noise = np.random.default_rng(0).integers(0, 256, aim.image.shape).astype(np.uint8)
    distance = find_distances(replace(aim, image=noise), video, poses)
    assert (distance < 1.2).any()


def test_a_coarse_video_is_refused(aim, video, poses):
    coarse = replace(poses, world_from_frame=np.diag([20.0, 20.0, 1.0]) @ poses.world_from_frame)
    with pytest.raises(TracksError, match="a pixel shows"):
        search_frames(video, aim, coarse)


def test_frames_that_are_registered_badly_are_not_compared(aim, video, poses):
    doubtful = replace(poses.registration, uncertainty=poses.registration.uncertainty + 20.0)
    with pytest.raises(TracksError, match=r"registered to .* m only"):
        search_frames(video, aim, replace(poses, registration=doubtful))


def weigh(logits, excess, lengths=(16.0, 16.0), second=(60.0, 20.0), in_frame=2):
    """Weigh two boxes of 16 x 7 pixels; in the second the frame differs from the map so much."""
    centres = np.array([[20.0, 20.0], second])
    picture = np.ones((40, 80), np.float32)
    picture[:, 40:] = excess
    widths = np.full(2, 7.0)
    peaks = Peaks(centres, np.zeros(2), np.array(lengths), widths, np.array(logits))
    inside = _sample_inside(peaks)
    peaks, odds = _pick_peaks(peaks, _weigh(peaks, inside, picture, in_frame))
    none = find_dark_boxes(peaks, np.zeros(len(odds), bool), np.eye(3))
    return _choose(_Found(peaks, odds, np.array([0.5, 0.5]), none), np.arange(len(odds)))


def test_what_differs_from_the_map_is_more_probably_a_vehicle():
    assert len(weigh([-1.2, -1.2], 1.0).boxes) == 0
    moved = weigh([-1.2, -1.2], 12.0)
    np.testing.assert_allclose(moved.get_corners().mean(axis=1), [[120, 40]])  # of a whole frame
    assert moved.scores[0] > 0.8
    sure = weigh([1.0, 1.0], 12.0)
    assert 0.8 < sure.scores[0] < sure.scores[1]


def test_difference_alone_is_no_vehicle():
    assert len(weigh([-4.0, -4.0], 10.0).boxes) == 0


def test_what_is_seen_in_the_difference_has_moved():
    seen, apart = weigh([-1.2, -1.2], 1.0, in_frame=1), weigh([-1.2, -0.2], 1.0, in_frame=1)
    assert (len(seen.boxes), len(apart.boxes)) == (0, 1)
    np.testing.assert_allclose(apart.get_corners().mean(axis=1), [[120, 40]])


def test_vehicles_almost_as_the_ground_are_found_by_the_difference(aim, video, poses):
    faded, size = [], (video.width, video.height)
    for frame, matrix in zip(video, poses.world_from_frame, strict=True):
        frame_from_aim = np.linalg.inv(matrix) @ aim.world_from_image
        view = cv2.warpPerspective(aim.image, frame_from_aim, size)
        faded.append(np.asarray(0.2 * frame.image + 0.8 * view, np.uint8))
    distance = find_distances(aim, open_video(faded, rate=video.rate), poses)
    assert (distance < 1.2).mean() > 0.7


def test_a_shadow_beside_a_vehicle_is_no_second_one():
    assert len(weigh([2.0, 1.0], 1.0, second=(22.0, 25.0)).boxes) == 1
    assert len(weigh([2.0, 1.0], 1.0, second=(20.0, 28.0)).boxes) == 2  # the next lane


def test_what_is_found_is_a_car_or_longer_than_one():
    assert weigh([3.0, 3.0], 1.0, (7.0, 40.0)).types == ("car", "truck")


def test_tracks_that_are_more_probably_wrong_are_dropped():
    box = np.array([[10.0, 10.0, 26.0, 18.0], [50.0, 10.0, 66.0, 18.0]])
    frames = [DetectedBoxes(box, None, np.array([0.9, 0.4])) for _ in range(6)]
    frames[2:4] = [DetectedBoxes(box[1:], None, np.array([0.4]))] * 2
    matrices = np.repeat(np.diag([0.25, -0.25, 1.0])[None], 6, axis=0)
    detections = place_boxes(frames, matrices, (100, 100))
    track = (detections.position[:, 0] > 8).astype(int)
    tracklets = Tracklets(track, np.array([4, 4]), np.full(len(track), 0.1))
    np.testing.assert_allclose(measure_certainty(detections, tracklets), [0.6, 0.4])
    kept, chosen = keep_certain(detections, tracklets)
    assert set(kept.position[:, 0]) == {4.5}
    assert (len(kept.step), chosen.track.tolist(), chosen.confirmed.tolist()) == (4, [0] * 4, [4])
    assert (kept.roof_sigma > 0).all()
    with pytest.raises(TracksError, match="2 things are followed"):
        keep_certain(replace(detections, score=detections.score / 3), tracklets)


def test_options_of_detections_need_detections(tmp_path):
    command = ["track", str(SAMPLES / "hover.mp4"), "--aim", "map.tif", "--form", "ltrb"]
    result = CliRunner().invoke(app, [*command, "-o", str(tmp_path / "tracks.csv")])
    assert result.exit_code == 1
    assert "--detections" in result.output


def find_shadows_at(sides):
    """Shadows among dark boxes beside lighter ones, in frames that are turned by a quarter each."""
    frames = []
    for turn, side in enumerate(sides):
        centres = np.array([[50.0, 50.0], [50.0, 50.0] + 8.5 * np.array(side)])
        peaks = Peaks(centres, np.zeros(2), np.full(2, 16.0), np.full(2, 7.0), np.zeros(2))
        c, s = np.round([np.cos(turn * np.pi / 2), np.sin(turn * np.pi / 2)])
        world_from_image = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        frames.append(find_dark_boxes(peaks, np.array([False, True]), world_from_image))
    return [shadow.tolist() for shadow in find_shadows(frames)]


def test_dark_boxes_on_one_side_of_lighter_ones_are_shadows():
    to_north = [(0, 1), (1, 0), (0, -1), (-1, 0)] * 6  # of frames that are turned
    assert find_shadows_at(to_north) == [[1]] * 24
    other = find_shadows_at([*to_north, (0, -1)])
    assert other[-1] == []  # on the sun's side of a lighter one: a dark car
    to_south = [(-x, -y) for x, y in to_north]
    assert find_shadows_at(to_north[:12] + to_south[:12]) == [[]] * 24
    assert find_shadows_at(to_north[:12]) == [[]] * 12  # too few to tell
    assert find_shadows_at([(0, 2), (2, 0), (0, -2), (-2, 0)] * 6) == [[]] * 24  # apart


def test_what_is_darker_than_the_map_is_dark_and_not_what_is_as_dark_as_it():
    peaks = Peaks(
        np.array([[20.0, 20.0], [60.0, 20.0]]), np.zeros(2), np.full(2, 16.0), np.full(2, 7.0),
        np.zeros(2),
    )  # fmt: skip
    image = np.full((40, 80, 3), 60, np.uint8)
    change = np.full((40, 80, 3), EVEN, np.uint8)
    change[:, 40:] -= 60  # the map has 120 there
    assert _find_dark(_sample_inside(peaks), image, change).tolist() == [False, True]
