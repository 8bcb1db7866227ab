"""The INTERACTION format, which other datasets use as well, and SinD's format, which is similar."""

import os
from pathlib import Path

import numpy as np
import pandas as pd

from geoaim.base.errors import TracksError, name_option, warn
from geoaim.base.world import LONLAT, World, find_utm_crs, transform_crs
from geoaim.tracks.files import read_table
from geoaim.tracks.formats import shared
from geoaim.tracks.formats.motion import compute_signed_speed, fill_headings
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import MIN_HEADING_SPEED, Tracks

NUMBERS = ("timestamp_ms", "x", "y", "vx", "vy")
META_FILE, META_ORIGIN = "meta_data.csv", ("originLon", "originLat")
SIND_FILES = ("Veh_smoothed_tracks.csv", "Ped_smoothed_tracks.csv")


def read_interaction(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
    """Read an INTERACTION .csv: `track_id, frame_id, timestamp_ms, agent_type, x, y, vx, vy, ...`.

    Where psi_rad (heading), length or width are missing, as for pedestrians, the heading is that
    of the motion and the size is typical of the type. `world` is the plane of x and y; None for
    the UTM zone of the origin in a `meta_data.csv` beside the file, as KIT's recordings have it, or
    else for a local plane without a CRS.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: columns are missing, or a value is not a number.
    """
    table = _read_states(path, heading="psi_rad")
    if "case_id" in table:  # track ids are unique within a case only
        table["track_id"] = table["case_id"] + "/" + table["track_id"]
    rows = _convert_states(path, table, heading="psi_rad")
    unique = rows.drop_duplicates(["id", "time"])
    if len(unique) < len(rows):
        warn(
            f"{path}: {len(rows) - len(unique)} rows repeat an agent's time; the first of each is "
            "kept"
        )
    return make_tracks(unique, world or _read_origin(Path(path)) or World(None))


def _read_origin(path: Path) -> World | None:
    """Read the plane of a file from the `META_FILE` beside it: `originLat, originLon`."""
    meta = path.with_name(META_FILE)
    if not meta.exists():
        return None
    table = read_table(meta, text=("id",))
    if not set(META_ORIGIN) <= set(table.columns):
        return None
    shared.check_columns(meta, table, numbers=META_ORIGIN)
    places = table[list(META_ORIGIN)].dropna().drop_duplicates().to_numpy(np.float64)
    if len(places) != 1:
        raise TracksError(
            f"{meta} has {len(places)} origins; one is needed, or give the CRS and the origin of "
            f"{path.name}, such as "
            + name_option(
                "--tracks-world 'EPSG:32632 459000 5428000'",
                "world=World('EPSG:32632', (459000, 5428000))",
            )
        )
    crs = find_utm_crs(*places[0])
    east, north = transform_crs(LONLAT, crs, places)[0].tolist()
    return World(crs, (east, north))


def read_sind(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
    """Read a SinD recording's vehicles or pedestrians (`SIND_FILES`), or both from its folder.

    Vehicles have the heading yaw_rad; pedestrians, which are points, that of their motion. `world`
    is the plane of x and y; None for a local plane without a CRS.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: a folder has neither file, columns are missing, or a value is not a number.
    """
    path = Path(path)
    files = (
        [path / name for name in SIND_FILES if (path / name).exists()] if path.is_dir() else [path]
    )
    if not files:
        raise TracksError(
            f"{path} has neither {' nor '.join(SIND_FILES)}; give the folder of a recording"
        )
    tables = []
    for file in files:
        table = _read_states(file, heading="yaw_rad")
        rows = _convert_states(file, table, heading="yaw_rad")
        vehicles = (table["agent_type"].str.lower() != "pedestrian").to_numpy()
        if vehicles.any():
            shared.check_columns(file, table, numbers=("yaw_rad",))
        velocity = table[["vx", "vy"]].to_numpy(np.float64)
        signed = compute_signed_speed(velocity, rows["heading"].to_numpy())
        rows["speed"] = np.where(vehicles, signed, rows["speed"])
        tables.append(rows)
    return make_tracks(pd.concat(tables), world or World(None))


def _read_states(path: str | os.PathLike[str], *, heading: str) -> pd.DataFrame:
    """Read and check a file's table; headings may be absent, absent lengths and widths are NaN."""
    table = read_table(path, text=("track_id", "agent_type", "case_id"))
    optional = tuple(name for name in (heading, "length", "width") if name in table)
    shared.check_columns(path, table, numbers=NUMBERS + optional, others=("track_id", "agent_type"))
    for name in {"length", "width"} - set(optional):
        table[name] = np.nan
    return table


def _convert_states(
    path: str | os.PathLike[str], table: pd.DataFrame, *, heading: str
) -> pd.DataFrame:
    """Convert a file's table to rows for `make_tracks`; fill missing headings and sizes."""
    rows = pd.DataFrame(
        {
            "id": table["track_id"],
            "type": shared.map_types(path, table["agent_type"]),
            "time": table["timestamp_ms"] / 1000.0,
            "x": table["x"],
            "y": table["y"],
            "heading": table.get(heading, np.nan),
            "speed": np.hypot(table["vx"], table["vy"]),
            "length": table["length"],
            "width": table["width"],
        }
    )
    rows[["length", "width"]] = shared.fill_sizes(rows)
    moving = rows["speed"] > MIN_HEADING_SPEED
    direction = np.where(moving, np.arctan2(table["vy"], table["vx"]), np.nan)
    rows["heading"] = rows["heading"].where(rows["heading"].notna(), direction)
    return fill_headings(rows)


INTERACTION = shared.TrackFormat(
    "INTERACTION",
    shared.has_columns("track_id", "timestamp_ms", "x", "vx"),
    read_interaction,
    options=("world",),
    rank=1,
)
_has_vehicle_columns = shared.has_columns("track_id", "timestamp_ms", "x", "yaw_rad")
_has_pedestrian_columns = shared.has_columns("track_id", "timestamp_ms", "x", "ax", "ay")


def _matches_sind(path: Path, line: str) -> bool:
    return path.is_dir() or _has_vehicle_columns(path, line) or _has_pedestrian_columns(path, line)


SIND = shared.TrackFormat("SinD", _matches_sind, read_sind, options=("world",))
