"""GeoPackages of tracks: a round trip, and what the standard asks of every one."""

import shutil
import sqlite3
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyogrio
import pytest
import shapely

from geoaim.base.errors import GeoaimError, TracksError
from geoaim.base.world import World
from geoaim.tracks.files import read_plain_tracks
from geoaim.tracks.formats import read_geopackage, read_tracks, write_geopackage

SAMPLE = read_plain_tracks(Path(__file__).parents[3] / "samples/tracks.csv")
CUSTOM = "+proj=tmerc +lat_0=54 +lon_0=28 +datum=WGS84 +units=m +type=crs"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("tracks") / "a.gpkg"
    write_geopackage(SAMPLE, path)
    return path


def ask(path, query):
    with closing(sqlite3.connect(path)) as database:
        return database.execute(query).fetchall()


@pytest.mark.parametrize("world", [SAMPLE.world, World(None, (3.5, -2.0)), World(CUSTOM)])
def test_tracks_come_back_as_they_were(tmp_path, world):
    tracks = replace(SAMPLE, world=world)
    write_geopackage(tracks, tmp_path / "a.gpkg")
    read = read_tracks(tmp_path / "a.gpkg")
    order = [read.ids.index(name) for name in tracks.ids]
    assert tuple(read.types[row] for row in order) == tracks.types
    assert (read.world.crs is None, read.world.origin) == (world.crs is None, world.origin)
    np.testing.assert_array_equal(read.present[order], tracks.present)
    np.testing.assert_allclose(read.states[order], tracks.states, atol=1e-8)
    np.testing.assert_array_equal(read.sizes[order], tracks.sizes)


def test_file_has_what_every_geopackage_has(written):
    assert written.read_bytes()[68:72] == b"GPKG"
    ids = {row[0] for row in ask(written, "SELECT srs_id FROM gpkg_spatial_ref_sys")}
    assert ids == {-1, 0, 4326, 32635}
    assert ask(written, "SELECT table_name, data_type, srs_id FROM gpkg_contents") == [
        ("states", "features", 32635),
        ("paths", "features", 32635),
        ("layer_styles", "attributes", 0),
    ]
    assert ask(written, "PRAGMA integrity_check") == [("ok",)]
    assert ask(written, "PRAGMA foreign_key_check") == []


def test_states_have_dates_that_gis_programs_play(tmp_path, written):
    query = "SELECT time, datetime FROM states WHERE time = 0.1 LIMIT 1"
    assert ask(written, query) == [(0.1, "1970-01-01T00:00:00.100Z")]
    write_geopackage(SAMPLE, tmp_path / "a.gpkg", start="2026-06-01 12:00+02:00")
    assert ask(tmp_path / "a.gpkg", query) == [(0.1, "2026-06-01T10:00:00.100Z")]
    info = pyogrio.read_info(tmp_path / "a.gpkg", layer="states")
    assert dict(zip(info["fields"], info["dtypes"], strict=True))["datetime"] == "datetime64[ms]"
    with pytest.raises(ValueError, match="'noon' is not a date and time"):
        write_geopackage(SAMPLE, tmp_path / "b.gpkg", start="noon")


def test_qgis_finds_styles_by_type_turned_by_heading_and_played_by_date(written):
    # the query of QGIS for the style of a layer, which it takes where one is the default
    query = (
        "SELECT styleQML FROM layer_styles WHERE f_table_schema = '' AND f_table_name = '{}' "
        "AND f_geometry_column = 'geom' AND useAsDefault = 1"
    )
    assert ask(written, "SELECT column_name FROM gpkg_geometry_columns") == [("geom",)] * 2
    states, paths = (
        ElementTree.fromstring(ask(written, query.format(layer))[0][0])
        for layer in ("states", "paths")
    )
    played = states.find("temporal").attrib
    assert (played["startField"], played["fixedDuration"]) == ("datetime", "100")
    for root, colour in ((states, "color"), (paths, "line_color")):
        numbers = {one.get("value"): one.get("symbol") for one in root.iter("category")}
        assert list(numbers) == sorted(set(SAMPLE.types))
        symbols = {one.get("name"): one for one in root.iter("symbol")}
        assert set(symbols) == set(numbers.values())
        car = symbols[numbers["car"]].find("layer")
        assert car.find(f"Option/Option[@name='{colour}']").get("value") == "26,89,230,255"
    angle = states.find(".//Option[@name='angle']/Option[@name='expression']")
    assert angle.get("value") == '90 - degrees("heading")'


def test_dates_and_multipoints_of_gis_programs_are_read(tmp_path, written):
    frame = pyogrio.read_dataframe(written, layer="states")
    frame["time"] = frame.pop("datetime")
    frame.geometry = shapely.multipoints(shapely.get_coordinates(frame.geometry)[:, None])
    pyogrio.write_dataframe(frame, tmp_path / "b.gpkg", layer="states")
    read = read_tracks(tmp_path / "b.gpkg")
    np.testing.assert_array_equal(read.times, SAMPLE.times)
    assert read.present.sum() == SAMPLE.present.sum()


def test_wal_is_read_in_a_folder_without_leave_to_write_or_is_named(tmp_path, written, monkeypatch):
    path = Path(shutil.copy(written, tmp_path / "a.gpkg"))
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode = WAL")
    monkeypatch.setattr("geoaim.base.limits.os.access", lambda *_: False)
    assert read_tracks(path).ids == SAMPLE.ids
    (tmp_path / "a.gpkg-wal").write_bytes(b"changes")
    with pytest.raises(GeoaimError, match=r"a\.gpkg-wal holds changes that are not in a\.gpkg yet"):
        read_tracks(path)


def test_paths_are_lines_in_the_crs(written):
    info, _, lines, (names, starts) = pyogrio.raw.read(
        written, layer="paths", columns=["id", "start"]
    )
    assert info["crs"] == "EPSG:32635"
    assert len(lines) == (SAMPLE.present.sum(axis=1) > 1).sum()
    agent = SAMPLE.ids.index(names[0])
    steps = np.flatnonzero(SAMPLE.present[agent])
    wanted = SAMPLE.states[agent, steps, :2] + SAMPLE.world.origin
    np.testing.assert_allclose(shapely.get_coordinates(shapely.from_wkb(lines[0])), wanted)
    assert starts[0] == SAMPLE.times[steps[0]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("DROP TABLE states", "a GeoPackage of tracks has a layer states"),
        (
            "ALTER TABLE states DROP COLUMN speed",
            "the layer states has .* and lacks speed: rename or add",
        ),
        ("UPDATE states SET geom = x'00'", "row 1 of the layer states has no point"),
        (
            "UPDATE states SET geom = NULL WHERE fid = 7",
            r"a\.gpkg: row 7 of the layer states has no point: delete",
        ),
        ("UPDATE states SET heading = 'north'", "heading 'north' is not a number"),
        ("DELETE FROM states", "has no rows"),
        ("DELETE FROM gpkg_contents", "row 1 of the layer states has no point"),
    ],
)
def test_broken_file_is_refused_with_its_reason(tmp_path, written, change, message):
    path = Path(shutil.copy(written, tmp_path / "a.gpkg"))
    with closing(sqlite3.connect(path)) as database:
        database.execute(change)
        database.commit()
    with pytest.raises(TracksError, match=message):
        read_tracks(path)


def test_layer_that_another_program_describes_is_read(tmp_path, written):
    path = Path(shutil.copy(written, tmp_path / "a.gpkg"))
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE gpkg_contents SET description = 'traffic of a morning'")
        database.commit()
    found = read_tracks(path)
    assert found.world.crs == SAMPLE.world.crs
    one, other = (x.states[x.present][:, :2] + x.world.origin for x in (found, SAMPLE))
    np.testing.assert_allclose(one, other, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            "ALTER TABLE states RENAME TO old; CREATE VIEW states AS WITH RECURSIVE n(i) AS "
            "(SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT old.* FROM old, n",
            "has a layer states of points",
        ),
        (
            "ALTER TABLE gpkg_contents RENAME TO old; CREATE VIEW gpkg_contents AS WITH RECURSIVE "
            "n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT old.* FROM old, n",
            "computed when they are read",
        ),
        (
            "ALTER TABLE states DROP COLUMN id; ALTER TABLE states ADD id TEXT AS "
            "(hex(zeroblob(400000000)))",
            "computed when they are read",
        ),
    ],
)
def test_file_that_computes_its_rows_without_end_is_refused(tmp_path, written, change, message):
    path = Path(shutil.copy(written, tmp_path / "a.gpkg"))
    with closing(sqlite3.connect(path)) as database:
        database.executescript(change)
    with pytest.raises(TracksError, match=message):
        read_tracks(path)


def test_other_format_under_the_name_is_not_opened(tmp_path, written):
    path = tmp_path / "a.gpkg"
    path.write_text(
        f"<OGRVRTDataSource><OGRVRTLayer name='states'><SrcDataSource>{written}</SrcDataSource>"
        "</OGRVRTLayer></OGRVRTDataSource>"
    )
    with pytest.raises(TracksError, match="first bytes are those of another format"):
        read_tracks(path)


def test_missing_package_is_named(tmp_path, written, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyogrio", None)
    for act in (read_tracks, lambda path: write_geopackage(SAMPLE, path)):
        with pytest.raises(ImportError, match="extra gis: pip install pyogrio"):
            act(written)


def test_other_files_and_empty_tracks_are_refused(tmp_path):
    path = tmp_path / "a.gpkg"
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_geopackage(path)
    path.write_bytes(b"hello" * 100)
    with pytest.raises(TracksError, match=r"a\.gpkg is not a GeoPackage of tracks"):
        read_tracks(path)
    empty = replace(SAMPLE, present=np.zeros_like(SAMPLE.present), states=SAMPLE.states * np.nan)
    with pytest.raises(ValueError, match="no agent is present"):
        write_geopackage(empty, path)
