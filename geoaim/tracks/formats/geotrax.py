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

from geoaim.aim.aim import AIM
from geoaim.base.errors import TracksError, name_option, warn
from geoaim.base.files import atomic_write
from geoaim.base.geometry import transform_points
from geoaim.base.world import World, change_world, crs_from_world, lonlat_from_world
from geoaim.tracks.files import read_table
from geoaim.tracks.formats import shared
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.formats.shared import TrackFormat, check_columns, has_columns, map_types
from geoaim.tracks.tracks import Tracks

VEHICLE_CLASSES = {0: "car", 1: "bus", 2: "truck", 3: "motorcycle"}
CLASS_OF_TYPE = {name: number for number, name in VEHICLE_CLASSES.items()} | {"van": 0}
SIZES = ("Vehicle_Length", "Vehicle_Width")
KMH_PER_MPS = 3.6
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


def write_geotrax(tracks: Tracks, path: str | os.PathLike[str], *, aim: AIM | None = None) -> None:
    """Write vehicles as a geo-trax .csv, with positions in metres and in degrees.

    Times are seconds and speeds km/h. The format has no heading and no vans, which become cars.
    Other agents are left out, with a warning. If an id is no number, all agents are numbered.

    Args:
        tracks: tracks in a world with a CRS, which Local_X and Local_Y are written in.
        path: the .csv to write.
        aim: the map whose pixels are Ortho_X and Ortho_Y; None leaves them empty.

    Raises:
        TracksError: no car, van, bus, truck or motorcycle is present.
        GeoreferenceError: the tracks, or the map, have no CRS.
    """
    table = tracks.to_dataframe()
    table = table[table["type"].isin(CLASS_OF_TYPE)].reset_index(drop=True)
    if not len(table):
        raise TracksError(f"no agent is one of {', '.join(CLASS_OF_TYPE)}, as geo-trax needs")
    if left_out := len(tracks.ids) - table["id"].nunique():
        warn(f"{path}: {left_out} agents are left out, whose types geo-trax does not have")
    written = pd.concat(
        [_describe_places(table, tracks.world, aim), _describe_vehicles(table)], axis="columns"
    )
    steps = np.diff(tracks.times)
    frames = (table["time"] - tracks.times[0]) / (np.median(steps) if len(steps) else 1.0)
    is_numbered = table["id"].str.fullmatch(r"\d+").all()
    numbers = table["id"] if is_numbered else pd.factorize(table["id"])[0] + 1
    written.insert(0, "Vehicle_ID", numbers)
    written.insert(1, "Timestamp", table["time"])
    written.insert(2, "Frame_Number", frames.round().astype(int))
    with atomic_write(path) as temporary:
        written.to_csv(temporary, index=False, lineterminator="\n")


def _describe_places(table: pd.DataFrame, world: World, aim: AIM | None) -> pd.DataFrame:
    """Pixels of the map, metres in the CRS and degrees of the positions."""
    positions = table[["x", "y"]].to_numpy()
    pixels = np.full_like(positions, np.nan)
    if aim is not None:
        on_map = change_world(world, aim.world, positions)
        pixels = transform_points(np.linalg.inv(aim.world_from_image), on_map)
    lonlat = lonlat_from_world(world, positions)
    return pd.DataFrame(
        {
            "Ortho_X": pixels[:, 0].round(1),
            "Ortho_Y": pixels[:, 1].round(1),
            "Local_X": crs_from_world(world, positions)[:, 0].round(3),
            "Local_Y": crs_from_world(world, positions)[:, 1].round(3),
            "Latitude": lonlat[:, 1].round(8),
            "Longitude": lonlat[:, 0].round(8),
        }
    )


def _describe_vehicles(table: pd.DataFrame) -> pd.DataFrame:
    """Sizes, classes, speeds and accelerations; roads and lanes are empty."""
    return pd.DataFrame(
        {
            "Vehicle_Length": table["length"].round(2),
            "Vehicle_Width": table["width"].round(2),
            "Vehicle_Class": table["type"].map(CLASS_OF_TYPE),
            "Vehicle_Speed": (KMH_PER_MPS * table["speed"].abs()).round(1),
            "Vehicle_Acceleration": _differentiate_speeds(table).round(2),
            "Road_Section": "",
            "Lane_Number": "",
            "Visibility": 1,
        }
    )


def _differentiate_speeds(table: pd.DataFrame) -> "pd.Series[float]":
    """Accelerations (m/s²) between each row of an agent and its next; NaN in its last one."""
    next_rows = table.groupby("id", sort=False)[["speed", "time"]].shift(-1)
    return (next_rows["speed"] - table["speed"]) / (next_rows["time"] - table["time"])


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
