"""Stanford Drone Dataset: its annotations, and TrajNet's windows of them."""

import os
from pathlib import Path

import numpy as np

from geoaim.errors import TracksError
from geoaim.track_formats.columns import need_columns, need_numbers
from geoaim.track_formats.motion import tracks_of_places
from geoaim.tracks import Tracks, read_table
from geoaim.world import World

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


def read_sdd(path: str | os.PathLike[str], *, resolution: float) -> Tracks:
    """Read an annotation file of the Stanford Drone Dataset, also when gzipped.

    x is to the right and y up in the reference image, metres from its top-left corner; speeds and
    headings come from the motion over a second.

    Args:
        path: `annotations.txt` or `annotations.txt.gz`.
        resolution: of the reference image.

    Raises:
        TracksError: the file is not of that form, or nobody is seen in it.
        ValueError: the resolution is not positive.
    """
    import pandas as pd

    _check_resolution(resolution)
    names = ["id", "left", "top", "right", "bottom", "frame", "lost", "occluded", "made", "label"]
    table = read_table(path, text=(9,), sep=" ", header=None)
    if table.shape[1] != len(names):
        raise TracksError(
            f"{Path(path)} has {table.shape[1]} columns; {len(names)} are needed: {' '.join(names)}"
        )
    table.columns = pd.Index(names)
    need_numbers(path, table, tuple(names[:-1]))
    table = table[table["lost"] == 0]
    if len(table) == 0:
        raise TracksError(f"{Path(path)}: all agents are lost in all rows")
    sizes = np.array([SDD_SIZES.get(label, (1.0, 1.0)) for label in table["label"]])
    rows = pd.DataFrame(
        {
            "id": table["id"].astype(str),
            "type": [SDD_TYPES.get(label, label.lower()) for label in table["label"]],
            "time": table["frame"] / SDD_RATE,
            "x": 0.5 * resolution * (table["left"] + table["right"]),
            "y": -0.5 * resolution * (table["top"] + table["bottom"]),
            "length": sizes[:, 0],
            "width": sizes[:, 1],
        }
    )
    return tracks_of_places(rows, World(None), reach=0.5)


def read_trajnet(path: str | os.PathLike[str], *, resolution: float | None = None) -> Tracks:
    """Read TrajNet's windows of a scene of the Stanford Drone Dataset: `frame, track, u_px, v_px`.

    All windows stand in one recording of 2.5 Hz, each an agent of 20 steps (8 to observe, 12 to
    predict), so that its neighbours are there too. Who was seen for longer comes back in the next
    window under another id. The plane is that of `read_sdd`; headings and speeds come from the
    motion between the neighbouring steps. All are pedestrians: a window does not say what it holds.

    Args:
        path: a .csv file of one scene.
        resolution: of the scene's image; when None that in `scenes.csv`, a table of scene
            and metres_per_pixel in the file's folder or the one above.

    Raises:
        TracksError: columns are missing, or a value is no number.
        ValueError: the resolution is not positive, or neither given nor in `scenes.csv`.
    """
    import pandas as pd

    if resolution is None:
        resolution = _known_resolution(Path(path))
    _check_resolution(resolution)
    table = read_table(path, text=("track",))
    need_columns(path, table, ("frame", "track", "u_px", "v_px"))
    need_numbers(path, table, ("frame", "u_px", "v_px"))
    length, width = SDD_SIZES["Pedestrian"]
    rows = pd.DataFrame(
        {
            "id": table["track"],
            "type": "pedestrian",
            "time": table["frame"] / SDD_RATE,
            "x": resolution * table["u_px"],
            "y": -resolution * table["v_px"],
            "length": length,
            "width": width,
        }
    )
    return tracks_of_places(rows, World(None), reach=0.5)


def _known_resolution(path: Path) -> float:
    """The resolution of a scene that is called as the file, metres per pixel."""
    import pandas as pd

    for folder in (path.parent, path.parent.parent):
        if (folder / "scenes.csv").exists():
            scenes = pd.read_csv(folder / "scenes.csv", dtype={"scene": str})
            if {"scene", "metres_per_pixel"} <= set(scenes.columns):
                found = scenes["metres_per_pixel"][scenes["scene"] == path.stem]
                if len(found) == 1:
                    return float(found.iloc[0])
    raise ValueError(
        f"{path} is in pixels, and no scenes.csv beside it tells their size for {path.stem!r}; "
        "pass resolution, such as 0.04"
    )


def _check_resolution(resolution: float) -> None:
    if not 0 < resolution < np.inf:
        raise ValueError(f"resolution is {resolution}; a positive number is needed")
