"""geo-trax's form: vehicles found in drone videos, on an orthophoto."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geoaim.errors import TracksError
from geoaim.track_formats.columns import need_columns, need_numbers
from geoaim.track_formats.motion import tracks_of_places
from geoaim.tracks import Tracks, read_table
from geoaim.world import World

if TYPE_CHECKING:
    from pandas import Series

GEOTRAX_TYPES = {0: "car", 1: "bus", 2: "truck", 3: "motorcycle"}


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
    need_columns(path, table, (*needed, "Vehicle_Length", "Vehicle_Width"))
    need_numbers(path, table, (*needed[2:], "Vehicle_Length", "Vehicle_Width"))
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
    return tracks_of_places(rows, World(crs, origin), reach=0.25)


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
