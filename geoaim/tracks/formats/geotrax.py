"""The tables of geo-trax (github.com/rfonod/geo-trax): vehicles detected in drone videos."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoaim.base.errors import TracksError, name_option
from geoaim.base.world import World
from geoaim.tracks.files import read_table
from geoaim.tracks.formats import shared
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.formats.shared import TrackFormat, check_columns, has_columns, map_types
from geoaim.tracks.tracks import Tracks

VEHICLE_CLASSES = {0: "car", 1: "bus", 2: "truck", 3: "motorcycle"}
SIZES = ("Vehicle_Length", "Vehicle_Width")
DAY_S = 86_400.0


def read_geotrax(
    path: str | os.PathLike[str], *, crs: str | None = None, frame_rate: float | None = None
) -> Tracks:
    """Read a geo-trax .csv: `Vehicle_ID, Timestamp, Frame_Number, ..., Local_X, Local_Y, ...`.

    Times are those of `Timestamp`, or of `Local_Time` in tables that `geotrax aggregate` wrote.
    Without a flight log there is neither: frames are numbered, and `frame_rate` (frames/s) is
    needed.

    Headings and speeds are derived from the positions over half a second; a size that was not
    measured is typical of the type; a class number N other than those of `VEHICLE_CLASSES` is
    the type "class N", with a warning.

    Args:
        path: the file.
        crs: CRS of Local_X (east) and Local_Y (north); None: a local plane without a CRS.
        frame_rate: frames per second; needed where the file has no times, and refused where it has.

    Returns:
        The tracks, in a world whose origin is near the mean position. Times begin at 0.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: columns are missing, a value is not a number, or times are missing or given
            twice.
    """
    table = read_table(path, text=("Vehicle_ID", "Local_Time"))
    numbers = ("Local_X", "Local_Y", "Vehicle_Class", *SIZES)
    check_columns(path, table, numbers=numbers, others=("Vehicle_ID",))
    time = _read_times(path, table, frame_rate)
    origin = shared.choose_origin(table[["Local_X", "Local_Y"]].to_numpy(np.float64))
    rows = pd.DataFrame(
        {
            "id": table["Vehicle_ID"],
            "type": map_types(path, name_classes(table["Vehicle_Class"])),
            "time": time - time.min(),
            "x": table["Local_X"] - origin[0],
            "y": table["Local_Y"] - origin[1],
            "length": table["Vehicle_Length"],
            "width": table["Vehicle_Width"],
        }
    )
    rows[["length", "width"]] = shared.fill_sizes(rows)
    return make_tracks_from_positions(rows, World(crs, origin), half_window=0.25)


def name_classes(classes: "pd.Series[Any]") -> "pd.Series[Any]":
    """Name the numbers of classes by `VEHICLE_CLASSES`; another number N becomes "class N"."""
    return classes.map(VEHICLE_CLASSES).fillna(classes.map("class {:g}".format))


def _read_times(
    path: str | os.PathLike[str], table: pd.DataFrame, frame_rate: float | None
) -> "pd.Series[float]":
    """Read times (s) from stamps, from clock times, or from numbers of frames."""
    clock = next((name for name in ("Timestamp", "Local_Time") if name in table), None)
    option = name_option("--tracks-frame-rate", "frame_rate=")
    if clock is not None:
        if frame_rate is not None:
            raise TracksError(f"{Path(path)} has times in the column {clock}; omit {option}")
        return _parse_times(path, table[clock], clock)
    check_columns(path, table, numbers=("Frame_Number",))
    if frame_rate is None:
        raise TracksError(
            f"{Path(path)} has frame numbers and neither Timestamp nor Local_Time, as geo-trax "
            f"writes without a flight log; give the video's frames per second: {option}"
        )
    if not 0 < frame_rate < np.inf:
        raise ValueError(f"frame_rate is {frame_rate}; a positive number of frames/s is needed")
    return table["Frame_Number"] / frame_rate


def _parse_times(
    path: str | os.PathLike[str], stamps: "pd.Series[Any]", name: str
) -> "pd.Series[float]":
    """Convert stamps to seconds: numbers, dates with times, or times of a day."""
    if pd.api.types.is_numeric_dtype(stamps):
        return stamps.astype(float)
    try:
        if name == "Local_Time":
            seconds = pd.to_timedelta(stamps).dt.total_seconds()
            is_next_day = seconds < seconds.max() - DAY_S / 2  # the recording crosses midnight
            return seconds + DAY_S * is_next_day
        clock = pd.to_datetime(stamps, format="ISO8601")  # with fractions of a second or without
    except ValueError as error:
        raise TracksError(
            f"{Path(path)}: {name} is not a time such as 2022-10-07 17:52:13.5: {error}"
        ) from error
    return (clock - clock.min()).dt.total_seconds()


GEOTRAX = TrackFormat(
    "geo-trax",
    has_columns("Vehicle_ID", "Local_X", "Local_Y"),
    lambda path, world=None, frame_rate=None: read_geotrax(
        path, crs=world and world.crs, frame_rate=frame_rate
    ),
    options=("world", "frame_rate"),
)
