"""The tables of geo-trax (github.com/rfonod/geo-trax): vehicles detected in drone videos.

They are in metres; what it extracts before it has an orthophoto, a .txt of 14 or 15 columns of
numbers without a header, is in pixels.
"""

import os
import re
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
# columns of a file in pixels; boxes in each frame, then those in the reference frame
BOX, STABILISED_BOX = ("u", "v", "du", "dv"), ("ref_u", "ref_v", "ref_du", "ref_dv")
PIXEL_COLUMNS = ("frame", "track", *BOX, *STABILISED_BOX, "class", "confidence", "length", "width")
PIXEL_LINE = re.compile(r"[-+.\deE]+(,([-+.\deE]+|nan)){13,14}")
FRAME_RATE = 30_000 / 1001  # Hz, of the drones of the Songdo dataset


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


def read_geotrax_pixels(
    path: str | os.PathLike[str],
    *,
    resolution: float,
    frame_rate: float = FRAME_RATE,
    stabilised: bool = True,
) -> Tracks:
    """Read what geo-trax extracts from a video: a .txt of 14 or 15 columns in pixels.

    x points to the right and y up, in metres from the top-left corner of the reference frame.
    Headings and speeds are derived from the positions over half a second.

    Args:
        path: a file without a header: frame, track, box in the frame, box in the reference frame
            (each u, v, width, height), class, confidence, length, width.
        resolution: metres per pixel.
        frame_rate: frame rate of the video, frames/s, which the file does not state.
        stabilised: whether positions are those in the reference frame; False for those in each
            frame, which `geoaim.mapping.place_tracks` takes.

    Returns:
        The tracks.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file does not have this format.
        ValueError: the resolution or the frame rate is not positive.
    """
    shared.check_resolution(resolution)
    if not 0 < frame_rate < np.inf:
        raise ValueError(f"frame_rate is {frame_rate}; a positive number of frames/s is needed")
    table = read_table(path, text=(), header=False)
    count = len(PIXEL_COLUMNS)
    if table.shape[1] not in (count, count + 1):  # a 15th one marks interpolated rows
        raise TracksError(
            f"{Path(path)} has {table.shape[1]} columns; 14 or 15 are needed, as geo-trax writes "
            "them with stabilisation"
        )
    table = table.iloc[:, :count].set_axis(PIXEL_COLUMNS, axis="columns")
    check_columns(path, table, numbers=PIXEL_COLUMNS)
    u, v = (STABILISED_BOX if stabilised else BOX)[:2]
    rows = pd.DataFrame(
        {
            "id": table["track"].map("{:.0f}".format),
            "type": map_types(path, name_classes(table["class"])),
            "time": table["frame"] / frame_rate,
            "x": resolution * table[u],
            "y": -resolution * table[v],
            "length": resolution * table["length"],
            "width": resolution * table["width"],
        }
    )
    rows[["length", "width"]] = shared.fill_sizes(rows)
    return make_tracks_from_positions(rows, World(None), half_window=0.25)


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
GEOTRAX_PIXELS = TrackFormat(
    "geo-trax pixels",
    lambda path, line: PIXEL_LINE.fullmatch(line) is not None,
    read_geotrax_pixels,
    options=("resolution", "frame_rate"),
    required=("resolution",),
)
