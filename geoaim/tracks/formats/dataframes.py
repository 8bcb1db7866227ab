"""Tracks from a pandas DataFrame, with headings, speeds and sizes where it has none."""

from difflib import get_close_matches

import numpy as np
import pandas as pd

from geoaim.base.errors import TracksError
from geoaim.base.world import World
from geoaim.tracks.formats.motion import derive_motion, derive_speeds
from geoaim.tracks.formats.plausibility import (
    HALF_WINDOW_S,
    check_place,
    check_plausibility,
    derive_contradicted_motion,
)
from geoaim.tracks.formats.shared import fill_sizes, map_types, name_vehicles
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import COLUMNS, Tracks

NEEDED = ("id", "time", "x", "y")
NAME = "the DataFrame"  # in messages, where those of files have a path


def read_dataframe(
    frame: pd.DataFrame, *, world: World | None = None, frame_rate: float | None = None
) -> Tracks:
    """Make tracks of a DataFrame; `Tracks.from_dataframe` describes it."""
    rows = frame if frame_rate is None else _read_frames(frame, frame_rate)
    if missing := [name for name in NEEDED if name not in rows.columns]:
        raise TracksError(
            f"{NAME} lacks the columns {', '.join(missing)}; it has "
            f"{', '.join(map(str, frame.columns[:20]))}. {_suggest(missing, rows)}"
        )
    lacks = {name for name in ("heading", "speed") if name not in rows.columns}
    rows = rows.assign(**dict.fromkeys(lacks, 0.0))
    if pd.api.types.is_datetime64_any_dtype(rows["time"]):
        rows["time"] = (rows["time"] - rows["time"].min()).dt.total_seconds()
    has_types = "type" in rows.columns
    rows["type"] = map_types(NAME, rows["type"].astype(str)) if has_types else "car"
    rows[["length", "width"]] = fill_sizes(rows.reindex(columns=["type", "length", "width"]))
    if not has_types:
        rows["type"] = name_vehicles(rows["type"], rows["length"], vehicle="car")
    tracks = make_tracks(rows, world or World(None))
    check_place(NAME, tracks)
    if "heading" in lacks:
        tracks = derive_motion(tracks, half_window=HALF_WINDOW_S)
    elif lacks:
        tracks = derive_speeds(tracks, half_window=HALF_WINDOW_S)
    else:
        tracks = derive_contradicted_motion(NAME, tracks)
    check_plausibility(NAME, tracks)
    return tracks


def _read_frames(frame: pd.DataFrame, frame_rate: float) -> pd.DataFrame:
    if not 0 < frame_rate < np.inf:
        raise ValueError(f"frame_rate is {frame_rate}; a positive number of frames is needed")
    if "frame" not in frame.columns:
        raise TracksError(f"{NAME} has no column frame; omit frame_rate, or rename one to frame")
    return frame.assign(time=pd.to_numeric(frame["frame"], errors="coerce") / frame_rate)


def _suggest(missing: list[str], rows: pd.DataFrame) -> str:
    """Suggest how columns may be renamed to those that are missing."""
    if missing == ["time"] and "frame" in rows.columns:
        return "Give frame_rate=, the frames per second of its column frame"
    others = [str(name) for name in rows.columns if name not in COLUMNS]
    names = {
        found[0]: name for name in missing if (found := get_close_matches(name, others, 1, 0.3))
    }
    return f"Rename columns, such as frame.rename(columns={names or {'track_id': 'id'}})"
