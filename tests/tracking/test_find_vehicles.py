"""Vehicles without a detector: on the sample's video, and shapes that are drawn."""

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
from geoaim.base.world import World
from geoaim.cli import app
from geoaim.mapping.video.video import open_video
from geoaim.tracking.background_difference import UNIT, find_foreground, learn_ground
from geoaim.tracking.find_vehicles import finish_tracks, search_frames
from geoaim.tracking.frame_poses import locate_frames
from geoaim.tracking.vehicle_shapes import find_shapes
from geoaim.tracks.tracks import Tracks

SAMPLES = Path(__file__).parents[2] / "samples"
FRAMES = 20


@pytest.fixture(scope="module")
def video():
    whole = open_video(SAMPLES / "hover.mp4")
    frames = [replace(frame) for frame in islice(whole, FRAMES)]
    return open_video([frame.image for frame in frames], rate=whole.rate)


def test_moving_vehicles_of_the_sample_are_found_where_they_are(aim, video):
    poses = locate_frames(video, aim, None, no_progress)
    found = search_frames(video, aim, poses)
    truth = geoaim.read_tracks(SAMPLES / "tracks.csv")
    step = int(np.argmin(np.abs(poses.times - 0.5)))
    now = int(np.argmin(np.abs(truth.times - poses.times[step])))
    is_car = np.array([kind in ("car", "van", "truck", "bus") for kind in truth.types])
    moving = is_car & truth.present[:, now] & (np.abs(truth.states[:, now, 3]) > 2)
    places = truth.states[moving, now, :2]
    matrix = poses.world_from_frame[step]
    pixels = transform_points(np.linalg.inv(matrix), places)
    places = places[((pixels > 40) & (pixels < [1240, 680])).all(axis=1)]
    assert len(places)
    middles = transform_points(matrix, found[step].get_corners().mean(axis=1))
    distance = np.hypot(*(places[:, None] - middles[None]).transpose(2, 0, 1)).min(axis=1)
    assert np.median(distance) < 0.5
    assert (distance < 1.0).mean() > 0.7
    assert ((found[step].scores > 0) & (found[step].scores <= 1)).all()


def test_a_map_of_another_light_is_refused(aim, video):
    poses = locate_frames(video, aim, None, no_progress)
    noise = np.random.default_rng(0).integers(0, 256, aim.image.shape).astype(np.uint8)
    with pytest.raises(TracksError, match="differ from the map"):
        search_frames(video, replace(aim, image=noise), poses)


def test_a_coarse_video_is_refused(aim, video):
    poses = locate_frames(video, aim, None, no_progress)
    coarse = replace(poses, world_from_frame=np.diag([20.0, 20.0, 1.0]) @ poses.world_from_frame)
    with pytest.raises(TracksError, match="a pixel shows"):
        search_frames(video, aim, coarse)


def test_frames_that_are_registered_badly_are_not_compared(aim, video):
    poses = locate_frames(video, aim, None, no_progress)
    doubtful = replace(poses.registration, uncertainty=poses.registration.uncertainty + 20.0)
    with pytest.raises(TracksError, match=r"registered to .* m only"):
        search_frames(video, aim, replace(poses, registration=doubtful))


def test_what_differs_nearly_everywhere_is_no_vehicle():
    strength = np.full((430, 1764), 2 * UNIT, np.uint8)
    assert not len(find_shapes(strength, 0 * strength, 0.12, np.zeros(2)).corners)


def test_neighbours_are_told_apart():
    strength = np.zeros((100, 100), np.uint8)
    strength[20:58, 20:35] = strength[20:58, 40:55] = 2 * UNIT  # two cars of 1.8 m, 0.6 m apart
    strength[36:42, 34:41] = 2 * UNIT  # and something between them
    shapes = find_shapes(strength, 0 * strength, 0.12, np.zeros(2))
    assert len(shapes.corners) == 2
    sides = np.linalg.norm(shapes.corners[:, 1] - shapes.corners[:, 0], axis=1) * 0.12
    np.testing.assert_allclose(sides, 38 * 0.12, atol=0.3)
    np.testing.assert_allclose(np.sort(shapes.corners.mean(axis=1)[:, 0]), [27.5, 47.5], atol=1.5)


def test_the_blur_of_a_rim_makes_no_vehicle_longer():
    difference = np.zeros((60, 80))
    difference[20:36, 20:58] = 3.5  # tolerances
    strength = (UNIT * cv2.GaussianBlur(difference, (0, 0), 1.0)).clip(0, 255).astype(np.uint8)
    [corners] = find_shapes(strength, 0 * strength, 0.12, np.zeros(2)).corners
    sides = np.linalg.norm(np.diff(corners[:3], axis=0), axis=1)
    np.testing.assert_allclose(sides, [38, 16], atol=1.0)


def test_a_dark_car_whose_roof_looks_like_shadow_is_one():
    strength = np.zeros((60, 80), np.uint8)
    strength[20:36, 20:58] = 2 * UNIT
    strength[24:40, 25:63] = 2 * UNIT  # its shadow
    shaded = (strength > 0).astype(np.uint8)
    shaded[20:36, 20:30] = shaded[20:36, 44:58] = 0  # between its ends the roof, as dark
    shapes = find_shapes(strength, shaded, 0.12, np.array([5.0, 4.0]))
    assert len(shapes.corners) == 1
    np.testing.assert_allclose(shapes.corners[0].mean(axis=0), [39, 28], atol=1.0)


def make_tracks(paths, sizes, seen):
    """Tracks along paths, of which shares are seen."""
    states = np.zeros((len(paths), 20, 4))
    states[:, :, 0] = np.linspace(0, paths, 20).T
    return Tracks(
        times=np.arange(20) / 10,
        states=states,
        present=np.ones(states.shape[:2], bool),
        sizes=np.array(sizes, float),
        types=("",) * len(paths),
        ids=tuple("abcdef"[: len(paths)]),
        world=World(None),
        uncertainty=np.full((*states.shape[:2], 2), 0.05),
        seen=np.arange(20) < 20 * np.array(seen)[:, None],
    )


def test_small_pieces_that_stay_and_what_is_seldom_seen_are_no_vehicles():
    car, person, piece = (4.5, 1.8), (0.6, 0.6), (1.5, 0.6)
    tracks = make_tracks([0, 9, 3, 0.2], [car, car, person, piece], [1.0, 0.3, 1.0, 1.0])
    finished = finish_tracks(tracks)
    assert finished.ids == ("a", "c")
    np.testing.assert_allclose(finished.uncertainty[..., 0], np.hypot(0.05, 0.1))
    with pytest.raises(TracksError, match="1 tracks are found, all of small pieces"):
        finish_tracks(make_tracks([0], [piece], [1.0]))


def draw_traffic(count, standing, color=(230, 60, 60)):
    """Bright cars with shadows to the right on textured ground; one of a color stands for some."""
    generator = np.random.default_rng(3)
    ground = cv2.GaussianBlur(generator.uniform(80, 160, (160, 240)), (0, 0), 3)
    ground = np.repeat((ground + 20).clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)
    frames = []
    for step in range(count):
        frame = ground.copy()
        places = [(10 + 5 * step + 30 * k, 30 + 40 * k) for k in range(3)]
        colors = [(230, 60, 60)] * 3
        if step in standing:
            places.append((120, 140))
            colors.append(color)
        for (x, y), paint in zip(places, colors, strict=True):
            x = x % 200
            shade = frame[y : y + 16, x + 36 : x + 46]
            frame[y : y + 16, x + 36 : x + 46] = (0.5 * shade).astype(np.uint8)
            frame[y : y + 16, x : x + 36] = paint
        frames.append((frame, np.ones(ground.shape[:2], bool)))
    return ground, frames


def test_shadows_fall_to_one_side_and_belong_to_no_box():
    ground, frames = draw_traffic(30, ())
    learnt = learn_ground(ground, np.ones(ground.shape[:2], bool), frames, 0.12)
    assert abs(learnt.shadow - 0.5) < 0.1
    np.testing.assert_allclose(learnt.sun, [10.0, 0.0], atol=2.0)
    strength, shaded = find_foreground(learnt, *frames[2])
    shapes = find_shapes(strength, shaded, 0.12, learnt.sun)
    lengths = np.linalg.norm(shapes.corners[:, 1] - shapes.corners[:, 0], axis=1)
    assert len(lengths) == 3
    assert np.abs(lengths - 36).max() < 4


@pytest.mark.parametrize("standing", [range(18), range(3, 30), range(27)])
def test_what_stood_in_the_map_and_came_or_left_is_found_while_it_stood(standing):
    ground, frames = draw_traffic(30, standing)
    image = ground.copy()
    image[140:156, 120:156] = (230, 60, 60)  # the map shows the car that stood for most frames
    learnt = learn_ground(image, np.ones(ground.shape[:2], bool), frames, 0.12)
    for step in (0, 2, 15, 25, 29):
        strength, _ = find_foreground(learnt, *frames[step])
        assert ((strength[142:154, 124:152] > UNIT).mean() > 0.9) == (step in standing)


def test_what_stands_for_most_frames_is_no_noise_of_the_ground():
    standing = range(18)
    ground, frames = draw_traffic(30, standing, (95, 95, 95))  # little darker than the ground
    learnt = learn_ground(ground, np.ones(ground.shape[:2], bool), frames, 0.12)
    inside = slice(142, 154), slice(124, 152)
    differs = np.abs(ground[inside].astype(int) - 95).max(axis=2) > 20
    strength, _ = find_foreground(learnt, *frames[2])
    assert (strength[inside][differs] > UNIT).mean() > 0.9


def test_options_of_detections_need_detections(tmp_path):
    command = ["track", str(SAMPLES / "hover.mp4"), "--aim", "map.tif", "--form", "ltrb"]
    result = CliRunner().invoke(app, [*command, "-o", str(tmp_path / "tracks.csv")])
    assert result.exit_code == 1
    assert "--detections" in result.output
