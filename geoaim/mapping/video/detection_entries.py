"""Boxes of one frame as detectors give them in Python: arrays, tables and results."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.mapping.video.detection_checks import RawBoxes
from geoaim.mapping.video.detection_columns import name_columns, to_table

ROWS = (
    "rows are left, top, right, bottom, after which may follow a score or an id (5 columns), score "
    "and class (6), or id, score and class (7)"
)
# what may follow the four numbers; trackers add the number of the detection
TAILS = (
    *((), ("score",), ("id",), ("score", "class"), ("id", "score", "class")),
    ("id", "score", "class", "number"),
)


def convert_entry(value: Any) -> RawBoxes:
    """Convert the boxes of a frame, by their attributes alone."""
    is_records = isinstance(value, list) and len(value) > 0 and isinstance(value[0], dict)
    if hasattr(value, "columns") or is_records:
        table = to_table(value)
        if not len(table):
            return make_raw(np.empty((0, 4)))
        return name_columns(Path("the table"), table, {}, has_clock=False)
    if hasattr(value, "get_corners"):
        corners = None if value.corners is None else np.reshape(value.corners, (-1, 8))
        return make_raw(
            value.boxes if corners is None else corners,
            value.get_scores(),
            [str(kind) for kind in value.get_types()],
            [str(name) for name in value.get_ids()],
        )
    names = getattr(value, "names", None) or {}
    for part in ("obb", "boxes"):
        if getattr(value, part, None) is not None:
            value = getattr(value, part)
            break
    found = getattr(value, "xyxy", None)
    if found is None or isinstance(found, list):  # YOLOv5 has a list of tensors
        return _convert_array(to_array(value if found is None else found[0]), names)
    return _convert_result(value, names)


def to_array(value: Any) -> Array:
    """Make an array of one, or of a tensor on any device."""
    return np.asarray(value.cpu() if hasattr(value, "cpu") else value)


def make_raw(
    numbers: Array,
    scores: Array | None = None,
    classes: list[str] | None = None,
    ids: list[str] | None = None,
    *,
    is_plain: bool = False,
) -> RawBoxes:
    """Make boxes whose numbers are certain, or those of a plain array."""
    count = len(numbers)
    rows = {
        "score": np.full(count, np.nan) if scores is None else np.asarray(scores, np.float64),
        "class": classes or [""] * count,
        "id": ids or [""] * count,
    }
    return RawBoxes(
        "arrays" if is_plain else "results of a detector",
        pd.DataFrame(rows),
        np.asarray(numbers, np.float64),
        ("ltrb", "ltwh", "xywh") if is_plain else ("ltrb",),
        shares=None if is_plain else False,
    )


def _convert_array(values: Array, names: Any) -> RawBoxes:
    values = np.asarray(values, np.float64)
    if values.ndim == 3 and values.shape[1:] == (4, 2):
        return make_raw(values.reshape(-1, 8))
    values = values[0] if values.ndim == 3 and len(values) == 1 else values
    if not values.size:
        return make_raw(np.empty((0, 4)))
    if values.ndim == 1:
        values = values[None]
    if values.ndim != 2 or values.shape[1] < 4:
        raise GeoaimError(f"boxes have the shape {values.shape}; {ROWS}")
    rest = values[:, 4:].T
    for keys in TAILS:
        if len(keys) == len(rest) and all(map(_may_hold, rest, keys)):
            found = dict(zip(keys, rest, strict=True))
            classes = _name(found["class"], names) if "class" in found else None
            ids = _name(found["id"]) if "id" in found else None
            return make_raw(values[:, :4], found.get("score"), classes, ids, is_plain=True)
    if len(rest) == 4:
        return make_raw(values)
    raise GeoaimError(
        f"arrays of boxes have {values.shape[1]} columns whose meaning is not plain; {ROWS}"
    )


def _may_hold(column: Float[Array, " m"], key: str) -> bool:
    """Whether a column may be scores, or whole numbers."""
    return bool(((column >= 0) & (column <= 1) if key == "score" else column % 1 == 0).all())


def _name(numbers: Shaped[Array, "m"], names: Any = None) -> list[str]:
    """Name whole numbers, by the names of classes where there are some."""
    return [str((names or {}).get(int(number), int(number))) for number in numbers]


def _convert_result(value: Any, names: Any) -> RawBoxes:
    """Convert what has `xyxy`: results of ultralytics, and detections of supervision."""
    boxes = to_array(value.xyxy).astype(np.float64).reshape(-1, 4)
    corners, data = getattr(value, "xyxyxyxy", None), getattr(value, "data", None)
    numbers = _get_first(value, "cls", "class_id")
    classes = None if numbers is None else _name(numbers, names)
    if isinstance(data, dict):
        classes = list(map(str, data["class_name"])) if "class_name" in data else classes
        corners = data.get("xyxyxyxy", corners)
    if corners is not None:
        boxes = to_array(corners).astype(np.float64).reshape(-1, 8)
    ids = _get_first(value, "id", "tracker_id")
    scores = _get_first(value, "conf", "confidence")
    return make_raw(boxes, scores, classes, None if ids is None else _name(ids))


def _get_first(value: Any, *names: str) -> Array | None:
    found = [getattr(value, name) for name in names if getattr(value, name, None) is not None]
    return to_array(found[0]).reshape(-1) if found else None
