"""The forms of inD, rounD, exiD and uniD, and of highD: three tables a recording.

Beside `00_tracks.csv` stand `00_tracksMeta.csv`, with what each agent is, and
`00_recordingMeta.csv`, with the frame rate and the place.
"""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geoaim.errors import TracksError
from geoaim.geometry import wrap_angle
from geoaim.track_formats.columns import need_columns, need_numbers, sizes_of, types_of
from geoaim.track_formats.motion import kept_heading, signed_speed, warn_of_backwards
from geoaim.tracks import Tracks, make_tracks, read_table
from geoaim.world import World, utm_crs

if TYPE_CHECKING:
    from pandas import DataFrame, Series

ENDING = "_tracks.csv"
ROLLING = 2.0  # m/s from which the velocity on a motorway tells the heading
IND = ("frame", "xCenter", "yCenter", "heading", "width", "length", "xVelocity", "yVelocity")
IND_PLACE = ("frameRate", "latLocation", "lonLocation", "xUtmOrigin", "yUtmOrigin")
HIGHD = ("frame", "x", "y", "width", "height", "xVelocity", "yVelocity")


def read_ind(path: str | os.PathLike[str]) -> Tracks:
    """Read a recording of inD, rounD, exiD or uniD: `recordingId, trackId, frame, xCenter, ...`.

    The world is UTM, in the zone of the recording's place, with the recording's origin. Who is
    written as a point, as pedestrians and cyclists are, gets the size usual for the type.

    Args:
        path: `XX_tracks.csv`, with `XX_tracksMeta.csv` and `XX_recordingMeta.csv` beside it.

    Raises:
        TracksError: a file or columns are missing, or a value is no number.
        GeoreferenceError: the recording's place lies in no UTM zone.
    """
    import pandas as pd

    table = _numbers(path, "trackId", IND)
    recording = _recording(path, IND_PLACE)
    heading = wrap_angle(np.radians(table["heading"].to_numpy(np.float64)))
    velocity = table[["xVelocity", "yVelocity"]].to_numpy(np.float64)
    boxes = table["width"].to_numpy() > 0
    rows = pd.DataFrame(
        {
            "id": table["trackId"],
            "type": _of_agents(path, table["trackId"], "trackId", "class"),
            "time": table["frame"] / recording["frameRate"],
            "x": table["xCenter"],
            "y": table["yCenter"],
            "heading": heading,
            "speed": np.where(boxes, signed_speed(velocity, heading), np.hypot(*velocity.T)),
            "length": table["length"],
            "width": table["width"],
        }
    )
    rows["type"] = types_of(rows["type"])
    rows[["length", "width"]] = sizes_of(rows)
    crs = utm_crs(recording["lonLocation"], recording["latLocation"])
    world = World(crs, (recording["xUtmOrigin"], recording["yUtmOrigin"]))
    tracks = make_tracks(rows, world)
    warn_of_backwards(path, tracks)
    return tracks


def read_highd(path: str | os.PathLike[str]) -> Tracks:
    """Read a recording of highD: `frame, id, x, y, width, height, xVelocity, yVelocity, ...`.

    The file's y points down and x, y are a box's corner; the tracks' y points up and x, y are its
    middle, in a plane of its own. Headings are those of the motion, or of the carriageway while an
    agent hardly moves.

    Args:
        path: `XX_tracks.csv`, with `XX_tracksMeta.csv` and `XX_recordingMeta.csv` beside it.

    Raises:
        TracksError: a file or columns are missing, or a value is no number.
    """
    import pandas as pd

    table = _numbers(path, "id", HIGHD)
    recording = _recording(path, ("frameRate",))
    east, north = table["xVelocity"], -table["yVelocity"]
    towards = _of_agents(path, table["id"], "id", "drivingDirection")
    if not towards.isin(["1", "2"]).all():
        found = towards[~towards.isin(["1", "2"])].iloc[0]
        raise TracksError(f"{Path(path)}: drivingDirection {found!r} is neither 1 nor 2")
    rows = pd.DataFrame(
        {
            "id": table["id"],
            "type": types_of(_of_agents(path, table["id"], "id", "class")),
            "time": table["frame"] / recording["frameRate"],
            "x": table["x"] + 0.5 * table["width"],
            "y": -(table["y"] + 0.5 * table["height"]),
            "speed": np.hypot(east, north),
            "length": table["width"],
            "width": table["height"],
        }
    )
    moving = rows["speed"] > ROLLING
    rows["heading"] = np.where(moving, np.arctan2(north, east), np.nan)
    never = ~moving.groupby(rows["id"]).transform("any")
    along = np.where(towards == "1", -np.pi, 0.0)  # the upper carriageway goes left
    rows["heading"] = rows["heading"].where(~never, along)
    return make_tracks(kept_heading(rows), World(None))


def _numbers(path: str | os.PathLike[str], name: str, numbers: tuple[str, ...]) -> "DataFrame":
    """The table of tracks, agents called by the column `name`."""
    table = read_table(path, text=(name,), low_memory=False)
    need_columns(path, table, (name, *numbers))
    need_numbers(path, table, numbers)
    return table


def _beside(path: str | os.PathLike[str], kind: str, text: tuple[str, ...]) -> "DataFrame":
    """The recording's table of another kind."""
    path = Path(path)
    name = f"{path.name.removesuffix(ENDING)}_{kind}.csv"
    if not path.name.endswith(ENDING) or not path.with_name(name).exists():
        raise TracksError(
            f"{path} has no {name} beside it; keep XX_tracks.csv, XX_tracksMeta.csv and "
            "XX_recordingMeta.csv of a recording together, under their names"
        )
    return read_table(path.with_name(name), text=text)


def _recording(path: str | os.PathLike[str], names: tuple[str, ...]) -> dict[str, float]:
    """Numbers of the recording."""
    table = _beside(path, "recordingMeta", ())
    need_columns(f"{path}'s recordingMeta", table, names)
    need_numbers(f"{path}'s recordingMeta", table, names)
    told = {name: float(table[name].iloc[0]) for name in names}
    if not told["frameRate"] > 0:
        raise TracksError(f"{path}: a frameRate of {told['frameRate']} is not positive")
    return told


def _of_agents(
    path: str | os.PathLike[str], ids: "Series[Any]", name: str, column: str
) -> "Series[Any]":
    """What the table of agents says in a column, for each row of the tracks."""
    meta = _beside(path, "tracksMeta", (name, column))
    need_columns(f"{path}'s tracksMeta", meta, (name, column))
    told = ids.map(meta.drop_duplicates(name).set_index(name)[column])
    if told.isna().any():
        raise TracksError(f"{path}: {ids[told.isna()].iloc[0]!r} is not in its tracksMeta")
    return told
