"""geo-trax: the times of its files. Other tests: test_readers.py."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from geoaim.base.errors import TracksError
from geoaim.tracks.formats import read_tracks

HEAD = "Vehicle_ID,{}Ortho_X,Ortho_Y,Local_X,Local_Y,Latitude,Longitude,Vehicle_Length,"
HEAD += "Vehicle_Width,Vehicle_Class,Vehicle_Speed,Vehicle_Acceleration,Road_Section,Lane_Number,"
HEAD += "Visibility\n"


def write_table(path: Path, columns: str, times: list[str]) -> Path:
    """A car at 10 m/s, stamped as given, 30 times a second."""
    rows = "".join(
        f"1,{time},0,0,{1000 + 10 * k / 30:.4f},2000,37,126,4.6,1.9,0,,,,,1\n"
        for k, time in enumerate(times)
    )
    path.write_text(HEAD.format(columns) + rows)
    return path


def make_clock(start: float, pattern: str) -> list[str]:
    stamps = pd.Timestamp("2022-10-07") + pd.to_timedelta(start + np.arange(60) / 30, unit="s")
    return [stamp.strftime(pattern)[:-3] for stamp in stamps]


@pytest.mark.parametrize("start", [64333.5, 86399.0])  # the second one crosses midnight
def test_the_aggregated_form_has_times_of_a_day(tmp_path, start):
    times = [f"{time},1" for time in make_clock(start, "%H:%M:%S.%f")]
    tracks = read_tracks(write_table(tmp_path / "a.csv", "Local_Time,Drone_ID,", times))
    assert len(tracks.times) == 60
    np.testing.assert_allclose(tracks.states[0, 20:40, 3], 10.0, atol=0.1)


def test_dates_without_fractions_among_others_are_read(tmp_path):
    times = [time.removesuffix(".000") for time in make_clock(64333.0, "%Y-%m-%d %H:%M:%S.%f")]
    assert "." not in times[0]
    times = [f"{time},{k}" for k, time in enumerate(times)]
    tracks = read_tracks(write_table(tmp_path / "a.csv", "Timestamp,Frame_Number,", times))
    np.testing.assert_allclose(tracks.states[0, 20:40, 3], 10.0, atol=0.1)


def test_without_a_flight_log_frames_need_a_rate(tmp_path):
    path = write_table(tmp_path / "a.csv", "Frame_Number,", [str(k) for k in range(60)])
    with pytest.raises(TracksError, match=r"neither Timestamp nor Local_Time.*frame_rate="):
        read_tracks(path)
    tracks = read_tracks(path, frame_rate=30.0)
    np.testing.assert_allclose(tracks.states[0, 20:40, 3], 10.0, atol=1e-3)
    timed = write_table(tmp_path / "b.csv", "Timestamp,", [f"{k / 30:.4f}" for k in range(60)])
    with pytest.raises(TracksError, match="has times in the column Timestamp; omit frame_rate="):
        read_tracks(timed, frame_rate=30.0)
