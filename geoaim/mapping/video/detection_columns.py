"""Columns of tables of detections: which holds what."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from geoaim.base.errors import GeoaimError
from geoaim.mapping.video.detection_checks import PAGE, RawBoxes

# what a column holds: names that it has in common tables, in lower case
KNOWN_NAMES: Mapping[str, tuple[str, ...]] = {
    "time": ("time", "time_s"),
    "frame": ("frame", "frame_id", "frame_index", "frame_number"),
    "name": ("image", "filename", "file_name"),
    "class": ("class_name", "class", "type", "label", "category", "class_id"),
    "score": ("score", "confidence", "conf"),
    "left": ("left", "x_min", "xmin", "x1"),
    "top": ("top", "y_min", "ymin", "y1"),
    "right": ("right", "x_max", "xmax", "x2"),
    "bottom": ("bottom", "y_max", "ymax", "y2"),
    "x": ("x", "x_center", "cx", "u_px"),
    "y": ("y", "y_center", "cy", "v_px"),
    "width": ("width", "w"),
    "height": ("height", "h"),
}
CLOCKS = ("time", "frame", "name")
KINDS: Mapping[str, tuple[str, ...]] = {
    "ltrb": ("left", "top", "right", "bottom"),
    "ltwh": ("left", "top", "width", "height"),
    "xywh": ("x", "y", "width", "height"),
    "point": ("x", "y"),
}
CORNERS = tuple(f"{axis}{corner}" for corner in range(1, 5) for axis in "xy")
ANGLES = ("angle", "rotation", "theta")
EXAMPLE = "--columns frame=frame,x=u_px,y=v_px,class=label"


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


def name_columns(path: Path, table: pd.DataFrame, columns: Mapping[str, str]) -> RawBoxes:
    """Name the columns of a table by what they hold."""
    table = table.reset_index(drop=True)
    found = _find_columns(path, table, columns)
    form = next((form for form, keys in KINDS.items() if set(keys) <= found.keys()), "")
    clock = next((key for key in CLOCKS if key in found), "")
    if not clock or not form:
        lacking = [] if clock else ["frame, time (s) or image"]
        lacking += [] if form else ["x and y, or left, top, right, bottom"]
        raise GeoaimError(
            f"{path} has the columns {', '.join(map(str, table.columns[:20]))}; "
            f"{' and '.join(lacking)} is needed: say which hold what, such as {EXAMPLE}; {PAGE}"
        )
    rows = pd.DataFrame(index=table.index)
    rows[clock] = (
        table[found[clock]].map(lambda value: Path(str(value)).stem)
        if clock == "name"
        else _to_numbers(path, table[found[clock]], found[clock])
    )
    rows["score"] = _to_numbers(path, table[found["score"]], "") if "score" in found else np.nan
    rows["class"] = table[found["class"]].map(_to_name) if "class" in found else ""
    remarks: tuple[str, ...] = ()
    by_lower = {str(name).lower(): name for name in table.columns}
    turned = set(CORNERS) <= by_lower.keys()
    named = [by_lower[key] for key in CORNERS] if turned else [found[k] for k in KINDS[form]]
    numbers = np.column_stack([_to_numbers(path, table[name], name) for name in named])
    angles = [by_lower[key] for key in ANGLES if key in by_lower and table[by_lower[key]].any()]
    if angles and not turned:
        text = f"its {angles[0]} is not read: boxes count as upright; {' '.join(CORNERS)} turn them"
        remarks = (text,)
    if form == "point":
        numbers, form = np.column_stack([numbers, np.zeros_like(numbers)]), "xywh"
    return RawBoxes(
        rows,
        numbers,
        ("xywh", "ltwh") if form == "xywh" and numbers[:, 2:].any() else (form,),
        # x may be the middle of a box, or its corner
        is_named=form != "xywh" or found["x"].lower() != "x" or "x" in columns,
        shares=None,
        usual_class=None,
        listed=tuple(dict.fromkeys(rows["name"])) if clock == "name" else (),
        remarks=remarks,
    )


def _to_name(value: object) -> str:
    """Name a class; whole numbers without a decimal point, nothing as ""."""
    if value is None or value != value:
        return ""
    return f"{value:.0f}" if isinstance(value, float) and value % 1 == 0 else str(value)


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
        free = [by_lower[n] for n in names if n in by_lower and by_lower[n] not in found.values()]
        if key not in found and free and not (key in CLOCKS and set(CLOCKS) & columns.keys()):
            found[key] = free[0]
    return found


def _to_numbers(path: Path, values: "pd.Series[float]", name: str) -> "pd.Series[float]":
    """Make numbers of a column; values may be missing in one without a name, that of scores."""
    numbers = pd.to_numeric(values, errors="coerce").astype(np.float64)
    wrong = ~np.isfinite(numbers) & (values.notna() | (name != ""))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise GeoaimError(
            f"{path}: {name or 'score'} is '{str(values.iloc[row])[:40]}' in row {row + 1}; "
            "a number is needed"
        )
    return numbers
