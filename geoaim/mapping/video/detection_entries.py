"""Boxes of one frame as detectors give them in Python: arrays, and results."""

from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.mapping.video.detection_checks import PAGE, RawBoxes

ROWS = (
    "rows are left, top, right, bottom, after which may follow a score, and a class; corners of "
    f"turned boxes have the shape (N, 4, 2); {PAGE}"
)


def convert_entry(value: Any) -> RawBoxes:
    """Convert the boxes of a frame, by their attributes alone."""
    if hasattr(value, "get_corners"):
        numbers = value.boxes if value.corners is None else np.reshape(value.corners, (-1, 8))
        return _make_raw(numbers, value.get_scores(), list(map(str, value.get_types())))
    names = getattr(value, "names", None) or {}
    for part in ("obb", "boxes"):  # of ultralytics
        if getattr(value, part, None) is not None:
            value = getattr(value, part)
            break
    if hasattr(value, "xyxy"):
        return _convert_result(value, names)
    values = np.asarray(_to_array(value), np.float64)
    if values.ndim == 3 and values.shape[1:] == (4, 2):
        return _make_raw(values.reshape(-1, 8))
    if not values.size:
        return _make_raw(np.empty((0, 4)))
    if values.ndim != 2 or values.shape[1] not in (4, 5, 6):
        raise GeoaimError(f"boxes have the shape {values.shape}; {ROWS}")
    if (values[:, 5:] % 1).any():
        raise GeoaimError(f"the sixth column of boxes is no class, a whole number; {ROWS}")
    raw = _make_raw(
        values[:, :4],
        values[:, 4] if values.shape[1] > 4 else None,
        _name(values[:, 5], names) if values.shape[1] > 5 else None,
    )
    return RawBoxes(raw.rows, raw.numbers, ("ltrb", "ltwh", "xywh"), shares=None)


def _to_array(value: Any) -> Array:
    """Make an array of one, or of a tensor on any device."""
    return np.asarray(value.cpu() if hasattr(value, "cpu") else value)


def _make_raw(
    numbers: Array, scores: Array | None = None, classes: list[str] | None = None
) -> RawBoxes:
    """Make boxes whose numbers are certain."""
    rows = pd.DataFrame({"class": classes or [""] * len(numbers)})
    return RawBoxes(
        rows.assign(score=np.nan if scores is None else np.asarray(scores, np.float64)),
        np.asarray(numbers, np.float64),
    )


def _name(numbers: Shaped[Array, "m"], names: Any) -> list[str]:
    """Name whole numbers, by the names of classes where there are some."""
    return [str(names.get(int(number), int(number))) for number in numbers]


def _convert_result(value: Any, names: Any) -> RawBoxes:
    """Convert what has `xyxy`: results of ultralytics, and detections of supervision."""
    boxes: Float[Array, "m n"] = _to_array(value.xyxy).astype(np.float64)
    if boxes.ndim != 2 or boxes.shape[1] != 4:
        raise GeoaimError(f"a result has xyxy of the shape {boxes.shape}; (N, 4) is needed; {PAGE}")
    corners, data = getattr(value, "xyxyxyxy", None), getattr(value, "data", None)
    numbers = _get_first(value, "cls", "class_id")
    classes = None if numbers is None else _name(numbers, names)
    if isinstance(data, dict):
        classes = list(map(str, data["class_name"])) if "class_name" in data else classes
        corners = data.get("xyxyxyxy", corners)
    if corners is not None:
        boxes = _to_array(corners).astype(np.float64).reshape(-1, 8)
    return _make_raw(boxes, _get_first(value, "conf", "confidence"), classes)


def _get_first(value: Any, *names: str) -> Array | None:
    found = [getattr(value, name) for name in names if getattr(value, name, None) is not None]
    return _to_array(found[0]).reshape(-1) if found else None
