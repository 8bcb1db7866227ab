from dataclasses import replace

import numpy as np
import pytest

from geoaim.base.errors import TracksError
from geoaim.base.world import World
from geoaim.mapping import place_tracks, register
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.video.video import open_video
from geoaim.tracks.tracks import Tracks
from tests.conftest import textured

LEFT_PX = (0, 6, 12, 18)  # of frames of 480 x 320 px on one ground
RATE, RESOLUTION, READ_RESOLUTION = 5.0, 0.1, 0.04


@pytest.fixture(scope="module")
def registration():
    ground = textured(np.random.default_rng(3), 320, 520)
    frames = [ground[:, left : left + 480] for left in LEFT_PX]
    return register(open_video(frames, rate=RATE), reference_time=0)


def make_tracks(times):
    """An agent that moves by 10 px to the right from frame to frame over the ground."""
    u = 100.0 + 10 * np.arange(4) - LEFT_PX
    positions = READ_RESOLUTION * np.stack([u, np.full(4, -80.0)], axis=1)
    states = np.column_stack([positions, np.zeros((4, 2))])[None]
    present, sizes = np.ones((1, 4), bool), np.array([[4.5, 1.8]])
    return Tracks(times, states, present, sizes, ("car",), ("a",), World(None))


def place(tracks, registration):
    georeference = make_local_georeference(resolution=RESOLUTION, size=(320, 480))
    return place_tracks(tracks, registration, georeference, resolution=READ_RESOLUTION)


def test_tracks_in_pixels_of_a_moving_camera_lie_in_the_world(registration):
    placed = place(make_tracks(np.arange(4) / RATE), registration)
    x, y, heading, speed = placed.states[0].T
    np.testing.assert_allclose(x, RESOLUTION * (100 + 10 * np.arange(4)), atol=0.02)
    np.testing.assert_allclose(y, -RESOLUTION * 80, atol=0.02)
    np.testing.assert_allclose(heading, 0, atol=0.02)
    np.testing.assert_allclose(speed, RESOLUTION * 10 * RATE, rtol=0.02)


def test_tracks_of_another_video_are_refused(registration):
    with pytest.raises(TracksError, match=r"no frame of the registration is at 0.3 s"):
        place(make_tracks(np.array([0.0, 0.2, 0.3, 0.4])), registration)


def test_frame_numbers_find_their_frames_on_irregular_stamps(registration):
    stamps = np.array([0.0, 1.0, 1.2, 1.4])  # a recorder that dropped the frames of a second
    irregular = replace(registration, time=stamps)
    georeference = make_local_georeference(resolution=RESOLUTION, size=(320, 480))
    options = {"resolution": READ_RESOLUTION, "frame_rate": 30.0}
    placed = place_tracks(make_tracks(np.arange(4) / 30), irregular, georeference, **options)
    np.testing.assert_allclose(placed.times, stamps)
    x = placed.states[0, :, 0]
    np.testing.assert_allclose(x, RESOLUTION * (100 + 10 * np.arange(4)), atol=0.02)
    with pytest.raises(TracksError, match="agents in frame 4, which the registration has not"):
        place_tracks(make_tracks(np.arange(1, 5) / 30), irregular, georeference, **options)
