"""geo-trax: a round trip of its tables, and its files in pixels. Other tests: test_readers.py."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from geoaim.aim.aim import AIM
from geoaim.base.errors import GeoaimWarning, GeoreferenceError, TracksError
from geoaim.base.world import World, crs_from_world
from geoaim.tracks.files import read_plain_tracks
from geoaim.tracks.formats import read_geotrax, read_geotrax_pixels, read_tracks, write_geotrax

SAMPLE = read_plain_tracks(Path(__file__).parents[3] / "samples/tracks.csv")
VEHICLES = [kind in ("car", "van", "bus", "truck") for kind in SAMPLE.types]
PIXELS = "".join(
    f"{k},{track},{100 + 9 * k},50,40,20,{100 + 10 * k},50,40,20,{kind},0.9,{length},18.5\n"
    for track, kind, length in ((1, 0, 45), (2, 1, "nan"))
    for k in range(8)
)


def test_vehicles_come_back_from_a_written_table(tmp_path):
    path = tmp_path / "a.csv"
    with pytest.warns(GeoaimWarning, match=r"agents are left out, whose types geo-trax does not"):
        write_geotrax(SAMPLE, path)
    tracks = read_tracks(path, world=SAMPLE.world)
    assert tracks.ids == tuple(np.array(SAMPLE.ids)[VEHICLES])
    assert len(tracks.ids) > 20
    kinds = np.array(SAMPLE.types)[VEHICLES]
    assert tracks.types == tuple("car" if kind == "van" else kind for kind in kinds)
    rows = SAMPLE.present[VEHICLES]
    np.testing.assert_allclose(tracks.times, SAMPLE.times[rows.any(axis=0)] - tracks.times[0])
    wanted = crs_from_world(SAMPLE.world, SAMPLE.states[VEHICLES][rows][:, :2])
    found = crs_from_world(tracks.world, tracks.states[tracks.present][:, :2])
    np.testing.assert_allclose(found, wanted, atol=6e-4)
    np.testing.assert_allclose(tracks.sizes, SAMPLE.sizes[VEHICLES], atol=0.006)


def test_written_table_has_the_columns_and_units_of_geotrax(tmp_path):
    states = np.array([[[10.0, 20.0, 0.0, 10.0], [11.0, 20.0, 0.0, 10.2]]])
    fields = {"times": np.array([0.0, 0.1]), "states": states, "present": np.ones((1, 2), bool)}
    fields |= {"sizes": np.array([[4.5, 1.8]]), "types": ("van",), "ids": ("north",)}
    tracks = replace(SAMPLE, **fields)
    matrix = np.array([[0.5, 0, 0], [0, -0.5, 100], [0, 0, 1.0]])
    aim = AIM.from_image(np.zeros((200, 200, 3), np.uint8), matrix, SAMPLE.world, "test")
    write_geotrax(tracks, tmp_path / "a.csv", aim=aim)
    table = pd.read_csv(tmp_path / "a.csv")
    assert ",".join(table.columns) == (
        "Vehicle_ID,Timestamp,Frame_Number,Ortho_X,Ortho_Y,Local_X,Local_Y,Latitude,Longitude,"
        "Vehicle_Length,Vehicle_Width,Vehicle_Class,Vehicle_Speed,Vehicle_Acceleration,"
        "Road_Section,Lane_Number,Visibility"
    )
    assert table["Vehicle_ID"].tolist() == [1, 1]
    assert table["Frame_Number"].tolist() == [0, 1]
    assert table[["Ortho_X", "Ortho_Y"]].iloc[0].tolist() == [20.0, 160.0]
    assert table["Vehicle_Speed"].tolist() == [36.0, 36.7]
    assert table["Vehicle_Acceleration"].iloc[0] == 2.0
    assert table["Vehicle_Class"].tolist() == [0, 0]


def test_tracks_without_a_crs_or_vehicles_cannot_be_written(tmp_path):
    with (
        pytest.raises(GeoreferenceError, match="without a CRS"),
        pytest.warns(GeoaimWarning, match="are left out"),
    ):
        write_geotrax(replace(SAMPLE, world=World(None)), tmp_path / "a.csv")
    walking = replace(SAMPLE, types=("pedestrian",) * len(SAMPLE.types))
    with pytest.raises(TracksError, match="no agent is one of car, bus, truck, motorcycle, van"):
        write_geotrax(walking, tmp_path / "a.csv")


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
