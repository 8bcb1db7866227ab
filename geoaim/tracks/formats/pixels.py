"""Plain tables of positions in image pixels, such as those of DUT and CITR."""

import os
from pathlib import Path

import numpy as np
import pandas as pd

from geoaim.base.errors import name_option
from geoaim.base.world import World
from geoaim.tracks.files import read_table
from geoaim.tracks.formats import levelx, shared
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.tracks import Tracks

HALF_WINDOW_S = 0.5  # half the time over which positions are differenced
NAMES = {"x_c": "x", "y_c": "y", "label": "type"}  # DUT's names -> ours
UNKNOWN_TYPE = "unknown"


def read_pixels(
    path: str | os.PathLike[str], *, resolution: float, frame_rate: float | None = None
) -> Tracks:
    """Read a .csv of positions in pixels: `id, frame, x, y`, or DUT's `id, frame, x_c, y_c`.

    The column `time` (s) may replace `frame`; `type` or DUT's `label` is the agents' type. x points
    to the right and y up, in metres from the top-left corner of the image, so that y is negative
    inside it. Headings and speeds are derived from the positions over a second; sizes are typical
    of the type. Further columns are ignored.

    Args:
        path: the file.
        resolution: metres per pixel.
        frame_rate: frames per second; needed without times.

    Returns:
        The tracks.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: columns are missing, or a value is not a number.
        ValueError: the resolution or the frame rate is missing or not positive.
    """
    shared.check_resolution(resolution)
    table = read_table(path, text=("id", "type", "label"))
    table = table.rename(columns={k: v for k, v in NAMES.items() if v not in table.columns})
    clock = "time" if "time" in table.columns else "frame"
    shared.check_columns(path, table, numbers=(clock, "x", "y"), others=("id",))
    if clock == "frame" and not (frame_rate and 0 < frame_rate < np.inf):
        raise ValueError(
            f"{Path(path)} has frames and no times, and the frame rate is {frame_rate}; give "
            f"{name_option('--tracks-frame-rate', 'frame_rate=')}, frames per second, such as 29.97"
        )
    types = table.get("type", pd.Series(UNKNOWN_TYPE, table.index)).fillna(UNKNOWN_TYPE)
    rows = pd.DataFrame(
        {
            "id": table["id"],
            "type": shared.map_types(path, types),
            "time": table[clock] / (1.0 if clock == "time" else frame_rate or 1.0),
            "x": resolution * table["x"],
            "y": -resolution * table["y"],
            "length": np.nan,
            "width": np.nan,
        }
    )
    rows[["length", "width"]] = shared.fill_sizes(rows)
    return make_tracks_from_positions(rows, World(None), half_window=HALF_WINDOW_S)


_MATCHERS = [
    shared.has_columns("id", clock, *names)
    for clock in ("frame", "time")
    for names in (("x", "y"), ("x_c", "y_c"))
]


def _matches(path: Path, line: str) -> bool:
    """Whether a table has positions, and not the name of a file of highD, which has those too."""
    has_positions = any(matches(path, line) for matches in _MATCHERS)
    return has_positions and not path.name.endswith(levelx.SUFFIX)


PIXELS = shared.TrackFormat(
    "pixel",
    _matches,
    read_pixels,
    options=("resolution", "frame_rate"),
    required=("resolution",),
    rank=2,
)
