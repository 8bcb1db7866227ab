"""The format of Argoverse 2 motion forecasting (Wilson et al. 2021): a Parquet file per scenario.

The schema is that of github.com/argoverse/av2-api: a row for each track and time step.
"""

import os
from pathlib import Path

import numpy as np
import pandas as pd

from geoaim.base.errors import TracksError
from geoaim.base.limits import MAX_TIME_S, refuse_damaged
from geoaim.base.world import LONLAT, World, transform_crs
from geoaim.tracks.files import open_parquet, read_columns
from geoaim.tracks.formats import shared
from geoaim.tracks.formats.motion import compute_signed_speed
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import Tracks

STATES = ("timestep", "position_x", "position_y", "heading", "velocity_x", "velocity_y")
TIMES = ("start_timestamp", "end_timestamp", "num_timestamps")  # nanoseconds, the same in all rows
NAMES = ("track_id", "object_type", "city")
TYPES = {"vehicle": "car", "motorcyclist": "motorcycle"}
OBJECTS = ("static", "background", "construction", "riderless_bicycle", "unknown")
# UTM zone (north), and latitude and longitude of the origin of each city's coordinates
CITIES = {
    "austin": (14, 30.27464237939507, -97.7404457407424),
    "dearborn": (17, 42.29993066912924, -83.17555750783717),
    "miami": (17, 25.77452579915163, -80.19656914449405),
    "palo-alto": (10, 37.416065, -122.13571963362166),
    "pittsburgh": (17, 40.44177902989321, -80.01294377242584),
    "washington-dc": (18, 38.889377, -77.0355047439081),
}


def read_argoverse(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
    """Read an Argoverse 2 scenario, `scenario_<id>.parquet`.

    Times begin at 0. The files have no sizes: each agent gets the typical one of its type. All
    four-wheeled vehicles but buses are cars. Objects that are no road users (`OBJECTS`) keep their
    names as types.

    Args:
        path: the file.
        world: the plane of the positions; None: that of the city which the file names, in UTM.

    Returns:
        The tracks.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: columns are missing, a value is not a number, or the city is unknown.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    with refuse_damaged(path, TracksError, "an Argoverse 2 scenario"):
        file = open_parquet(path)
        known = [*NAMES, *STATES, *TIMES]
        table = read_columns(file, path, known)
        table.index += 1
        shared.check_columns(path, table, numbers=(*STATES, *TIMES), others=NAMES)
        world = world or _find_world(path, str(table["city"].iloc[0]))
        return make_tracks(_convert_states(path, table), world)


def _convert_states(path: Path, table: pd.DataFrame) -> pd.DataFrame:
    """Convert a file's table to rows for `make_tracks`."""
    names = table["object_type"].astype(str).replace(TYPES)
    is_object = names.isin(OBJECTS)
    heading = table["heading"].astype(np.float64)
    velocity = table[["velocity_x", "velocity_y"]].to_numpy(np.float64)
    rows = pd.DataFrame(
        {
            "id": table["track_id"],
            "type": names.where(is_object, shared.map_types(path, names[~is_object])),
            "time": table["timestep"] * _read_interval(path, table),
            "x": table["position_x"],
            "y": table["position_y"],
            "heading": heading,
            "speed": compute_signed_speed(velocity, heading.to_numpy()),
        }
    ).assign(length=np.nan, width=np.nan)
    rows[["length", "width"]] = shared.fill_sizes(rows)
    return rows


def _read_interval(path: Path, table: pd.DataFrame) -> float:
    """Read the seconds between time steps: 0.1 in the published scenarios."""
    begin, end, count = (float(table[name].iloc[0]) for name in TIMES)
    interval = (end - begin) / 1e9 / (count - 1) if count > 1 else 0.0
    if not 0 < interval < MAX_TIME_S:
        raise TracksError(
            f"{path}: {count:g} time steps from {begin:g} to {end:g} ns; two or more steps, and an "
            "end after the start, are needed"
        )
    return interval


def _find_world(path: Path, city: str) -> World:
    """Find the UTM zone of a city, with the origin of the city's coordinates."""
    if city not in CITIES:
        raise TracksError(
            f"{path}: the city {city[:40]!r} is not one of {', '.join(CITIES)}; give a world, the "
            "plane in which the positions lie"
        )
    zone, latitude, longitude = CITIES[city]
    crs = f"EPSG:{32600 + zone}"
    east, north = transform_crs(LONLAT, crs, np.array([[longitude, latitude]]))[0]
    return World(crs, (float(east), float(north)))


ARGOVERSE = shared.TrackFormat(
    "Argoverse 2",
    shared.has_parquet_columns("track_id", "object_type", "timestep", "position_x", "velocity_x"),
    read_argoverse,
    options=("world",),
)
