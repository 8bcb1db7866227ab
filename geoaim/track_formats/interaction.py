"""The INTERACTION format, which other datasets use as well."""

import os
import warnings
from typing import TYPE_CHECKING

import numpy as np

from geoaim.errors import GeoaimWarning
from geoaim.track_files import read_table
from geoaim.track_formats.columns import check_columns, fill_sizes, map_types
from geoaim.track_formats.motion import fill_headings, warn_of_reversed_headings
from geoaim.track_formats.track_format import TrackFormat, has_columns
from geoaim.track_tables import make_tracks
from geoaim.tracks import MIN_HEADING_SPEED, Tracks
from geoaim.world import World

if TYPE_CHECKING:
    from pandas import DataFrame

NUMBERS = ("timestamp_ms", "x", "y", "vx", "vy")


def read_interaction(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
    """Read an INTERACTION file: `track_id, frame_id, timestamp_ms, agent_type, x, y, vx, vy, ...`.

    Args:
        path: a .csv file. Where psi_rad (heading), length or width are missing, as for
            pedestrians, the heading is that of the motion and the size is typical of the type.
        world: the plane of x and y; None for a plane without a place on the Earth.

    Raises:
        TracksError: columns are missing, or a value is not a number.
    """
    table = read_states(path, heading="psi_rad")
    if "case_id" in table:  # track ids are unique within a case only
        table["track_id"] = table["case_id"] + "/" + table["track_id"]
    rows = convert_states(table, heading="psi_rad")
    unique = rows.drop_duplicates(["id", "time"])
    if len(unique) < len(rows):
        warnings.warn(
            f"{path}: {len(rows) - len(unique)} rows repeat an agent's time; the first of each is "
            "kept",
            GeoaimWarning,
            stacklevel=2,
        )
    tracks = make_tracks(unique, world if world is not None else World(None))
    warn_of_reversed_headings(path, tracks)
    return tracks


def read_states(path: str | os.PathLike[str], *, heading: str) -> "DataFrame":
    """Read the table of a file in this format or SinD's, and check its columns.

    Args:
        path: a .csv file.
        heading: the column of headings, which may be missing.

    Returns:
        The table; length and width are NaN where the file has none.

    Raises:
        TracksError: columns are missing, or a value is not a number.
    """
    table = read_table(path, text=("track_id", "agent_type", "case_id"))
    optional = tuple(name for name in (heading, "length", "width") if name in table)
    check_columns(path, table, numbers=NUMBERS + optional, others=("track_id", "agent_type"))
    for name in {"length", "width"} - set(optional):
        table[name] = np.nan
    return table


def convert_states(table: "DataFrame", *, heading: str) -> "DataFrame":
    """Convert a table of `read_states` to rows for `make_tracks`; fill missing headings, sizes."""
    import pandas as pd

    rows = pd.DataFrame(
        {
            "id": table["track_id"],
            "type": map_types(table["agent_type"]),
            "time": table["timestamp_ms"] / 1000.0,
            "x": table["x"],
            "y": table["y"],
            "heading": table.get(heading, np.nan),
            "speed": np.hypot(table["vx"], table["vy"]),
            "length": table["length"],
            "width": table["width"],
        }
    )
    rows[["length", "width"]] = fill_sizes(rows)
    moving = rows["speed"] > MIN_HEADING_SPEED
    direction = np.where(moving, np.arctan2(table["vy"], table["vx"]), np.nan)
    rows["heading"] = rows["heading"].where(rows["heading"].notna(), direction)
    return fill_headings(rows)


INTERACTION = TrackFormat(
    "INTERACTION",
    has_columns("track_id", "timestamp_ms", "x", "vx"),
    read_interaction,
    options=("world",),
)
