"""SinD's form: vehicles and pedestrians of a recording in a file each."""

import os
from pathlib import Path

import numpy as np

from geoaim.errors import TracksError
from geoaim.track_formats.columns import need_columns
from geoaim.track_formats.interaction import read_states, rows_of_states
from geoaim.track_formats.motion import signed_speed, warn_of_backwards
from geoaim.tracks import Tracks, make_tracks
from geoaim.world import World

FILES = ("Veh_smoothed_tracks.csv", "Ped_smoothed_tracks.csv")


def read_sind(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
    """Read a recording of SinD: `track_id, frame_id, timestamp_ms, agent_type, x, y, vx, vy, ...`.

    Vehicles head as yaw_rad says; pedestrians, who are points, the way they move.

    Args:
        path: `Veh_smoothed_tracks.csv`, `Ped_smoothed_tracks.csv`, or the folder of a recording,
            whose vehicles and pedestrians come together.
        world: where x and y lie; a plane of its own when None.

    Raises:
        TracksError: a folder has neither file, columns are missing, or a value is no number.
    """
    import pandas as pd

    path = Path(path)
    files = [path / name for name in FILES if (path / name).exists()] if path.is_dir() else [path]
    if not files:
        raise TracksError(f"{path} has neither {' nor '.join(FILES)}; name a recording's folder")
    rows = []
    for file in files:
        table = read_states(file, heading="yaw_rad")
        rows.append(rows_of_states(table, heading="yaw_rad"))
        boxes = (table["agent_type"].str.lower() != "pedestrian").to_numpy()
        if boxes.any():
            need_columns(file, table, ("yaw_rad",))
        velocity = table[["vx", "vy"]].to_numpy(np.float64)
        signed = signed_speed(velocity, rows[-1]["heading"].to_numpy())
        rows[-1]["speed"] = np.where(boxes, signed, rows[-1]["speed"])
    tracks = make_tracks(pd.concat(rows), world if world is not None else World(None))
    warn_of_backwards(path, tracks)
    return tracks
