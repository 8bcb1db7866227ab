"""The formats of highD and of inD, rounD, exiD and uniD: three tables for each recording.

Beside `00_tracks.csv` are `00_tracksMeta.csv` with the type of each agent and
`00_recordingMeta.csv` with the frame rate and the location.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoaim.base.errors import TracksError
from geoaim.base.geometry import wrap_angle
from geoaim.base.world import World, find_utm_crs
from geoaim.tracks.files import read_table
from geoaim.tracks.formats import shared
from geoaim.tracks.formats.motion import compute_signed_speed
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import Tracks

SUFFIX = "_tracks.csv"
IND_NUMBERS = ("xCenter", "yCenter", "heading", "width", "length", "xVelocity", "yVelocity")
IND_RECORDING = ("frameRate", "latLocation", "lonLocation", "xUtmOrigin", "yUtmOrigin")
HIGHD_COLUMNS = ("frame", "x", "y", "width", "height", "xVelocity", "yVelocity")
HIGHD_MIN_HEADING_SPEED = 2.0  # m/s; slower motion on a motorway has no usable direction


def read_ind(path: str | os.PathLike[str]) -> Tracks:
    """Read `XX_tracks.csv` of inD, rounD, exiD or uniD, and the two tables beside it.

    The world is the UTM zone of the recording, with its origin. Agents written as points, as
    pedestrians and cyclists are, get the typical size of their type.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: a table beside it or columns are missing, or a value is not a number.
        GeoreferenceError: the recording's location lies in no UTM zone.
    """
    table = read_table(path, text=("trackId",))
    shared.check_columns(path, table, numbers=("frame", *IND_NUMBERS), others=("trackId",))
    recording = _read_recording(path, IND_RECORDING)
    heading = wrap_angle(np.radians(table["heading"].to_numpy(np.float64)))
    velocity = table[["xVelocity", "yVelocity"]].to_numpy(np.float64)
    signed = compute_signed_speed(velocity, heading)
    has_box = table["width"].to_numpy() > 0
    rows = pd.DataFrame(
        {
            "id": table["trackId"],
            "type": shared.map_types(path, _look_up_agents(path, table["trackId"], "class")),
            "time": table["frame"] / recording["frameRate"],
            "x": table["xCenter"],
            "y": table["yCenter"],
            "heading": heading,
            "speed": np.where(has_box, signed, np.hypot(*velocity.T)),
            "length": table["length"],
            "width": table["width"],
        }
    )
    rows[["length", "width"]] = shared.fill_sizes(rows)
    crs = find_utm_crs(recording["lonLocation"], recording["latLocation"])
    world = World(crs, (recording["xUtmOrigin"], recording["yUtmOrigin"]))
    return make_tracks(rows, world)


def read_highd(path: str | os.PathLike[str]) -> Tracks:
    """Read `XX_tracks.csv` of highD, and the two tables beside it.

    In the file y points down and (x, y) is the top-left corner of the box; in the tracks y points
    up and (x, y) is the middle of the box, in a local plane without a CRS. The heading is that of
    the last motion, or that of the carriageway for an agent that has hardly moved yet.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: a table beside it or columns are missing, or a value is not a number.
    """
    table = read_table(path, text=("id",))
    shared.check_columns(path, table, numbers=HIGHD_COLUMNS, others=("id",))
    recording = _read_recording(path, ("frameRate",))
    east, north = table["xVelocity"], -table["yVelocity"]
    rows = pd.DataFrame(
        {
            "id": table["id"],
            "type": shared.map_types(path, _look_up_agents(path, table["id"], "class")),
            "time": table["frame"] / recording["frameRate"],
            "x": table["x"] + 0.5 * table["width"],
            "y": -(table["y"] + 0.5 * table["height"]),
            "speed": np.hypot(east, north),
            "length": table["width"],
            "width": table["height"],
        }
    )
    moving = rows["speed"] > HIGHD_MIN_HEADING_SPEED
    rows["heading"] = np.where(moving, np.arctan2(north, east), np.nan)
    last = rows.sort_values("time").groupby("id")["heading"].ffill()
    rows["heading"] = last.fillna(pd.Series(_find_carriageway_heading(path, table), rows.index))
    return make_tracks(rows, World(None))


def _find_carriageway_heading(path: str | os.PathLike[str], table: pd.DataFrame) -> Any:
    """Find each row's heading: the upper carriageway (1) leads to the left, the lower (2) right."""
    direction = _look_up_agents(path, table["id"], "drivingDirection")
    unknown = set(direction) - {"1", "2"}
    if unknown:
        raise TracksError(f"{path}: drivingDirection {min(unknown)!r} is neither 1 nor 2")
    return np.where(direction == "1", -np.pi, 0.0)


def _read_sibling(
    path: str | os.PathLike[str], kind: str, text: tuple[str, ...] = ()
) -> pd.DataFrame:
    """Read another table of the same recording."""
    path = Path(path)
    name = f"{path.name.removesuffix(SUFFIX)}_{kind}.csv"
    if not path.name.endswith(SUFFIX) or not path.with_name(name).exists():
        raise TracksError(
            f"{path} has no {name} beside it; keep XX_tracks.csv, XX_tracksMeta.csv and "
            "XX_recordingMeta.csv of a recording together, under their names"
        )
    return read_table(path.with_name(name), text=text)


def _read_recording(path: str | os.PathLike[str], names: tuple[str, ...]) -> dict[str, float]:
    """Read numbers of the recording."""
    table = _read_sibling(path, "recordingMeta")
    shared.check_columns(f"{path}'s recordingMeta", table, numbers=names)
    recording = {name: float(table[name].iloc[0]) for name in names}
    if not recording["frameRate"] > 0:
        raise TracksError(f"{path}: a frameRate of {recording['frameRate']} is not positive")
    return recording


def _look_up_agents(
    path: str | os.PathLike[str], ids: "pd.Series[Any]", column: str
) -> "pd.Series[Any]":
    """Look up a column of the table of agents for each row of the tracks."""
    id_column = str(ids.name)
    meta = _read_sibling(path, "tracksMeta", (id_column, column))
    shared.check_columns(f"{path}'s tracksMeta", meta, numbers=(), others=(id_column, column))
    values = ids.map(meta.drop_duplicates(id_column).set_index(id_column)[column])
    if values.isna().any():
        raise TracksError(f"{path}: {ids[values.isna()].iloc[0]!r} is not in its tracksMeta")
    return values


IND = shared.TrackFormat(
    "inD", shared.has_columns("trackId", "frame", "xCenter", "yCenter"), read_ind
)
HIGHD = shared.TrackFormat(
    "highD", shared.has_columns("id", "frame", "x", "y", "width", "height", "xVelocity"), read_highd
)
