"""Tracks from the files of public data sets: INTERACTION, Stanford Drone Dataset, geo-trax."""

import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoaimWarning, TracksError
from geoaim.tracks import COLUMNS, Tracks, heading_of_motion, tracks_of_rows
from geoaim.world import World

if TYPE_CHECKING:
    from pandas import DataFrame

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
        TracksError: columns are missing.
    """
    import pandas as pd

    table = pd.read_csv(path)
    _need(path, table, ("track_id", "timestamp_ms", "agent_type", "x", "y", "vx", "vy"))
    for name, default in (("length", 0.5), ("width", 0.5)):
        table[name] = table[name].fillna(default) if name in table else default
    rows = pd.DataFrame(
        {
            "id": table["track_id"].astype(str),
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
    known = rows["heading"].notna()
    rows.loc[~known, "heading"] = np.arctan2(table["vy"], table["vx"])[~known]
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
        TracksError: the file is not of that form.
    """
    import pandas as pd

    names = ["id", "left", "top", "right", "bottom", "frame", "lost", "occluded", "made", "label"]
    table = pd.read_csv(path, sep=" ", header=None, names=names)
    _need(path, table.dropna(axis=1, how="all"), tuple(names))
    table = table[table["lost"] == 0]
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
        TracksError: columns are missing.
    """
    import pandas as pd

    table = pd.read_csv(path)
    needed = ("Vehicle_ID", "Timestamp", "Local_X", "Local_Y", "Vehicle_Class")
    _need(path, table, (*needed, "Vehicle_Length", "Vehicle_Width"))
    for name in ("Vehicle_Length", "Vehicle_Width"):  # not every vehicle could be measured
        usual = table.groupby("Vehicle_Class")[name].transform("median")
        table[name] = table[name].fillna(usual).fillna(table[name].median())
    clock = pd.to_datetime(table["Timestamp"])
    origin = (round(float(table["Local_X"].mean()), -2), round(float(table["Local_Y"].mean()), -2))
    rows = pd.DataFrame(
        {
            "id": table["Vehicle_ID"].astype(str),
            "type": [GEOTRAX_TYPES.get(kind, "other") for kind in table["Vehicle_Class"]],
            "time": (clock - clock.min()).dt.total_seconds(),
            "x": table["Local_X"] - origin[0],
            "y": table["Local_Y"] - origin[1],
            "length": table["Vehicle_Length"],
            "width": table["Vehicle_Width"],
        }
    )
    return _with_motion(rows, World(crs, origin), reach=0.25)


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
    return Tracks(
        tracks.times, states, tracks.present, tracks.sizes, tracks.types, tracks.ids, world
    )


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
