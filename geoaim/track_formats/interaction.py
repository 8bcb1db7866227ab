"""INTERACTION's form, which others have taken over."""

import os
import warnings
from typing import TYPE_CHECKING

import numpy as np

from geoaim.errors import GeoaimWarning
from geoaim.track_formats.columns import need_columns, need_numbers, sizes_of, types_of
from geoaim.track_formats.motion import LEAST, kept_heading, warn_of_backwards
from geoaim.tracks import Tracks, make_tracks, read_table
from geoaim.world import World

if TYPE_CHECKING:
    from pandas import DataFrame

NUMBERS = ("timestamp_ms", "x", "y", "vx", "vy")


def read_interaction(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
    """Read a file of INTERACTION's form: `track_id, frame_id, timestamp_ms, agent_type, x, y, ...`.

    Args:
        path: a .csv file with vx, vy, psi_rad, length and width for each row; where heading or
            size are missing, as for pedestrians, they come from the motion and the type.
        world: where x and y lie; a plane of its own when None.

    Raises:
        TracksError: columns are missing, or a value is no number.
    """
    table = read_states(path, heading="psi_rad")
    if "case_id" in table:  # tracks are counted anew in each case
        table["track_id"] = table["case_id"] + "/" + table["track_id"]
    rows = rows_of_states(table, heading="psi_rad")
    once = rows.drop_duplicates(["id", "time"])
    if len(once) < len(rows):
        twice = len(rows) - len(once)
        warnings.warn(
            f"{path}: {twice} rows repeat an agent's time; the first of each is kept",
            GeoaimWarning,
            stacklevel=2,
        )
    tracks = make_tracks(once, world if world is not None else World(None))
    warn_of_backwards(path, tracks)
    return tracks


def read_states(path: str | os.PathLike[str], *, heading: str) -> "DataFrame":
    """The table of such a file, with numbers where they are needed.

    Args:
        path: a .csv file.
        heading: the column of headings, which pedestrians need not have.
    """
    table = read_table(path, text=("track_id", "agent_type", "case_id"), low_memory=False)
    need_columns(path, table, ("track_id", "agent_type", *NUMBERS))
    given = tuple(name for name in (heading, "length", "width") if name in table)
    need_numbers(path, table, NUMBERS + given)
    for name in {"length", "width"} - set(given):
        table[name] = np.nan
    return table


def rows_of_states(table: "DataFrame", *, heading: str) -> "DataFrame":
    """Rows for `make_tracks`; a heading that is missing comes from the velocity."""
    import pandas as pd

    rows = pd.DataFrame(
        {
            "id": table["track_id"],
            "type": types_of(table["agent_type"]),
            "time": table["timestamp_ms"] / 1000.0,
            "x": table["x"],
            "y": table["y"],
            "heading": table.get(heading, np.nan),
            "speed": np.hypot(table["vx"], table["vy"]),
            "length": table["length"],
            "width": table["width"],
        }
    )
    rows[["length", "width"]] = sizes_of(rows)
    moving = np.where(rows["speed"] > LEAST, np.arctan2(table["vy"], table["vx"]), np.nan)
    rows["heading"] = rows["heading"].where(rows["heading"].notna(), moving)
    return kept_heading(rows)
