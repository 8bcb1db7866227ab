"""Columns of tables of detections that any program wrote: which holds what."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoaim.base.errors import GeoaimError
from geoaim.mapping.video.box_tables import BOX
from geoaim.mapping.video.detection_checks import RawBoxes

# what a column holds: names that it has in common tables, in lower case
KNOWN_NAMES: Mapping[str, tuple[str, ...]] = {
    "time": (
        *("time", "time_s", "timestamp", "t", "seconds", "datetime"),
        *("time_ms", "timestamp_ms", "milliseconds", "time_us", "timestamp_us", "timestamp_ns"),
    ),
    "frame": ("frame", "frame_id", "frame_index", "frame_number", "image_id", "frame_no"),
    "name": ("image", "image_name", "filename", "file_name", "file"),
    "id": ("id", "track", "track_id", "tracker_id", "trackid", "vehicle_id", "object_id"),
    "class": ("class_name", "class", "type", "label", "category", "name", "class_id", "cls"),
    "score": ("score", "confidence", "conf"),
    "left": ("left", "x_min", "xmin", "x1", "bb_left", "bbox_left"),
    "top": ("top", "y_min", "ymin", "y1", "bb_top", "bbox_top"),
    "right": ("right", "x_max", "xmax", "x2", "bb_right", "bbox_right"),
    "bottom": ("bottom", "y_max", "ymax", "y2", "bb_bottom", "bbox_bottom"),
    "x": ("x_c", "cx", "xc", "u", "u_px", "x_center", "xcenter", "center_x", "x", "x_px"),
    "y": ("y_c", "cy", "yc", "v", "v_px", "y_center", "ycenter", "center_y", "y", "y_px"),
    "width": ("width", "w", "bb_width", "bbox_width"),
    "height": ("height", "h", "bb_height", "bbox_height"),
}
NUMBERS = ("score", *BOX, "x", "y", "width", "height")
CLOCKS = ("time", "frame", "name")
MAX_TIME_S = 1e8  # a greater time is one of day, since 1970
ANGLES = ("angle", "angle_deg", "angle_rad", "rotation", "theta")
UNITS = {"ms": "ms", "milliseconds": "ms", "us": "µs", "ns": "ns"}  # by the end of a name
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


def to_table(value: Any) -> pd.DataFrame:
    """Make a table of pandas from one of pandas or polars, or from a list of dictionaries."""
    if isinstance(value, pd.DataFrame):
        return value
    records = value.to_dicts() if hasattr(value, "to_dicts") else list(value)
    table = pd.json_normalize(records)
    table.columns = [str(name).split(".")[-1] for name in table.columns]
    return table


def name_columns(
    path: Path, table: pd.DataFrame, columns: Mapping[str, str], *, has_clock: bool = True
) -> RawBoxes:
    """Name the columns of a table by what they hold."""
    found = _find_columns(path, table, columns)
    values = {key: table[name].reset_index(drop=True) for key, name in found.items()}
    for key in NUMBERS:
        if key in values:
            values[key] = _to_numbers(path, values[key], found[key])
    kinds = {
        "ltrb": BOX,
        "ltwh": ("left", "top", "width", "height"),
        "xywh": ("x", "y", "width", "height"),
        "point": ("x", "y"),
    }
    form = next((form for form, keys in kinds.items() if set(keys) <= values.keys()), "")
    clock, unit = _find_clock(path, values, found) if has_clock else ("", "s")
    if (has_clock and not clock) or not form:
        lacking = [] if clock or not has_clock else ["frame or time"]
        lacking += [] if form else ["x and y, or left, top, right, bottom"]
        raise GeoaimError(
            f"{path} has the columns {', '.join(map(str, table.columns[:20]))}; "
            f"{' and '.join(lacking)} is needed: say which hold what, such as {EXAMPLE}"
        )
    numbers = np.column_stack([values[key] for key in kinds[form]])
    remarks = []
    corners = [f"{axis}{corner}" for corner in range(1, 5) for axis in "xy"]  # of ultralytics
    by_lower = {str(name).lower(): name for name in table.columns}
    if set(corners) <= by_lower.keys():
        numbers = table[[by_lower[name] for name in corners]].to_numpy(np.float64)
    elif angles := [name for key, name in by_lower.items() if key in ANGLES and table[name].any()]:
        remarks.append(
            f"its {angles[0]} is not read: boxes count as upright; {' '.join(corners)} turn them"
        )
    if form == "point":
        numbers, form = np.column_stack([numbers, np.zeros_like(numbers)]), "xywh"
    # x may be the middle of a box, or its corner
    is_named = form != "xywh" or found["x"].lower() not in ("x", "x_px") or "x" in columns
    is_dated = clock == "time" and not values["time"].equals(
        table[found["time"]].reset_index(drop=True)
    )
    if is_dated:
        remarks.append("its times are taken to count from its first box")
    rows: dict[str, Any] = {clock: values[clock]} if clock else {}
    rows["score"] = values.get("score", np.full(len(numbers), np.nan))
    for key in ("id", "class"):
        rows[key] = [_to_name(value) for value in values.get(key, [""] * len(numbers))]
    return RawBoxes(
        "table",
        pd.DataFrame(rows),
        numbers,
        ("xywh", "ltwh") if form == "xywh" and numbers[:, 2:].any() else (form,),
        is_named=is_named,
        shares=None,
        usual_class=None,
        time_unit=unit,
        listed=tuple(dict.fromkeys(rows["name"])) if clock == "name" else (),
        remarks=tuple(remarks),
    )


def _to_name(value: object) -> str:
    """Name an id or class; whole numbers without a decimal point, nothing as ""."""
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
        is_clock = key in CLOCKS and set(CLOCKS) & columns.keys()
        known = [by_lower[name] for name in names if name in by_lower]
        if key == "class":  # a name beside a number
            known.sort(key=lambda name: pd.api.types.is_numeric_dtype(table[name]))
        free = [name for name in known if name not in found.values()]
        if key not in found and free and not is_clock:
            found[key] = free[0]
    return found


def _find_clock(
    path: Path, values: "dict[str, pd.Series[float]]", found: Mapping[str, str]
) -> tuple[str, str]:
    """Find the column that tells frames, make it numbers, and find the unit of times."""
    if "time" in values:
        name = found["time"].lower()
        unit = next((u for end, u in UNITS.items() if name.endswith(end)), "s")
        if pd.api.types.is_numeric_dtype(values["time"]):
            start = float(values["time"].min())
            if start > MAX_TIME_S:
                values["time"] = values["time"] - start
            return "time", unit
        if "frame" not in values and "name" not in values:
            try:
                stamps = pd.to_datetime(values["time"], utc=True)
            except (ValueError, TypeError):
                _to_numbers(path, values["time"], found["time"])
                raise
            values["time"] = (stamps - stamps.min()).dt.total_seconds()
            return "time", "s"
    if "frame" in values:
        if values["frame"].map(lambda value: isinstance(value, str)).all():
            numbers = pd.to_numeric(values["frame"], errors="coerce")
            if numbers.isna().all():
                values["name"] = values["frame"].map(lambda value: Path(value).stem)
                return "name", "s"
        values["frame"] = _to_numbers(path, values["frame"], found["frame"])
        return "frame", "s"
    if "name" in values:
        values["name"] = values["name"].map(lambda value: Path(str(value)).stem)
        return "name", "s"
    return "", "s"


def _to_numbers(path: Path, values: "pd.Series[float]", name: str) -> "pd.Series[float]":
    numbers = pd.to_numeric(values, errors="coerce").astype(np.float64)
    wrong = ~np.isfinite(numbers) & (values.notna() | (name not in ("score", "confidence", "conf")))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise GeoaimError(
            f"{path}: {name} is '{str(values.iloc[row])[:40]}' in row {row + 1}; a number is needed"
        )
    return numbers
