"""The geo-trax format: vehicles detected in drone videos, on an orthophoto."""

import os
from pathlib import Path
from typing import Any

import pandas as pd

from geoaim.errors import TracksError
from geoaim.limits import MAX_POSITION_M
from geoaim.track_files import read_table
from geoaim.track_formats.motion import make_tracks_from_positions
from geoaim.track_formats.shared import TrackFormat, check_columns, has_columns, map_types
from geoaim.tracks import Tracks
from geoaim.world import World

VEHICLE_CLASSES = {0: "car", 1: "bus", 2: "truck", 3: "motorcycle"}
SIZES = ("Vehicle_Length", "Vehicle_Width")


def read_geotrax(path: str | os.PathLike[str], *, crs: str | None = None) -> Tracks:
    """Read a geo-trax .csv: `Vehicle_ID, Timestamp, Frame_Number, ..., Local_X, Local_Y, ...`.

    Headings and speeds are derived from the positions over half a second; a size that was not
    measured is the median of its class; a class number N other than those of `VEHICLE_CLASSES` is
    the type "class N", with a warning. `crs` is that of Local_X (east) and Local_Y (north), None
    for a local plane without a CRS; the world's origin is near the mean position. Times begin at 0.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: columns are missing, or a value is not a number.
    """
    table = read_table(path, text=("Vehicle_ID",))
    numbers = ("Local_X", "Local_Y", "Vehicle_Class", *SIZES)
    check_columns(path, table, numbers=numbers, others=("Vehicle_ID", "Timestamp"))
    for name in SIZES:
        median = table.groupby("Vehicle_Class")[name].transform("median")
        table[name] = table[name].fillna(median).fillna(table[name].median())
    classes = table["Vehicle_Class"]
    types = classes.map(VEHICLE_CLASSES).fillna(classes.map("class {:g}".format))
    time = _parse_times(path, table["Timestamp"])
    means = table[["Local_X", "Local_Y"]].mean().clip(-MAX_POSITION_M, MAX_POSITION_M)
    origin = (round(float(means.iloc[0]), -2), round(float(means.iloc[1]), -2))
    rows = pd.DataFrame(
        {
            "id": table["Vehicle_ID"],
            "type": map_types(path, types),
            "time": time - time.min(),
            "x": table["Local_X"] - origin[0],
            "y": table["Local_Y"] - origin[1],
            "length": table["Vehicle_Length"],
            "width": table["Vehicle_Width"],
        }
    )
    return make_tracks_from_positions(rows, World(crs, origin), half_window=0.25)


def _parse_times(path: str | os.PathLike[str], stamps: "pd.Series[Any]") -> "pd.Series[float]":
    """Convert time stamps, which are dates with times or numbers, to seconds."""
    if pd.api.types.is_numeric_dtype(stamps):
        return stamps.astype(float)
    try:
        clock = pd.to_datetime(stamps)
    except ValueError as error:
        raise TracksError(f"{Path(path)}: a Timestamp is not a time: {error}") from error
    return (clock - clock.min()).dt.total_seconds()


GEOTRAX = TrackFormat(
    "geo-trax",
    has_columns("Vehicle_ID", "Local_X", "Local_Y"),
    lambda path, world=None: read_geotrax(path, crs=world and world.crs),
    options=("world",),
)
