"""Tracks in a GeoPackage (OGC 12-128r18), which QGIS and other programs show on a map.

The layer `states` has a point for each agent and time, the layer `paths` a line for each agent;
`layer_styles` is the table in which QGIS looks for the style of a layer.
"""

import json
import os
import sqlite3
import warnings
from contextlib import closing
from datetime import datetime
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import shapely

from geoaim.base.errors import TracksError
from geoaim.base.files import atomic_write
from geoaim.base.limits import check_memory, is_writable_beside, open_sqlite, refuse_damaged
from geoaim.base.world import World
from geoaim.tracks.dates import DATES, EPOCH, add_dates
from geoaim.tracks.files import choose_own_world, place_rows
from geoaim.tracks.formats.shared import TrackFormat
from geoaim.tracks.qgis_style import ARROW, LINE, TEMPORAL, make_qml
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import COLUMNS, Tracks

NEEDED = "a GeoPackage of tracks"
STATE_COLUMNS = tuple(name for name in COLUMNS if name not in ("x", "y"))
NUMBERS = STATE_COLUMNS[2:]
DATE = f"{EPOCH}T00:00:00.000Z"  # instead of the time of writing: same tracks, same bytes
UTC = 100  # as GDAL numbers time zones
SQLITE = b"SQLite format 3\0"  # first bytes: GDAL would open other formats by the name .gpkg
# as QGIS makes it
STYLES = """CREATE TABLE layer_styles (id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
f_table_catalog TEXT(256), f_table_schema TEXT(256), f_table_name TEXT(256),
f_geometry_column TEXT(256), styleName TEXT(30), styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN,
description TEXT, owner TEXT(30), ui TEXT(30),
update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')))"""


def write_geopackage(
    tracks: Tracks, path: str | os.PathLike[str], *, start: str | datetime = EPOCH
) -> None:
    """Write tracks as a GeoPackage (.gpkg) with the layers `states` and `paths`.

    Positions are in the CRS of the tracks; an agent with one state has no path.

    Args:
        tracks: the tracks.
        path: the file.
        start: the date and time (UTC if it names no zone) at which `time` is 0, for the column
            `datetime` of `states`, to the millisecond.

    Raises:
        ImportError: pyogrio is missing.
        ValueError: no agent is present, or `start` is no date.
    """
    pyogrio = _import_pyogrio()
    frame = add_dates(tracks.to_dataframe(), start)
    if not len(frame):
        raise ValueError(f"no agent is present in the tracks; {path} would have no rows")
    points = shapely.points(frame[["x", "y"]].to_numpy() + tracks.world.origin)
    dates = frame[DATES].dt.round("ms").dt.tz_localize(None).astype("datetime64[ms]")
    states = frame[list(STATE_COLUMNS)].assign(**{DATES: dates})
    paths, lines = _list_paths(tracks)
    # other programs ignore the description, which brings the origin back
    origin = json.dumps({"origin": list(map(float, tracks.world.origin))})
    options = {"DESCRIPTION": origin, "SPATIAL_INDEX": "NO"}
    layers = {
        "states": (points, states, "Point"),
        "paths": (np.array(lines, object), paths, "LineString"),
    }
    with atomic_write(path) as temporary, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "'crs' was not provided")
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": DATE})
        try:
            for layer, (shapes, table, kind) in layers.items():
                pyogrio.raw.write(
                    temporary,
                    shapely.to_wkb(shapes),
                    [table[name].to_numpy() for name in table],
                    list(table),
                    layer=layer,
                    geometry_type=kind,
                    crs=tracks.world.crs,
                    driver="GPKG",
                    layer_options=options,
                    gdal_tz_offsets={DATES: np.full(len(table), UTC)} if DATES in table else None,
                )
        finally:
            pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})
        _write_styles(temporary, tracks)


def read_geopackage(path: str | os.PathLike[str]) -> Tracks:
    """Read the layer `states` of a GeoPackage that `write_geopackage` or another program wrote.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: pyogrio is missing.
        TracksError: it has no such layer, or is damaged.
    """
    path = Path(path).absolute()
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    pyogrio = _import_pyogrio()
    with refuse_damaged(path, TracksError, NEEDED):
        _check_tables(path)
        with warnings.catch_warnings(record=True) as heard:
            options = {} if is_writable_beside(path) else {"IMMUTABLE": "YES"}
            info = pyogrio.read_info(path, layer="states", **options)
            if missing := set(STATE_COLUMNS) - set(info["fields"]):
                raise TracksError(
                    f"{path}: the layer states has the columns {', '.join(info['fields'])}, and "
                    f"lacks {', '.join(sorted(missing))}: rename or add them"
                )
            meta, _, points, values = pyogrio.raw.read(
                path, layer="states", columns=STATE_COLUMNS, **options
            )
        if heard:  # GDAL goes on with 0 where it cannot read a value
            raise ValueError(heard[0].message)
        frame = _read_clock(pd.DataFrame(dict(zip(meta["fields"], values, strict=True))))
        shapes = shapely.from_wkb(points)
        # of a multipoint of one, as GIS programs make them
        one = shapely.get_num_geometries(shapes) == 1
        shapes = np.where(one, shapely.get_geometry(shapes, 0), shapes)
        is_point = shapely.get_type_id(shapes) == shapely.GeometryType.POINT
        lacking = ~is_point | shapely.is_empty(shapes)
        if lacking.any():
            raise TracksError(
                f"{path}: row {int(lacking.argmax()) + 1} of the layer states has no point: delete "
                "such rows, or give them one"
            )
        places = np.column_stack([shapely.get_x(shapes), shapely.get_y(shapes)])
        crs = None if "Undefined Cartesian" in str(meta["crs"]) else meta["crs"]
        origin = _read_origin(info)
        world = choose_own_world(places, crs) if origin is None else World(crs, origin)
        return make_tracks(place_rows(frame, places, crs, world)[list(COLUMNS)], world)


def _read_clock(frame: pd.DataFrame) -> pd.DataFrame:
    """Take dates in the column of times, as GIS programs need them, for seconds from the first."""
    if not pd.api.types.is_datetime64_any_dtype(frame["time"]):
        return frame
    return frame.assign(time=(frame["time"] - frame["time"].min()).dt.total_seconds())


def _import_pyogrio() -> ModuleType:
    try:
        import pyogrio
    except ImportError as error:
        raise ImportError(
            "GeoPackages need pyogrio, of the extra gis: pip install pyogrio"
        ) from error
    return pyogrio


def _check_tables(path: Path) -> None:
    """Refuse a file whose `states` is no table, has too many rows, or that computes its values."""
    with path.open("rb") as file:
        if file.read(len(SQLITE)) != SQLITE:
            raise ValueError("its first bytes are those of another format")
    with open_sqlite(path) as database:
        kinds = dict(database.execute("SELECT name, type FROM sqlite_master").fetchall())
        if kinds.get("states") != "table":
            own = ("gpkg_", "rtree_", "sqlite_")
            layers = [name for name, kind in kinds.items() if kind == "table"]
            raise TracksError(
                f"{path} has the layers {', '.join(x for x in layers if not x.startswith(own))}; "
                f"{NEEDED} has a layer states of points with the columns "
                f"{', '.join(STATE_COLUMNS)}: rename them"
            )
        columns = database.execute("PRAGMA table_xinfo(states)").fetchall()
        if any(row[6] > 1 for row in columns) or any(
            kind == "view" and name.startswith("gpkg_") for name, kind in kinds.items()
        ):
            raise ValueError("its values are computed when they are read")
        for _, name, declared, *_ in columns:
            is_text = any(kind in declared.upper() for kind in ("TEXT", "DATE"))
            if name in NUMBERS and not is_text:  # GDAL would read a text as 0
                query = f"SELECT {name} FROM states WHERE typeof({name}) = 'text' LIMIT 1"
                if wrong := database.execute(query).fetchone():
                    raise ValueError(f"{name} {wrong[0]!r} is not a number")
        (count,) = database.execute("SELECT count(*) FROM states").fetchone()
    # 1000 bytes of memory for a row
    check_memory(path, count * 1000, path.stat().st_size, TracksError, f"{count} rows")


def _write_styles(path: Path, tracks: Tracks) -> None:
    """Add the table `layer_styles`, in which QGIS looks for the style of a layer.

    By sqlite3, since GDAL tells of no full disk when it closes a file.
    """
    step = float(np.median(np.diff(tracks.times))) if len(tracks.times) > 1 else 1.0
    temporal = TEMPORAL.format(DATES, round(step * 1000))
    styles = {
        "states": make_qml(tracks.types, ARROW, temporal),
        "paths": make_qml(tracks.types, LINE),
    }
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(STYLES)
        database.execute(
            "INSERT INTO gpkg_contents (table_name, data_type, identifier, last_change, srs_id) "
            "VALUES ('layer_styles', 'attributes', 'layer_styles', ?, 0)",
            [DATE],
        )
        database.executemany(
            "INSERT INTO layer_styles VALUES (NULL, '', '', ?, 'geom', 'agents', ?, '', 1, "
            "'by type', '', NULL, ?)",
            [(layer, style, DATE) for layer, style in styles.items()],
        )


def _read_origin(info: dict[str, Any]) -> tuple[float, float] | None:
    """Read the origin of the world, which geoaim wrote as the description of the layer."""
    description = (info["layer_metadata"] or {}).get("DESCRIPTION", "")
    if not description.startswith('{"origin"'):  # other programs may describe the layer
        return None
    east, north = json.loads(description)["origin"]
    return float(east), float(north)


def _list_paths(tracks: Tracks) -> tuple[pd.DataFrame, list[shapely.LineString]]:
    """List the rows and lines of the layer of paths."""
    rows, lines = [], []
    for agent in np.flatnonzero(tracks.present.sum(axis=1) > 1).tolist():
        steps = tracks.present[agent]
        lines.append(shapely.LineString(tracks.states[agent, steps, :2] + tracks.world.origin))
        names, times = (tracks.ids[agent], tracks.types[agent]), tracks.times[steps][[0, -1]]
        rows.append((*names, *tracks.sizes[agent], *times))
    columns = ["id", "type", "length", "width", "start", "stop"]
    return pd.DataFrame(rows, columns=columns), lines


GEOPACKAGE = TrackFormat(
    "GeoPackage", lambda path, line: path.suffix.lower() == ".gpkg", read_geopackage
)
