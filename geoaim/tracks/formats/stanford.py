"""The formats of the Stanford Drone Dataset (SDD) and of TrajNet's windows of it."""

import math
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import TracksError
from geoaim.base.limits import MAX_POSITION_M
from geoaim.base.world import World
from geoaim.tracks.files import read_table
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.formats.shared import TrackFormat, check_columns, check_resolution, has_columns
from geoaim.tracks.tracks import Tracks

FRAME_RATE = 30.0
WINDOW_STEPS = 20  # of a window of TrajNet
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


def read_trajnet(path: str | os.PathLike[str], *, resolution: float | None = None) -> Tracks:
    """Read TrajNet's windows of one SDD scene: `frame, track, u_px, v_px`.

    All windows become one recording of 2.5 Hz in which each window is an agent of 20 steps (8 to
    observe, 12 to predict), so that its neighbours are present too. An agent that was seen for
    longer returns in the next window under another id. All agents are pedestrians, since the
    windows do not say their types. Headings and speeds are derived from the neighbouring steps.
    The plane is that of `read_sdd`.

    Args:
        path: a .csv file of one scene.
        resolution: metres per pixel; None for that in `scenes.csv`, a table with the columns
            scene and metres_per_pixel in the file's folder or the one above.

    Returns:
        The tracks.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: columns are missing, or a value is not a number.
        ValueError: the resolution is neither given nor in `scenes.csv`, or is not positive.
    """
    if resolution is None:
        resolution = _look_up_resolution(Path(path))
    check_resolution(resolution)
    table = read_table(path, text=("track",))
    check_columns(path, table, numbers=("frame", "u_px", "v_px"), others=("track",))
    length, width = SIZES["Pedestrian"]
    rows = pd.DataFrame(
        {
            "id": table["track"],
            "type": "pedestrian",
            "time": table["frame"] / FRAME_RATE,
            "x": resolution * table["u_px"],
            "y": -resolution * table["v_px"],
            "length": length,
            "width": width,
        }
    )
    return make_tracks_from_positions(rows, World(None), half_window=HALF_WINDOW_S)


def read_trajnet_windows(path: Path, resolution: float) -> Float[Array, "B T 2"]:
    """Read TrajNet's windows of one scene as paths, metres to the right and up.

    Raises:
        TracksError: columns are missing, or rows are not windows of `WINDOW_STEPS` of one track.
    """
    table = read_table(path, text=("track",))
    check_columns(path, table, numbers=("u_px", "v_px"), others=("frame", "track"))
    metres = table[["u_px", "v_px"]].to_numpy(float) * [resolution, -resolution]
    tracks = table["track"].to_numpy()
    if len(table) % WINDOW_STEPS or not (np.abs(metres) <= MAX_POSITION_M).all():
        raise TracksError(
            f"{path}: {len(table)} rows; windows of {WINDOW_STEPS} rows each, with pixels of an "
            "image, are needed"
        )
    if (tracks.reshape(-1, WINDOW_STEPS) != tracks[::WINDOW_STEPS, None]).any():
        raise TracksError(f"{path}: a window of {WINDOW_STEPS} rows has more than one track")
    return metres.reshape(-1, WINDOW_STEPS, 2)


def _look_up_resolution(path: Path) -> float:
    """Look up the resolution of the scene that has the file's name."""
    for folder in (path.parent, path.parent.parent):
        if (folder / "scenes.csv").exists():
            scales = read_resolutions(folder / "scenes.csv")
            if path.stem in scales:
                return scales[path.stem]
    raise ValueError(
        f"{path} is in pixels, and no scenes.csv in its folder or the one above gives "
        f"metres_per_pixel of scene {path.stem!r}; give a resolution in metres per pixel, such as "
        "0.04"
    )


def read_resolutions(path: Path) -> dict[str, float]:
    """Read metres per pixel by scene from a table like `scenes.csv`.

    Raises:
        TracksError: the table is malformed.
    """
    table = read_table(path, text=("scene",))
    check_columns(path, table, numbers=("metres_per_pixel",), others=("scene",))
    if len(twice := table["scene"][table["scene"].duplicated()]):
        raise TracksError(f"{path} has several rows of the scene {twice.iloc[0]}; one is needed")
    scales = dict(zip(table["scene"].astype(str), table["metres_per_pixel"], strict=True))
    for name, scale in scales.items():
        if not 0 < scale < math.inf:
            raise TracksError(f"{path}: metres_per_pixel of {name} is {scale}")
    return scales


SDD = TrackFormat(
    "SDD",
    lambda path, line: FIRST_LINE.fullmatch(line) is not None,
    read_sdd,
    options=("resolution",),
    required=("resolution",),
)
TRAJNET = TrackFormat(
    "TrajNet", has_columns("frame", "track", "u_px", "v_px"), read_trajnet, options=("resolution",)
)
