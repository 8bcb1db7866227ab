import gzip
from functools import partial

import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.base.world import World, lonlat_from_world
from geoaim.tracks.formats import read_geotrax, read_interaction, read_sdd

INTERACTION = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n"
GEOTRAX = (
    "Vehicle_ID,Timestamp,Frame_Number,Ortho_X,Ortho_Y,Local_X,Local_Y,Latitude,Longitude,"
    "Vehicle_Length,Vehicle_Width,Vehicle_Class\n"
)


def test_interaction_gives_states_as_written(tmp_path):
    path = tmp_path / "vehicle_tracks_000.csv"
    path.write_text(
        INTERACTION
        + "1,1,100,car,10.0,20.0,3.0,4.0,0.927,4.5,1.8\n"
        + "1,2,200,car,10.3,20.4,3.0,4.0,0.927,4.5,1.8\n"
        + "P1,2,200,Pedestrian,1,2,0,1,,,\n"
    )
    tracks = read_interaction(path)
    assert tracks.types == ("car", "pedestrian")
    np.testing.assert_allclose(tracks.states[0, 0], [10, 20, 0.927, 5])
    np.testing.assert_allclose(tracks.states[1, 1], [1, 2, np.pi / 2, 1])
    np.testing.assert_allclose(tracks.sizes[1], 0.5)
    np.testing.assert_allclose(tracks.times, [0.1, 0.2])


def test_origin_of_kits_meta_data_places_its_tracks(tmp_path):
    path, meta = tmp_path / "vehicle_tracks_000.csv", tmp_path / "meta_data.csv"
    path.write_text(INTERACTION + "1,1,100,Bike,10.0,20.0,3.0,4.0,0.927,,\n")
    meta.write_text("id,originLat,originLon\n000,49.005306,8.4374089\n001,49.005306,8.4374089\n")
    tracks = read_interaction(path)
    assert tracks.types == ("cyclist",)
    assert tracks.world.crs == "EPSG:32632"
    lonlat = lonlat_from_world(tracks.world, np.zeros((1, 2)))
    np.testing.assert_allclose(lonlat, [[8.4374089, 49.005306]], atol=1e-8)
    given = World("EPSG:25832", (459000.0, 5428000.0))
    assert read_interaction(path, world=given).world == given
    meta.write_text("id,originLat,originLon\n000,49.0,8.4\n001,49.1,8.4\n")
    with pytest.raises(TracksError, match=r"meta_data.csv has 2 origins; one is needed, or give"):
        read_interaction(path)
    meta.write_text("name\nsomething else\n")
    assert read_interaction(path).world == World(None)


def test_interaction_keeps_the_first_of_repeated_rows_and_warns(tmp_path):
    path = tmp_path / "a.csv"
    row = "1,1,100,car,{},20.0,3.0,4.0,0.927,4.5,1.8\n"
    path.write_text(INTERACTION + row.format(1) + row.format(2))
    with pytest.warns(GeoaimWarning, match="1 rows repeat an agent's time"):
        assert read_interaction(path).states[0, 0, 0] == 1


def test_unknown_agent_types_are_kept_and_one_warning_names_them(tmp_path):
    path = tmp_path / "a.csv"
    names = ("Pedestrian/Bicycle", "tricycle", "Bicycle", "motorcycle")
    path.write_text(INTERACTION + "".join(f"{n},1,100,{n},0,0,1,0,,,\n" for n in names))
    with pytest.warns(GeoaimWarning) as warned:
        tracks = read_interaction(path)
    assert tracks.types == ("pedestrian/bicycle", "tricycle", "cyclist", "motorcycle")
    np.testing.assert_allclose(tracks.sizes[:2], 0.5)
    (message,) = [str(warning.message) for warning in warned]
    assert "unknown agent types 'pedestrian/bicycle', 'tricycle'; they are kept" in message
    assert "0.5 x 0.5 m" in message


def test_geotrax_names_unknown_classes_by_their_numbers_and_warns(tmp_path):
    path = tmp_path / "a.csv"
    rows = [f"{k},0,0,0,0,{k},0,37,126,4.9,1.9,{k}" for k in (1, 9)]
    path.write_text(GEOTRAX + "\n".join(rows))
    with pytest.warns(GeoaimWarning, match="unknown agent types 'class 9'"):
        assert read_geotrax(path).types == ("bus", "class 9")


def test_sdd_turns_boxes_into_metres_and_motion_into_headings(tmp_path):
    lines = [f'0 {10 * k} 100 {10 * k + 20} 140 {6 * k} 0 0 0 "Biker"' for k in range(10)]
    lines.append('1 0 0 10 10 0 1 0 0 "Pedestrian"')  # lost
    path = tmp_path / "annotations.txt.gz"
    path.write_bytes(gzip.compress("\n".join(lines).encode()))
    tracks = read_sdd(path, resolution=0.1)
    assert tracks.types == ("cyclist",)
    np.testing.assert_allclose(tracks.states[0, 0, :2], [1.0, -12.0])
    np.testing.assert_allclose(tracks.states[0, :, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(tracks.states[0, :, 3], 1.0 / 0.2)


def test_geotrax_subtracts_an_origin_and_gives_typical_sizes(tmp_path):
    path = tmp_path / "a.csv"
    rows = [
        f"1,2022-10-07 17:52:13.{k}00,{k},0,0,{170000 + k},532000.0,37,126,4.9,1.9,0"
        for k in range(5)
    ]
    rows.append("2,2022-10-07 17:52:13.000,0,0,0,170010,532010,37,126,,,0")
    path.write_text(GEOTRAX + "\n".join(rows))
    tracks = read_geotrax(path, crs="EPSG:5186")
    assert tracks.world.crs == "EPSG:5186"
    east, north = tracks.states[0, 0, :2] + tracks.world.origin
    assert (east, north) == (170000.0, 532000.0)
    np.testing.assert_allclose(tracks.sizes, [[4.9, 1.9], [4.5, 1.8]])
    np.testing.assert_allclose(tracks.states[0, 1:4, 3], 10.0)


@pytest.mark.parametrize("read", [read_interaction, read_geotrax])
def test_a_file_of_another_dataset_is_refused_with_its_missing_columns(tmp_path, read):
    path = tmp_path / "a.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(TracksError, match="lacks the columns"):
        read(path)


def test_real_files_read(data_folder):
    songdo = read_geotrax(data_folder / "tracks/songdo_u/U_video_cut.csv", crs="EPSG:5186")
    assert songdo.present.shape == (144, 150)
    path = next((data_folder / "tracks/sdd_raw").glob("gates/video4/annotations.txt.gz"))
    tracks = read_sdd(path, resolution=0.0441)
    assert "pedestrian" in tracks.types
    walking = tracks.states[[t == "pedestrian" for t in tracks.types], :, 3]
    assert 0.8 < np.nanmedian(walking[walking > 0.5]) < 1.8


SHORT = "track_id,timestamp_ms,agent_type,x,y,vx,vy\n"


def test_interaction_track_ids_are_unique_per_case(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("case_id," + SHORT + "1,1,0,car,0,0,1,0\n2,1,0,car,500,0,1,0\n")
    assert read_interaction(path).ids == ("1/1", "2/1")


def test_a_standing_agent_keeps_its_direction(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(SHORT + "1,0,pedestrian,0,0,0,1\n1,100,pedestrian,0,0.1,0,0\n")
    np.testing.assert_allclose(read_interaction(path).states[0, :, 2], np.pi / 2)


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (read_interaction, "", "not a table of tracks"),
        (read_interaction, SHORT, "has no rows"),
        (read_interaction, SHORT + "1,soon,car,0,0,1,0\n", "timestamp_ms is 'soon' in row 2"),
        (read_interaction, SHORT + "1,0,car,0,0,1,0,9\n", "more fields"),
        (read_geotrax, GEOTRAX, "has no rows"),
        (read_geotrax, GEOTRAX + "1,noon,0,0,0,1,2,37,126,4,2,0\n", "Timestamp is not a time"),
        (partial(read_sdd, resolution=0.1), "0 1 2 3 4 5 1 0 0 Biker\n", "row is marked as lost"),
        (partial(read_sdd, resolution=0.1), "0 1 2 3\n", "4 columns; 10 are needed"),
    ],
)
def test_broken_files_are_refused_with_their_reason(tmp_path, read, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(TracksError, match=message):
        read(path)


def test_sdd_needs_a_resolution(tmp_path):
    with pytest.raises(ValueError, match="positive number"):
        read_sdd(tmp_path / "a.txt", resolution=0.0)
