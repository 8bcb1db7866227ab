"""The SinD format: a recording's vehicles and pedestrians, in one file each."""

import os
from pathlib import Path

import numpy as np

from geoaim.errors import TracksError
from geoaim.track_formats.columns import check_columns
from geoaim.track_formats.interaction import convert_states, read_states
from geoaim.track_formats.motion import compute_signed_speed, warn_of_reversed_headings
from geoaim.track_formats.track_format import TrackFormat, has_columns
from geoaim.track_tables import make_tracks
from geoaim.tracks import Tracks
from geoaim.world import World

FILES = ("Veh_smoothed_tracks.csv", "Ped_smoothed_tracks.csv")


def read_sind(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
    """Read a SinD recording: `track_id, frame_id, timestamp_ms, agent_type, x, y, vx, vy, ...`.

    Vehicles have the heading yaw_rad; pedestrians, which are points, that of their motion.

    Args:
        path: `Veh_smoothed_tracks.csv`, `Ped_smoothed_tracks.csv`, or the folder of a recording
            for both together.
        world: the plane of x and y; None for a plane without a place on the Earth.

    Raises:
        TracksError: a folder has neither file, columns are missing, or a value is not a number.
    """
    import pandas as pd

    path = Path(path)
    files = [path / name for name in FILES if (path / name).exists()] if path.is_dir() else [path]
    if not files:
        raise TracksError(
            f"{path} has neither {' nor '.join(FILES)}; give the folder of a recording"
        )
    tables = []
    for file in files:
        table = read_states(file, heading="yaw_rad")
        rows = convert_states(table, heading="yaw_rad")
        vehicles = (table["agent_type"].str.lower() != "pedestrian").to_numpy()
        if vehicles.any():
            check_columns(file, table, numbers=("yaw_rad",))
        velocity = table[["vx", "vy"]].to_numpy(np.float64)
        signed = compute_signed_speed(velocity, rows["heading"].to_numpy())
        rows["speed"] = np.where(vehicles, signed, rows["speed"])
        tables.append(rows)
    tracks = make_tracks(pd.concat(tables), world if world is not None else World(None))
    warn_of_reversed_headings(path, tracks)
    return tracks


_has_vehicle_columns = has_columns("track_id", "timestamp_ms", "x", "yaw_rad")
_has_pedestrian_columns = has_columns("track_id", "timestamp_ms", "x", "ax", "ay")


def _matches(path: Path, line: str) -> bool:
    return path.is_dir() or _has_vehicle_columns(path, line) or _has_pedestrian_columns(path, line)


SIND = TrackFormat("SinD", _matches, read_sind, options=("world",))
