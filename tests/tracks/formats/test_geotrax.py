"""geo-trax: its files in pixels, real ones, and their times. Other tests: test_readers.py."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from geoaim.base.errors import TracksError
from geoaim.tracks.formats import read_geotrax, read_geotrax_pixels, read_tracks

PIXELS = "".join(
    f"{k},{track},{100 + 9 * k},50,40,20,{100 + 10 * k},50,40,20,{kind},0.9,{length},18.5\n"
    for track, kind, length in ((1, 0, 45), (2, 1, "nan"))
    for k in range(8)
)


def test_file_in_pixels_is_read_in_its_reference_frame(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(PIXELS)
    tracks = read_tracks(path, resolution=0.1)
    assert (tracks.ids, tracks.types) == (("1", "2"), ("car", "bus"))
    np.testing.assert_allclose(tracks.states[0, 2, :2], [12.0, -5.0])
    np.testing.assert_allclose(tracks.states[0, :, 3], 29.97, atol=0.01)
    np.testing.assert_allclose(tracks.times[:2], [0, 1001 / 30000], atol=1e-6)
    np.testing.assert_allclose(tracks.sizes, [[4.5, 1.85], [12.0, 1.85]])
    moving = read_geotrax_pixels(path, resolution=0.1, frame_rate=10.0, stabilised=False)
    np.testing.assert_allclose(moving.states[0, 2, :2], [11.8, -5.0])
    assert moving.times[-1] == pytest.approx(0.7)
    given = read_tracks(path, resolution=0.1, frame_rate=10.0)
    assert given.times[-1] == pytest.approx(0.7)


def test_broken_files_in_pixels_are_refused(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(PIXELS)
    with pytest.raises(ValueError, match="needs a resolution"):
        read_tracks(path)
    with pytest.raises(ValueError, match=r"frame_rate is 0.0; a positive"):
        read_geotrax_pixels(path, resolution=0.1, frame_rate=0.0)
    path.write_text("1,2,3\n")
    with pytest.raises(TracksError, match="has 3 columns; 14 or 15 are needed"):
        read_geotrax_pixels(path, resolution=0.1)
    path.write_text(PIXELS.replace("\n", ",x\n"))
    with pytest.raises(TracksError, match=r"a\.txt"):
        read_tracks(path, resolution=0.1)


def test_real_files_agree(data_folder):
    folder = data_folder / "tracks/songdo_u"
    metres = read_geotrax(folder / "U_video_cut.csv", crs="EPSG:5186")
    pixels = read_tracks(folder / "U_video_cut.txt", resolution=0.027)
    shared = [name for name in metres.ids if name in pixels.ids]
    assert len(shared) > 140
    for tracks in (metres, pixels):
        rows = [tracks.ids.index(name) for name in shared]
        speeds = np.nanmedian(tracks.states[rows, :, 3], axis=1)
        assert 3 < np.median(speeds[speeds > 1]) < 15


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
