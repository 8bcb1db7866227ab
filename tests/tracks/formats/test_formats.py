import numpy as np
import pandas as pd
import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.base.world import World
from geoaim.tracks.formats import derive_speeds, read_tracks
from geoaim.tracks.formats.formats import detect_format
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.tables import make_tracks
from tests.tracks.formats import test_interaction, test_levelx, test_pixels, test_readers

COLUMNS = "id,type,time,x,y,heading,speed,length,width\n"


@pytest.mark.parametrize(
    ("head", "name"),
    [
        ("# crs: local\n", "plain"),
        (COLUMNS, "plain"),
        (test_readers.INTERACTION, "INTERACTION"),
        ("track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy\n", "INTERACTION"),
        (test_interaction.VEHICLES, "SinD"),
        (test_interaction.PEDESTRIANS, "SinD"),
        (test_levelx.IND, "inD"),
        (test_levelx.HIGHD, "highD"),
        (test_readers.GEOTRAX, "geo-trax"),
        (test_pixels.DUT, "pixel"),
        (test_pixels.PLAIN, "pixel"),
        ('0 1360 1073 1394 1131 10 1 0 0 "Pedestrian"\n', "SDD"),
    ],
)
def test_the_format_is_detected_from_the_first_line(tmp_path, head, name):
    (tmp_path / "a.csv").write_text("\ufeff" + head, encoding="utf-8")
    assert detect_format(tmp_path / "a.csv").name == name


def test_any_format_is_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# crs: local\n" + COLUMNS + "1,car,0,1,2,0,1,4,2\n")
    assert read_tracks(path).ids == ("1",)
    assert len(read_tracks(test_levelx._write_ind(tmp_path)).ids) == 4
    assert len(read_tracks(test_levelx._write_highd(tmp_path)).ids) == 3
    test_interaction._write(tmp_path)
    assert len(read_tracks(tmp_path).ids) == 3


def test_the_given_world_is_used_where_the_file_states_none(tmp_path):
    path, world = tmp_path / "a.csv", World("EPSG:32632", (459000.0, 5428000.0))
    path.write_text(test_readers.SHORT + "1,0,pedestrian,0,0,0,1\n")
    assert read_tracks(path, world=world).world == world
    path.write_text(test_readers.GEOTRAX + "1,0,0,0,0,459010,5428000,49,8,4,2,0\n")
    assert read_tracks(path, world=world).world.crs == "EPSG:32632"


def test_missing_and_superfluous_options_are_refused(tmp_path):
    path = tmp_path / "annotations.txt"
    path.write_text('0 10 10 20 20 0 0 0 0 "Biker"\n')
    with pytest.raises(
        ValueError, match=r"needs a resolution: give resolution=, metres per pixel, such as 0.04"
    ):
        read_tracks(path)
    assert read_tracks(path, resolution=0.1).types == ("cyclist",)
    with pytest.raises(ValueError, match=r"resolution is -0.1; a positive"):
        read_tracks(path, resolution=-0.1)
    with pytest.raises(ValueError, match="SDD format, which takes no world"):
        read_tracks(path, resolution=0.1, world=World(None))
    with pytest.raises(ValueError, match="inD format, which takes no resolution"):
        read_tracks(test_levelx._write_ind(tmp_path), resolution=0.1)


@pytest.mark.parametrize("content", [b"a,b\n1,2\n", b"", bytes(range(128, 256))])
@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz"])
def test_a_file_in_no_known_format_is_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TracksError, match="is not a table of tracks"):
        read_tracks(tmp_path / name)


def test_columns_of_a_format_with_another_delimiter_need_commas(tmp_path):
    (tmp_path / "a.csv").write_text(COLUMNS.replace(",", ";"))
    with pytest.raises(TracksError, match="separate them with commas"):
        read_tracks(tmp_path / "a.csv")


def test_a_missing_file_is_reported_as_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_tracks(tmp_path / "nowhere.csv")


def test_real_files_are_read(data_folder):
    tracks = data_folder / "tracks"
    assert len(read_tracks(next((tracks / "sind/Changchun").glob("*/Ped*.csv")).parent).ids) == 49
    world = World("EPSG:5186")
    assert len(read_tracks(tracks / "songdo_u/U_video_cut.csv", world=world).ids) == 144
    path = next((tracks / "sdd_raw").glob("gates/video4/annotations.txt.gz"))
    assert "pedestrian" in read_tracks(path, resolution=0.0441).types


def test_a_window_shorter_than_the_time_between_states_reaches_the_neighbours():
    columns = {"id": "1", "type": "car", "time": [0.0, 1.0, 2.0], "x": [0.0, 4.0, 8.0], "y": 0.0}
    rows = pd.DataFrame({**columns, "length": 4.5, "width": 1.8})
    tracks = make_tracks_from_positions(rows, World(None), half_window=0.25)
    assert tracks.states[0, :, 3].tolist() == [4.0, 4.0, 4.0]


def test_derived_speeds_keep_headings_and_are_negative_against_them():
    columns = {"id": ["1", "1", "2"], "type": "car", "time": [0.0, 1.0, 0.0], "x": [0.0, 4.0, 9.0]}
    rows = pd.DataFrame({**columns, "y": 0.0, "heading": [-3.0, -3.0, 1.0], "speed": 7.0})
    rows = rows.assign(length=4.5, width=1.8)
    tracks = derive_speeds(make_tracks(rows, World(None)), half_window=0.25)
    np.testing.assert_array_equal(tracks.states[..., 2], [[-3, -3], [1, np.nan]])
    np.testing.assert_array_equal(tracks.states[..., 3], [[-4, -4], [0, np.nan]])


@pytest.mark.filterwarnings("ignore:.*repeat an agent's time")
def test_a_real_file_with_reversed_headings_warns_and_takes_them_from_positions(data_folder):
    folder = data_folder / "tracks/karlsruhe/tracks"
    good = read_tracks(folder / "k729_2022-03-16/vehicle_tracks_003.csv")
    with pytest.warns(GeoaimWarning, match="taken from the positions"):
        derived = read_tracks(folder / "k733_2018-05-02/vehicle_tracks_000.csv")
    for tracks in (good, derived):
        step = np.diff(tracks.states[..., :2], axis=1)
        heading = tracks.states[:, :-1, 2]
        along = step[..., 0] * np.cos(heading) + step[..., 1] * np.sin(heading)
        assert (along[np.hypot(step[..., 0], step[..., 1]) > 0.2] > 0).mean() > 0.99


def test_observed_motion_lags_and_is_unknown_at_first():
    """A car that stands for a second, and then drives north at 5 m/s."""
    times = np.arange(31) / 10
    rows = pd.DataFrame(
        {"id": 1, "type": "car", "time": times, "x": 0.0, "length": 4.0, "width": 2}
    )
    rows["y"] = 5 * np.maximum(times - 1, 0)
    tracks = make_tracks_from_positions(rows, World(None), half_window=0.25)
    observed = tracks.get_observed()[0]
    assert np.flatnonzero(np.isfinite(observed[:, 0]))[0] == 4  # half of 0.75 s after the first row
    assert tracks.states[0, 0, 2] == pytest.approx(np.pi / 2)  # known from later rows
    assert observed[4, 2] == 0
    assert observed[20] == pytest.approx([0, 5, np.pi / 2, 5])
    assert 0 < observed[12, 3] < tracks.states[0, 12, 3] + 1e-9
