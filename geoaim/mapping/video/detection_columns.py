"""Columns of tables of detections that any program wrote: which holds what."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from geoaim.base.errors import GeoaimError
from geoaim.mapping.video.box_tables import BOX

# what a column holds: names that it has in common tables, in lower case
KNOWN_NAMES: Mapping[str, tuple[str, ...]] = {
    "time": ("time", "time_s", "timestamp", "t", "seconds"),
    "frame": ("frame", "frame_id", "frame_index", "frame_number", "image_id"),
    "id": ("id", "track", "track_id", "tracker_id", "trackid", "vehicle_id", "object_id"),
    "class": ("class_name", "class", "type", "label", "category", "name", "class_id"),
    "score": ("score", "confidence", "conf"),
    "left": ("left", "x_min", "xmin", "x1", "bb_left", "bbox_left"),
    "top": ("top", "y_min", "ymin", "y1", "bb_top", "bbox_top"),
    "right": ("right", "x_max", "xmax", "x2"),
    "bottom": ("bottom", "y_max", "ymax", "y2"),
    "x": ("x", "x_c", "cx", "xc", "u", "u_px", "x_center", "xcenter", "x_px"),
    "y": ("y", "y_c", "cy", "yc", "v", "v_px", "y_center", "ycenter", "y_px"),
    "width": ("width", "w", "bb_width", "bbox_width"),
    "height": ("height", "h", "bb_height", "bbox_height"),
}
NUMBERS = ("time", "frame", "score", *BOX, "x", "y", "width", "height")
EXAMPLE = "--columns frame=frame,id=track,x=u_px,y=v_px,class=label"


def parse_columns(text: str) -> dict[str, str]:
    """Parse the value of --columns: pairs of what a column holds and its name.

    Raises:
        ValueError: the text has another form, or names something unknown.

    >>> parse_columns("frame=frame,x=u_px")
    {'frame': 'frame', 'x': 'u_px'}
    """
    pairs = [part.partition("=") for part in text.split(",") if part.strip()]
    columns = {key.strip(): name.strip() for key, _, name in pairs}
    if not columns or not all(columns.values()) or not columns.keys() <= KNOWN_NAMES.keys():
        raise ValueError(
            f"columns {text!r} are not of the form {EXAMPLE}; before = stands one of "
            f"{', '.join(KNOWN_NAMES)}"
        )
    return columns


def name_columns(path: Path, table: pd.DataFrame, columns: Mapping[str, str]) -> pd.DataFrame:
    """Name the columns of a table by what they hold, and compute the ends of boxes.

    Args:
        path: the file that messages name.
        table: as read.
        columns: names of columns by what they hold; others are found by `KNOWN_NAMES`.

    Returns:
        A table with time or frame, `BOX`, and, where they are known, id, class and score. A point
        without width and height is a box without extent.

    Raises:
        GeoaimError: a column is missing, or a value is not a number.
    """
    found = _find_columns(path, table, columns)
    rows = pd.DataFrame({key: table[name] for key, name in found.items()})
    clock = [key for key in ("time", "frame") if key in rows]
    has_ends, has_middle = set(BOX) <= set(rows), {"x", "y"} <= set(rows)
    if not clock or not (has_ends or has_middle):
        lacking = [] if clock else ["frame or time"]
        lacking += [] if has_ends or has_middle else ["x and y, or left, top, right, bottom"]
        raise GeoaimError(
            f"{path} has the columns {', '.join(map(str, table.columns[:20]))}; "
            f"{' and '.join(lacking)} is needed: say which hold what, such as {EXAMPLE}"
        )
    for key in NUMBERS:
        if key in rows:
            rows[key] = _to_numbers(path, rows[key], found[key])
    if not has_ends:
        width, height = (rows.get(key, 0.0) for key in ("width", "height"))
        rows["left"], rows["right"] = rows["x"] - width / 2, rows["x"] + width / 2
        rows["top"], rows["bottom"] = rows["y"] - height / 2, rows["y"] + height / 2
    for key in ("id", "class"):
        values = rows[key] if key in rows else pd.Series("", rows.index)
        rows[key] = ["" if pd.isna(value) else str(value) for value in values]
    kept = [key for key in (clock[0], "id", "class", "score", *BOX) if key in rows]
    return rows[kept]


def _find_columns(path: Path, table: pd.DataFrame, columns: Mapping[str, str]) -> dict[str, str]:
    missing = [name for name in columns.values() if name not in table.columns]
    if missing:
        raise GeoaimError(
            f"{path} lacks the columns {', '.join(missing)}; it has "
            f"{', '.join(map(str, table.columns[:20]))}"
        )
    by_lower = {str(name).lower(): name for name in reversed(table.columns)}
    found = dict(columns)
    for key, names in KNOWN_NAMES.items():
        is_clock = key in ("time", "frame") and {"time", "frame"} & columns.keys()
        known = next((by_lower[name] for name in names if name in by_lower), None)
        if key not in found and known is not None and known not in found.values() and not is_clock:
            found[key] = known
    return found


def _to_numbers(path: Path, values: "pd.Series[float]", name: str) -> "pd.Series[float]":
    numbers = pd.to_numeric(values, errors="coerce").astype(np.float64)
    wrong = ~np.isfinite(numbers) if name != "score" else numbers.isna() & values.notna()
    if wrong.any():
        row = int(np.argmax(wrong))
        raise GeoaimError(
            f"{path}: {name} is '{str(values.iloc[row])[:40]}' in row {row + 1}; a number is needed"
        )
    return numbers
