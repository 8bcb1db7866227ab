"""Tracks from the files of public data sets: INTERACTION, Stanford Drone Dataset, geo-trax."""

import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoaimWarning, TracksError
from geoaim.tracks import COLUMNS, Tracks, heading_of_motion, read_table, tracks_of_rows
from geoaim.world import World

if TYPE_CHECKING:
    from pandas import DataFrame, Series

LEAST = 0.3  # m/s under which a motion has no direction
SDD_RATE = 30.0  # frames/s
# length and width in metres, where a data set gives boxes in pixels that hold limbs and shadows
SDD_SIZES = {
    "Pedestrian": (0.5, 0.6),
    "Biker": (1.8, 0.65),
    "Skater": (0.7, 0.6),
    "Cart": (2.6, 1.3),
    "Car": (4.5, 1.8),
    "Bus": (12.0, 2.5),
}
SDD_TYPES = {"Pedestrian": "pedestrian", "Biker": "cyclist"}
GEOTRAX_TYPES = {0: "car", 1: "bus", 2: "truck", 3: "motorcycle"}


def read_interaction(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
    """Read a file of INTERACTION's form: `track_id, frame_id, timestamp_ms, agent_type, x, y, ...`.

    Args:
        path: a .csv file with vx, vy, psi_rad, length and width for each row; where heading or
            size are missing, as for pedestrians, they come from the motion and are 0.5 m.
        world: where x and y lie; a plane of its own when None.

    Raises:
        TracksError: columns are missing, or a value is no number.
    """
    import pandas as pd

    table = read_table(path, text=("track_id", "agent_type", "case_id"))
    _need(path, table, ("track_id", "timestamp_ms", "agent_type", "x", "y", "vx", "vy"))
    numbers = ("timestamp_ms", "x", "y", "vx", "vy", "psi_rad", "length", "width")
    _numeric(path, table, tuple(name for name in numbers if name in table))
    if "case_id" in table:  # tracks are counted anew in each case
        table["track_id"] = table["case_id"] + "/" + table["track_id"]
    for name, default in (("length", 0.5), ("width", 0.5)):
        table[name] = table[name].fillna(default) if name in table else default
    rows = pd.DataFrame(
        {
            "id": table["track_id"],
            "type": table["agent_type"].str.lower(),
            "time": table["timestamp_ms"] / 1000.0,
            "x": table["x"],
            "y": table["y"],
            "heading": table.get("psi_rad", np.nan),
            "speed": np.hypot(table["vx"], table["vy"]),
            "length": table["length"],
            "width": table["width"],
        }
    )
    moving = np.where(rows["speed"] > LEAST, np.arctan2(table["vy"], table["vx"]), np.nan)
    known = rows["heading"].notna()
    rows["heading"] = rows["heading"].where(known, moving)  # who stands keeps the direction
    along = rows.sort_values("time").groupby("id")["heading"]
    rows["heading"] = along.ffill().fillna(along.bfill()).fillna(0.0)
    once = rows.drop_duplicates(["id", "time"])
    if len(once) < len(rows):
        twice = len(rows) - len(once)
        warnings.warn(
            f"{path}: {twice} rows repeat an agent's time; the first of each is kept",
            GeoaimWarning,
            stacklevel=2,
        )
    return tracks_of_rows(once, world if world is not None else World(None))


def read_sdd(path: str | os.PathLike[str], *, metres_per_pixel: float) -> Tracks:
    """Read an annotation file of the Stanford Drone Dataset, also when gzipped.

    x is to the right and y up in the reference image, metres from its top-left corner; speeds and
    headings come from the motion over a second.

    Args:
        path: `annotations.txt` or `annotations.txt.gz`.
        metres_per_pixel: of the reference image.

    Raises:
        TracksError: the file is not of that form, or nobody is seen in it.
        ValueError: the resolution is not positive.
    """
    import pandas as pd

    if not metres_per_pixel > 0:
        raise ValueError(f"metres_per_pixel is {metres_per_pixel}; a positive number is needed")
    names = ["id", "left", "top", "right", "bottom", "frame", "lost", "occluded", "made", "label"]
    table = read_table(path, text=(9,), sep=" ", header=None)
    if table.shape[1] != len(names):
        raise TracksError(
            f"{Path(path)} has {table.shape[1]} columns; {len(names)} are needed: {' '.join(names)}"
        )
    table.columns = pd.Index(names)
    _numeric(path, table, tuple(names[:-1]))
    table = table[table["lost"] == 0]
    if len(table) == 0:
        raise TracksError(f"{Path(path)}: all agents are lost in all rows")
    sizes = np.array([SDD_SIZES.get(label, (1.0, 1.0)) for label in table["label"]])
    rows = pd.DataFrame(
        {
            "id": table["id"].astype(str),
            "type": [SDD_TYPES.get(label, label.lower()) for label in table["label"]],
            "time": table["frame"] / SDD_RATE,
            "x": 0.5 * metres_per_pixel * (table["left"] + table["right"]),
            "y": -0.5 * metres_per_pixel * (table["top"] + table["bottom"]),
            "length": sizes[:, 0],
            "width": sizes[:, 1],
        }
    )
    return _with_motion(rows, World(None), reach=0.5)


def read_geotrax(path: str | os.PathLike[str], *, crs: str | None = None) -> Tracks:
    """Read a file of geo-trax's form: `Vehicle_ID, Timestamp, Frame_Number, ..., Local_X, ...`.

    Headings and speeds come from the motion over half a second; a size that was not measured is
    that of its class.

    Args:
        path: a .csv file.
        crs: of Local_X (east) and Local_Y (north); a plane of its own when None.

    Raises:
        TracksError: columns are missing, or a value is no number.
    """
    import pandas as pd

    table = read_table(path, text=("Vehicle_ID",))
    needed = ("Vehicle_ID", "Timestamp", "Local_X", "Local_Y", "Vehicle_Class")
    _need(path, table, (*needed, "Vehicle_Length", "Vehicle_Width"))
    _numeric(path, table, (*needed[2:], "Vehicle_Length", "Vehicle_Width"))
    for name in ("Vehicle_Length", "Vehicle_Width"):  # not every vehicle could be measured
        usual = table.groupby("Vehicle_Class")[name].transform("median")
        table[name] = table[name].fillna(usual).fillna(table[name].median())
    time = _seconds(path, table["Timestamp"])
    origin = (round(float(table["Local_X"].mean()), -2), round(float(table["Local_Y"].mean()), -2))
    rows = pd.DataFrame(
        {
            "id": table["Vehicle_ID"],
            "type": [GEOTRAX_TYPES.get(kind, "other") for kind in table["Vehicle_Class"]],
            "time": time - time.min(),
            "x": table["Local_X"] - origin[0],
            "y": table["Local_Y"] - origin[1],
            "length": table["Vehicle_Length"],
            "width": table["Vehicle_Width"],
        }
    )
    return _with_motion(rows, World(crs, origin), reach=0.25)


def _seconds(path: str | os.PathLike[str], stamps: "Series[Any]") -> "Series[float]":
    """Times of day, or numbers, which are seconds."""
    import pandas as pd

    if pd.api.types.is_numeric_dtype(stamps):
        return stamps.astype(float)
    try:
        clock = pd.to_datetime(stamps)
    except ValueError as error:
        raise TracksError(f"{Path(path)}: a Timestamp is no time: {error}") from error
    return (clock - clock.min()).dt.total_seconds()


def _numeric(path: str | os.PathLike[str], table: "DataFrame", names: tuple[str, ...]) -> None:
    """Refuse a table that has text, or nothing at all, where numbers are needed."""
    import pandas as pd

    if len(table) == 0:
        raise TracksError(f"{Path(path)} has no rows")
    for name in names:
        if not pd.api.types.is_numeric_dtype(table[name]):
            found = table[name][pd.to_numeric(table[name], errors="coerce").isna()].iloc[0]
            raise TracksError(f"{Path(path)}: {name} is {found!r} in a row; a number is needed")


def _need(path: str | os.PathLike[str], table: "DataFrame", names: tuple[str, ...]) -> None:
    missing = [name for name in names if name not in table.columns]
    if missing:
        found = ", ".join(map(str, table.columns[:20]))
        raise TracksError(
            f"{Path(path)} lacks the columns {', '.join(missing)}; it has {found}. "
            "Is it of another data set?"
        )


def _with_motion(rows: "DataFrame", world: World, *, reach: float) -> Tracks:
    """Tracks whose speed and heading are those of the way within `reach` seconds to either side."""
    tracks = tracks_of_rows(rows.assign(heading=0.0, speed=0.0)[list(COLUMNS)], world)
    velocity = _velocity(tracks, reach)
    states = tracks.states.copy()
    states[..., 2] = np.where(tracks.present, heading_of_motion(velocity), np.nan)
    states[..., 3] = np.where(tracks.present, np.hypot(velocity[..., 0], velocity[..., 1]), np.nan)
    return replace(tracks, states=states)


def _velocity(tracks: Tracks, reach: float) -> Float[Array, "N T 2"]:
    """Central differences; at the ends and beside gaps one-sided ones; 0 for a lone step."""
    velocity = np.full((*tracks.present.shape, 2), np.nan)
    for agent in range(len(tracks.ids)):
        steps = np.flatnonzero(tracks.present[agent])
        places, times = tracks.states[agent, steps, :2], tracks.times[steps]
        before = np.searchsorted(times, times - reach)
        after = np.searchsorted(times, times + reach, side="right") - 1
        apart = np.maximum(times[after] - times[before], 1e-6)
        velocity[agent, steps] = (places[after] - places[before]) / apart[:, None]
    return velocity
