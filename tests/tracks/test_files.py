import json

import numpy as np
import pandas as pd
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pyarrow import parquet

from geoaim import GeoaimError, Tracks, World, write_tracks
from geoaim.base.errors import TracksError
from geoaim.tracks.files import read_plain_tracks
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import COLUMNS
from tests.tracks.test_tables import WORLD, make_row
from tests.tracks.test_tracks import two_agents


@pytest.mark.parametrize("name", ["tracks.csv", "tracks.parquet"])
@pytest.mark.parametrize("world", [WORLD, World(None)])
def test_written_tracks_read_back(tmp_path, name, world):
    tracks = two_agents(world=world)
    write_tracks(tracks, tmp_path / name)
    again = read_plain_tracks(tmp_path / name)
    np.testing.assert_allclose(again.states, tracks.states)
    np.testing.assert_array_equal(again.present, tracks.present)
    np.testing.assert_allclose(again.times, tracks.times, atol=1e-9)
    np.testing.assert_array_equal(again.sizes, tracks.sizes)
    assert (again.types, again.ids, again.world) == (tracks.types, tracks.ids, tracks.world)


@given(present=arrays(bool, (2, 3)), seed=st.integers(0, 99))
def test_csv_keeps_millimetres(tmp_path_factory, present, seed):
    if not present.any():
        return
    tracks = two_agents(present=present[present.any(axis=1)])
    states = tracks.states + np.random.default_rng(seed).normal(0, 500, tracks.states.shape)
    states[..., 2] = np.arctan2(states[..., 2], 100.0)
    moved = Tracks(
        tracks.times, states, tracks.present, tracks.sizes, tracks.types, tracks.ids, WORLD
    )
    path = tmp_path_factory.mktemp("csv") / "tracks.csv"
    write_tracks(moved, path)
    again = read_plain_tracks(path)
    seen = moved.present.any(axis=0)
    order = [again.ids.index(name) for name in moved.ids]
    np.testing.assert_allclose(again.states[order], states[:, seen], atol=0.00051)


def test_the_file_states_crs_origin_and_columns(tmp_path):
    write_tracks(two_agents(), tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[:2] == ["# crs: EPSG:32635", "# origin: 583000.0 6062000.0"]
    assert lines[2:4] == ["# format: 1", ",".join(COLUMNS)]
    assert lines[4] == "7,car,0.0,0.0,0.1,0.2,0.3,4.5,1.8"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,type,time\n1,car,0\n", "is not '# crs"),
        ("# crs: local\nid,type,time\n1,car,0\n", "lacks the columns x, y, heading"),
        ("# crs: local\n# origin: 5\nid\n", "origin '5' is not two numbers"),
        ("# crs: local\n" + ",".join(COLUMNS) + "\n", "no rows"),
        (
            "# crs: local\n" + ",".join(COLUMNS) + "\n1,car,0,a,2,3,4,5,6\n",
            "row 3: x 'a' is not a number",
        ),
        (
            "# crs: local\n" + ",".join(COLUMNS) + "\n1,car,0,,2,3,4,5,6\n",
            "row 3: x 'nan' is missing",
        ),
        (
            "# crs: local\n" + ",".join(COLUMNS) + 2 * "\n1,car,0,1,2,3,4,5,6",
            "1 rows repeat an agent's time",
        ),
        ("# crs: EPSG:4326\n" + ",".join(COLUMNS) + "\n1,car,0,1,2,3,4,5,6\n", "4326"),
    ],
)
def test_a_broken_file_is_refused_with_its_reason(tmp_path, text, message):
    path = tmp_path / "tracks.csv"
    path.write_text(text)
    with pytest.raises(GeoaimError, match=message):
        read_plain_tracks(path)


def test_a_missing_file_is_reported_as_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_plain_tracks(tmp_path / "nowhere.csv")


@pytest.mark.parametrize("name", ["a.parquet", "a.csv"])
def test_a_binary_file_is_refused(tmp_path, name):
    (tmp_path / name).write_bytes(bytes(range(256)))
    with pytest.raises(TracksError, match="is not a table of tracks"):
        read_plain_tracks(tmp_path / name)


def test_another_suffix_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ValueError, match=r"must end in .csv, .parquet or .gpkg"):
        write_tracks(two_agents(), tmp_path / "tracks.txt")
    assert not list(tmp_path.iterdir())


def test_an_agent_may_be_called_na(tmp_path):
    path = tmp_path / "a.csv"
    write_tracks(make_tracks(pd.DataFrame([make_row(id="NA"), make_row(id="null")]), WORLD), path)
    assert read_plain_tracks(path).ids == ("NA", "null")


def test_times_read_back_are_those_written(tmp_path):
    times = np.arange(3000) / 10
    tracks = make_tracks(pd.DataFrame([make_row(time=time) for time in times]), WORLD)
    write_tracks(tracks, tmp_path / "a.csv")
    np.testing.assert_array_equal(read_plain_tracks(tmp_path / "a.csv").times, times)


def test_a_row_with_an_extra_field_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# crs: local\n" + ",".join(COLUMNS) + "\n1,2,0,1,2,0,1,4,2,9\n")
    with pytest.raises(TracksError, match="more fields than there are columns"):
        read_plain_tracks(path)


def test_tracks_that_could_not_be_read_back_are_not_written(tmp_path):
    absent = two_agents(present=((False, False, False),))
    with pytest.raises(ValueError, match="no agent is present"):
        write_tracks(absent, tmp_path / "a.csv")
    close = make_tracks(pd.DataFrame([make_row(), make_row(time=1e-4)]), WORLD)
    with pytest.raises(TracksError, match=r"apart; \.csv needs"):
        write_tracks(close, tmp_path / "a.csv")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("crs", ["EPSG:32635", None])
def test_parquet_is_geoparquet(tmp_path, crs):
    tracks = two_agents(world=World(crs, (10.0, 20.0)))
    write_tracks(tracks, tmp_path / "a.parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    geo = json.loads(table.schema.metadata[b"geo"])
    assert (geo["version"], geo["primary_column"]) == ("1.1.0", "geometry")
    (column,) = geo["columns"].values()
    assert (column["encoding"], column["geometry_types"]) == ("WKB", ["Point"])
    assert (column["crs"] and column["crs"]["id"]["code"]) == (32635 if crs else None)
    points = shapely.get_coordinates(shapely.from_wkb(table["geometry"].to_numpy()))
    positions = tracks.states[tracks.present][:, :2] + tracks.world.origin
    np.testing.assert_allclose(np.sort(points, axis=0), np.sort(positions, axis=0))
    np.testing.assert_allclose(column["bbox"], [*positions.min(axis=0), *positions.max(axis=0)])


def test_geopandas_reads_dates_and_places_of_parquet(tmp_path):
    geopandas = pytest.importorskip("geopandas")
    tracks = two_agents(world=World("EPSG:32635", (10.0, 20.0)))
    write_tracks(tracks, tmp_path / "a.parquet", start="2026-06-01 12:00+02:00")
    frame = geopandas.read_parquet(tmp_path / "a.parquet")
    assert str(frame["datetime"].dtype).startswith("datetime64")
    noon = pd.Timestamp("2026-06-01T10:00Z")
    np.testing.assert_allclose((frame["datetime"] - noon).dt.total_seconds(), frame["time"])
    assert frame.crs.to_epsg() == 32635
    np.testing.assert_allclose(frame.geometry.x, frame["x"] + 10.0)
    assert read_plain_tracks(tmp_path / "a.parquet").ids == tracks.ids
    with pytest.raises(ValueError, match="a table has no dates"):
        write_tracks(tracks, tmp_path / "a.csv", start="2026-06-01")


@pytest.mark.parametrize("name", ["a.csv", "a.parquet"])
def test_observed_states_and_uncertainty_are_kept(tmp_path, name):
    tracks = make_uncertain_tracks()
    write_tracks(tracks, tmp_path / name)
    again = read_plain_tracks(tmp_path / name)
    np.testing.assert_allclose(again.observed, tracks.observed, atol=6e-4)
    np.testing.assert_array_equal(again.seen, tracks.seen)
    np.testing.assert_allclose(again.uncertainty, tracks.uncertainty, atol=6e-4)
    np.testing.assert_allclose(again.observed_sigma, tracks.observed_sigma, atol=6e-4)


def test_an_observed_value_that_is_no_number_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    write_tracks(make_uncertain_tracks(), path)
    path.write_text(path.read_text().replace("0.123", "much"))
    with pytest.raises(TracksError, match="observed_x 'much' is not a number"):
        read_plain_tracks(path)


def make_uncertain_tracks():
    """One agent at three times, observed from the second on, bridged at the third."""
    states = np.array([[[0.0, 0, 0.1, 1], [1, 0, 0.1, 1], [2, 0, 0.1, 1]]])
    observed = states + 0.123 * np.array([[[np.nan], [1], [1]]]) * [0, 1, 0, 0]
    observed[0, 1, 0] = 0.123
    return Tracks(
        np.arange(3.0),
        states,
        np.ones((1, 3), bool),
        np.ones((1, 2)),
        ("car",),
        ("1",),
        World(None),
        observed,
        np.array([[True, True, False]]),
        np.full((1, 3, 2), [0.1, np.pi]),
        np.array([[np.nan, 2.5, 0.7]]),
    )


def test_comment_lines_that_a_spreadsheet_filled_up_are_read(tmp_path):
    path = tmp_path / "a.csv"
    head = '# crs: EPSG:32635,,,,,,,,\n"# origin: 583000.0 6062000.0",,,,,,,\n'
    rows = "id,type,time,x,y,heading,speed,length,width\n0,car,0,1,2,0,0,4,2\n"
    path.write_text(head + rows, encoding="utf-8-sig")
    assert read_plain_tracks(path).world == World("EPSG:32635", (583000.0, 6062000.0))
