"""Tracks in a GeoPackage (OGC 12-128r18), which QGIS and other programs show on a map.

The layer `states` has a point for each agent and time, the layer `paths` a line for each agent.
"""

import json
import os
import sqlite3
import struct
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from jaxtyping import Float, Shaped
from numpy import ndarray as Array

from geoaim.base.errors import TracksError
from geoaim.base.files import atomic_write
from geoaim.base.limits import check_memory, refuse_damaged
from geoaim.base.world import World, parse_crs
from geoaim.tracks.files import choose_own_world, place_rows
from geoaim.tracks.formats.shared import TrackFormat
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import COLUMNS, Tracks

NEEDED = "a GeoPackage of tracks"
STATE_COLUMNS = tuple(name for name in COLUMNS if name not in ("x", "y"))
PATH_COLUMNS = ("geom", "id", "type", "length", "width", "start", "stop")
LAYERS = {"states": "POINT", "paths": "LINESTRING"}
CONTENT_COLUMNS = (
    *("table_name", "data_type", "identifier", "description", "last_change"),
    *("min_x", "min_y", "max_x", "max_y", "srs_id"),
)
GEOMETRY_COLUMNS = ("table_name", "column_name", "geometry_type_name", "srs_id", "z", "m")
CRS_COLUMNS = ("srs_name", "srs_id", "organization", "organization_coordsys_id", "definition")
BYTES_PER_ROW = 1000  # memory for a row
MAX_STEPS = 5 * 10**8  # steps of the database's virtual machine; a damaged file could keep it busy
# id of a plane without a CRS; first id of CRSs without an EPSG code
LOCAL_ID, FIRST_OWN_ID = -1, 100_000
DATE = "1970-01-01T00:00:00.000Z"  # instead of the time of writing: same tracks, same bytes
SCHEMA = """
PRAGMA application_id = 0x47504B47;
PRAGMA user_version = 10300;
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY,
  organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL,
  description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL,
  identifier TEXT UNIQUE, description TEXT DEFAULT '', last_change DATETIME NOT NULL DEFAULT
  (strftime('%Y-%m-%dT%H:%M:%fZ','now')), min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE,
  srs_id INTEGER REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL UNIQUE REFERENCES
  gpkg_contents(table_name), column_name TEXT NOT NULL, geometry_type_name TEXT NOT NULL,
  srs_id INTEGER NOT NULL REFERENCES gpkg_spatial_ref_sys(srs_id), z TINYINT NOT NULL,
  m TINYINT NOT NULL, PRIMARY KEY (table_name, column_name));
CREATE TABLE states (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom POINT, id TEXT, type TEXT,
  time DOUBLE, heading DOUBLE, speed DOUBLE, length DOUBLE, width DOUBLE);
CREATE TABLE paths (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom LINESTRING, id TEXT,
  type TEXT, length DOUBLE, width DOUBLE, start DOUBLE, stop DOUBLE);
"""
OTHER_CRS = (  # CRSs that every GeoPackage has
    ("Undefined cartesian SRS", -1, "NONE", -1, "undefined"),
    ("Undefined geographic SRS", 0, "NONE", 0, "undefined"),
)


def write_geopackage(tracks: Tracks, path: str | os.PathLike[str]) -> None:
    """Write tracks as a GeoPackage (.gpkg) with the layers `states` and `paths`.

    Positions are in the CRS of the tracks; an agent with one state has no path.

    Raises:
        ValueError: no agent is present.
    """
    frame = tracks.to_dataframe()
    if not len(frame):
        raise ValueError(f"no agent is present in the tracks; {path} would have no rows")
    points = shapely.points(frame[["x", "y"]].to_numpy() + tracks.world.origin)
    with atomic_write(path) as temporary, closing(sqlite3.connect(temporary)) as database:
        database.executescript(SCHEMA)
        srs_id = _write_crs(database, tracks.world.crs)
        # other programs ignore the description, which brings the origin back
        origin = json.dumps({"origin": list(map(float, tracks.world.origin))})
        bounds = shapely.total_bounds(points).tolist()
        contents = [(layer, "features", layer, origin, DATE, *bounds, srs_id) for layer in LAYERS]
        _insert(database, "gpkg_contents", CONTENT_COLUMNS, contents)
        geometries = [(layer, "geom", kind, srs_id, 0, 0) for layer, kind in LAYERS.items()]
        _insert(database, "gpkg_geometry_columns", GEOMETRY_COLUMNS, geometries)
        columns = [frame[name].tolist() for name in STATE_COLUMNS]
        states = zip(_encode(points, srs_id), *columns, strict=True)
        _insert(database, "states", ("geom", *STATE_COLUMNS), states)
        _insert(database, "paths", PATH_COLUMNS, _list_paths(tracks, srs_id))
        database.commit()


def read_geopackage(path: str | os.PathLike[str]) -> Tracks:
    """Read the layer `states` of a GeoPackage that `write_geopackage` or another program wrote.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: it has no such layer, or is damaged.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    with (
        refuse_damaged(path, TracksError, NEEDED),
        closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database,
    ):
        database.set_progress_handler(lambda: 1, MAX_STEPS)
        _check_layer(path, database)
        rows = database.execute(f"SELECT geom, {', '.join(STATE_COLUMNS)} FROM states").fetchall()
        frame = pd.DataFrame(rows, columns=["geom", *STATE_COLUMNS])
        crs, origin = _read_place(database)
        places = _decode(frame["geom"].tolist())
        world = choose_own_world(places, crs) if origin is None else World(crs, origin)
        return make_tracks(place_rows(frame, places, crs, world)[list(COLUMNS)], world)


def _check_layer(path: Path, database: sqlite3.Connection) -> None:
    """Refuse a file whose `states` is no table, lacks a column, or has too many rows."""
    tables = database.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
    names = [row[1] for row in database.execute("PRAGMA table_info(states)")]
    missing = {"geom", *STATE_COLUMNS} - set(names)
    if ("states",) not in tables:
        own = ("gpkg_", "rtree_", "sqlite_")
        layers = ", ".join(str(name) for (name,) in tables if not str(name).startswith(own))
        raise TracksError(
            f"{path} has the layers {layers}; {NEEDED} has a layer states with the columns geom, "
            f"{', '.join(STATE_COLUMNS)}: rename them"
        )
    if missing:
        raise TracksError(
            f"{path}: the layer states has the columns {', '.join(names)}, and lacks "
            f"{', '.join(sorted(missing))}: rename or add them"
        )
    (count,) = database.execute("SELECT count(*) FROM states").fetchone()
    needed, size = count * BYTES_PER_ROW, path.stat().st_size
    check_memory(path, needed, size, TracksError, f"{count} rows")


def _read_place(database: sqlite3.Connection) -> tuple[str | None, tuple[float, float] | None]:
    """The CRS of the points, and the origin of the world if geoaim wrote the layer."""
    row = database.execute(
        "SELECT c.description, s.srs_id, s.organization, s.organization_coordsys_id, s.definition "
        "FROM gpkg_contents c JOIN gpkg_spatial_ref_sys s ON s.srs_id = c.srs_id "
        "WHERE c.table_name = 'states'"
    ).fetchone()
    description, srs_id, organization, code, definition = row
    is_ours = str(description).startswith('{"origin"')  # other programs may describe the layer
    origin = None
    if is_ours:
        east, north = json.loads(description)["origin"]
        origin = float(east), float(north)
    if srs_id == LOCAL_ID:
        return None, origin
    return f"EPSG:{code}" if str(organization).upper() == "EPSG" else str(definition), origin


def _write_crs(database: sqlite3.Connection, crs: str | None) -> int:
    """Write the CRSs that every GeoPackage has and the tracks' CRS; return the latter's id."""
    lonlat = ("WGS 84 geodetic", 4326, "EPSG", 4326, parse_crs("EPSG:4326").to_wkt("WKT1_GDAL"))
    rows, srs_id = [*OTHER_CRS, lonlat], LOCAL_ID
    if crs is not None:
        parsed = parse_crs(crs)
        code = parsed.to_epsg()
        srs_id = FIRST_OWN_ID if code is None else code
        organization = "NONE" if code is None else "EPSG"
        text = parsed.to_wkt("WKT1_GDAL" if code else "WKT2_2019")
        rows.append((parsed.name, srs_id, organization, srs_id, text))
    _insert(database, "gpkg_spatial_ref_sys", CRS_COLUMNS, rows)
    return srs_id


def _insert(
    database: sqlite3.Connection,
    table: str,
    columns: Sequence[str],
    rows: Iterable[tuple[object, ...]],
) -> None:
    marks = ", ".join("?" * len(columns))
    database.executemany(f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({marks})", rows)


def _list_paths(tracks: Tracks, srs_id: int) -> list[tuple[object, ...]]:
    """Rows of the layer of paths."""
    rows: list[tuple[object, ...]] = []
    for agent in np.flatnonzero(tracks.present.sum(axis=1) > 1).tolist():
        steps = tracks.present[agent]
        line = shapely.LineString(tracks.states[agent, steps, :2] + tracks.world.origin)
        (geometry,) = _encode(np.array([line]), srs_id)
        times = tracks.times[steps][[0, -1]].tolist()
        names = tracks.ids[agent], tracks.types[agent]
        rows.append((geometry, *names, *tracks.sizes[agent].tolist(), *times))
    return rows


def _encode(shapes: Shaped[Array, "m"], srs_id: int) -> list[bytes]:
    """Encode shapes as GeoPackage binaries: a header without an envelope, and WKB."""
    header = b"GP\0\x01" + struct.pack("<i", srs_id)
    return [header + part for part in shapely.to_wkb(shapes, byte_order=1)]


def _decode(binaries: list[object]) -> Float[Array, "m 2"]:
    """Decode the points of GeoPackage binaries, whatever their envelopes."""
    sizes = {0: 0, 1: 32, 2: 48, 3: 48, 4: 64}  # sizes of envelopes by their kinds
    parts = []
    for binary in binaries:
        if not isinstance(binary, bytes) or binary[:2] != b"GP" or len(binary) < 8:
            raise ValueError("a geometry is no GeoPackage binary")
        parts.append(binary[8 + sizes[binary[3] >> 1 & 7] :])
    points = shapely.from_wkb(np.array(parts, object))
    return np.column_stack([shapely.get_x(points), shapely.get_y(points)])


GEOPACKAGE = TrackFormat(
    "GeoPackage", lambda path, line: path.suffix.lower() == ".gpkg", read_geopackage
)
