"""Argoverse 2 scenarios, made by the schema of av2-api's data_schema.py."""

import numpy as np
import pandas as pd
import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.base.world import World, lonlat_from_world
from geoaim.tracks.formats import read_argoverse, read_tracks


def make_table(**changes) -> pd.DataFrame:
    """A car at 10 m/s north, a standing bus, a cyclist in the last step and a traffic cone."""
    steps = np.arange(110)
    parts = [
        pd.DataFrame({"track_id": "72", "object_type": "vehicle", "timestep": steps, "y": steps}),
        pd.DataFrame({"track_id": "AV", "object_type": "bus", "timestep": steps, "y": 5.0}),
        pd.DataFrame({"track_id": "9", "object_type": "cyclist", "timestep": [109], "y": 7.0}),
        pd.DataFrame({"track_id": "8", "object_type": "construction", "timestep": [0], "y": 1.0}),
    ]
    table = pd.concat(parts, ignore_index=True).rename(columns={"y": "position_y"})
    moves = table["track_id"] == "72"
    return table.assign(
        observed=table["timestep"] < 50,
        object_category=1,
        position_x=3.0,
        heading=np.where(moves, np.pi / 2, 0.0),
        velocity_x=0.0,
        velocity_y=np.where(moves, 10.0, 0.0),
        scenario_id="0a0a2bb7",
        start_timestamp=315966070559696000,
        end_timestamp=315966081459696000,
        num_timestamps=110,
        focal_track_id="72",
        city="pittsburgh",
        map_id=1,
        slice_id="s",
    ).assign(**changes)


def write(folder, table=None):
    path = folder / "scenario_0a0a2bb7.parquet"
    (make_table() if table is None else table).to_parquet(path)
    return path


def test_scenario_is_read_with_its_states_times_and_types(tmp_path):
    tracks = read_tracks(write(tmp_path))
    assert tracks.ids == ("72", "AV", "9", "8")
    assert tracks.types == ("car", "bus", "cyclist", "construction")
    np.testing.assert_allclose(tracks.times, np.arange(110) / 10)
    np.testing.assert_allclose(tracks.states[0, 20], [3, 20, np.pi / 2, 10])
    assert tracks.present.sum(axis=1).tolist() == [110, 110, 1, 1]
    np.testing.assert_allclose(tracks.sizes[:2], [[4.5, 1.8], [12.0, 2.5]])


def test_scenario_lies_in_its_city(tmp_path):
    world = read_argoverse(write(tmp_path)).world
    assert world.crs == "EPSG:32617"
    np.testing.assert_allclose(
        lonlat_from_world(world, np.zeros((1, 2)))[0], [-80.01294377242584, 40.44177902989321]
    )


@pytest.mark.parametrize(
    ("city", "zone"),
    [("austin", 14), ("dearborn", 17), ("miami", 17), ("palo-alto", 10), ("washington-dc", 18)],
)
def test_scenario_lies_in_the_utm_zone_of_its_city(tmp_path, city, zone):
    world = read_tracks(write(tmp_path, make_table(city=city))).world
    assert world.crs == f"EPSG:{32600 + zone}"


def test_city_that_is_not_one_of_the_six_needs_a_world(tmp_path):
    path = write(tmp_path, make_table(city="Minsk"))
    with pytest.raises(TracksError, match=r"city 'Minsk' is not one of austin.*give a world"):
        read_argoverse(path)
    assert read_tracks(path, world=World("EPSG:32635")).world == World("EPSG:32635")


def test_unknown_type_is_kept_with_a_warning(tmp_path):
    table = make_table()
    table["object_type"] = table["object_type"].replace("cyclist", "Tram")
    with pytest.warns(GeoaimWarning, match="unknown agent types 'tram'"):
        assert read_argoverse(write(tmp_path, table)).types[2] == "tram"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (make_table().drop(columns="heading"), "lacks the columns heading"),
        (make_table(end_timestamp=0), "an end after the start"),
        (make_table(num_timestamps=1), "two or more steps"),
        (make_table(position_x="left"), "position_x is 'left' in row 1"),
        (make_table().iloc[:0], "has no rows"),
        (make_table(position_x=np.nan), "x 'nan' is missing"),
    ],
)
def test_broken_scenario_is_refused_with_its_reason(tmp_path, table, message):
    with pytest.raises(TracksError, match=message):
        read_argoverse(write(tmp_path, table))


def test_file_that_is_no_parquet_and_missing_file_are_refused(tmp_path):
    path = tmp_path / "a.parquet"
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_argoverse(path)
    path.write_bytes(b"PAR1")
    with pytest.raises(TracksError, match=r"a\.parquet is not an Argoverse 2 scenario"):
        read_argoverse(path)
    with pytest.raises(TracksError, match=r"a\.parquet is not a table of tracks"):
        read_tracks(path)
