"""Tracks of a pandas DataFrame."""

import numpy as np
import pandas as pd
import pytest

import geoaim
from geoaim.base.errors import TracksError
from geoaim.tracks.tracks import Tracks

TIMES = np.arange(0.0, 2.05, 0.1)


@pytest.fixture
def frame() -> pd.DataFrame:
    """A car that drives north-east at 10 m/s, and one that stands."""
    along = 10 * TIMES / np.sqrt(2)
    car = pd.DataFrame({"id": 1, "time": TIMES, "x": along, "y": along})
    return pd.concat([car, pd.DataFrame({"id": 2, "time": TIMES, "x": 30.0, "y": 0.0})])


def test_motion_and_sizes_are_taken_where_they_lack(frame: pd.DataFrame) -> None:
    tracks = Tracks.from_dataframe(frame)
    assert tracks.types == ("car", "car")
    np.testing.assert_allclose(tracks.states[0, :, 2:], [[np.pi / 4, 10.0]] * len(TIMES))
    np.testing.assert_allclose(tracks.states[1, :, 3], 0.0)
    np.testing.assert_allclose(tracks.sizes, [[4.5, 1.8]] * 2)


def test_a_table_comes_back_as_it_went(frame: pd.DataFrame) -> None:
    tracks = Tracks.from_dataframe(frame)
    again = geoaim.read_tracks(tracks.to_dataframe())
    pd.testing.assert_frame_equal(again.to_dataframe(), tracks.to_dataframe())


def test_headings_stay_where_only_speeds_lack(frame: pd.DataFrame) -> None:
    backwards = Tracks.from_dataframe(frame.assign(heading=-3 * np.pi / 4))
    np.testing.assert_allclose(backwards.states[0, :, 2:], [[-3 * np.pi / 4, -10.0]] * len(TIMES))


def test_long_ones_without_type_are_trucks(frame: pd.DataFrame) -> None:
    tracks = Tracks.from_dataframe(frame.assign(length=[12.0] * len(TIMES) + [4.0] * len(TIMES)))
    assert tracks.types == ("truck", "car")


def test_frames_and_dates_are_times(frame: pd.DataFrame) -> None:
    times = Tracks.from_dataframe(frame).times
    numbered = frame.drop(columns="time").assign(frame=np.rint(frame["time"] * 10))
    np.testing.assert_allclose(Tracks.from_dataframe(numbered, frame_rate=10).times, times)
    dates = pd.Timestamp("2026-05-01 12:00") + pd.to_timedelta(frame["time"], unit="s")
    np.testing.assert_allclose(Tracks.from_dataframe(frame.assign(time=dates)).times, times)


@pytest.mark.parametrize(
    ("changed", "message"),
    [({"id": "track_id"}, "rename.*'track_id': 'id'"), ({"time": "frame"}, "Give frame_rate=")],
)
def test_missing_columns_are_named_with_the_remedy(
    frame: pd.DataFrame, changed: dict[str, str], message: str
) -> None:
    with pytest.raises(TracksError, match=message):
        Tracks.from_dataframe(frame.rename(columns=changed))


def test_pixels_are_refused(frame: pd.DataFrame) -> None:
    with pytest.raises(ValueError, match="in metres"):
        geoaim.read_tracks(frame, resolution=0.1)
