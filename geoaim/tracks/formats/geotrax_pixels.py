"""What geo-trax extracts from a video before it has an orthophoto: vehicles in pixels.

The file has 14 or 15 columns of numbers and no header.
"""

import os
import re
from pathlib import Path

import numpy as np
import pandas as pd

from geoaim.base.errors import TracksError
from geoaim.base.world import World
from geoaim.tracks.files import read_table
from geoaim.tracks.formats import shared
from geoaim.tracks.formats.geotrax import name_classes
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.tracks import Tracks

# columns of a file in pixels; boxes in each frame, then those in the reference frame
BOX, STABILISED_BOX = ("u", "v", "du", "dv"), ("ref_u", "ref_v", "ref_du", "ref_dv")
PIXEL_COLUMNS = ("frame", "track", *BOX, *STABILISED_BOX, "class", "confidence", "length", "width")
PIXEL_LINE = re.compile(r"[-+.\deE]+(,([-+.\deE]+|nan)){13,14}")
FRAME_RATE = 30_000 / 1001  # Hz, of the drones of the Songdo dataset


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
    shared.check_columns(path, table, numbers=PIXEL_COLUMNS)
    u, v = (STABILISED_BOX if stabilised else BOX)[:2]
    rows = pd.DataFrame(
        {
            "id": table["track"].map("{:.0f}".format),
            "type": shared.map_types(path, name_classes(table["class"])),
            "time": table["frame"] / frame_rate,
            "x": resolution * table[u],
            "y": -resolution * table[v],
            "length": resolution * table["length"],
            "width": resolution * table["width"],
        }
    )
    rows[["length", "width"]] = shared.fill_sizes(rows)
    return make_tracks_from_positions(rows, World(None), half_window=0.25)


GEOTRAX_PIXELS = shared.TrackFormat(
    "geo-trax pixels",
    lambda path, line: PIXEL_LINE.fullmatch(line) is not None,
    read_geotrax_pixels,
    options=("resolution", "frame_rate"),
    required=("resolution",),
)
