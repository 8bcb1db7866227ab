"""The format of the Stanford Drone Dataset (SDD)."""

import os
import re
from pathlib import Path

import numpy as np
import pandas as pd

from geoaim.base.errors import TracksError
from geoaim.base.world import World
from geoaim.tracks.files import read_table
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.formats.shared import TrackFormat, check_columns, check_resolution
from geoaim.tracks.tracks import Tracks

FRAME_RATE = 30.0
HALF_WINDOW_S = 0.5  # half the time over which positions are differenced
BOX = ("left", "top", "right", "bottom")
COLUMNS = ("id", *BOX, "frame", "lost", "occluded", "generated", "label")
FIRST_LINE = re.compile(r'\d+( -?\d+){5}( [01]){3} "?\w+"?')
# length and width in metres; the boxes in the files include limbs and shadows
SIZES = {
    "Pedestrian": (0.5, 0.6),
    "Biker": (1.8, 0.65),
    "Skater": (0.7, 0.6),
    "Cart": (2.6, 1.3),
    "Car": (4.5, 1.8),
    "Bus": (12.0, 2.5),
}
OTHER_SIZE = (1.0, 1.0)
AGENT_TYPES = {"Biker": "cyclist"}


def read_sdd(path: str | os.PathLike[str], *, resolution: float) -> Tracks:
    """Read `annotations.txt` or `annotations.txt.gz` of the Stanford Drone Dataset.

    x points to the right and y up, in metres from the top-left corner of the image, so that y is
    negative inside it, at `resolution` metres per pixel. Headings and speeds are derived from the
    positions over a second. Rows that are marked as lost are left out.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file does not have this format, or all agents are lost in it.
        ValueError: the resolution is not positive.
    """
    check_resolution(resolution)
    table = read_table(path, text=(9,), delimiter=" ", header=False)
    if table.shape[1] != len(COLUMNS):
        raise TracksError(
            f"{Path(path)} has {table.shape[1]} columns; {len(COLUMNS)} are needed: "
            f"{' '.join(COLUMNS)}"
        )
    table.columns = pd.Index(COLUMNS)
    check_columns(path, table, numbers=COLUMNS[:-1])
    table = table[table["lost"] == 0]
    if len(table) == 0:
        raise TracksError(f"{Path(path)}: every row is marked as lost")
    sizes = np.array([SIZES.get(label, OTHER_SIZE) for label in table["label"]])
    rows = pd.DataFrame(
        {
            "id": table["id"].astype(str),
            "type": [AGENT_TYPES.get(label, label.lower()) for label in table["label"]],
            "time": table["frame"] / FRAME_RATE,
            "x": 0.5 * resolution * (table["left"] + table["right"]),
            "y": -0.5 * resolution * (table["top"] + table["bottom"]),
            "length": sizes[:, 0],
            "width": sizes[:, 1],
        }
    )
    return make_tracks_from_positions(rows, World(None), half_window=HALF_WINDOW_S)


SDD = TrackFormat(
    "SDD",
    lambda path, line: FIRST_LINE.fullmatch(line) is not None,
    read_sdd,
    options=("resolution",),
    required=("resolution",),
)
