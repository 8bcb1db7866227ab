"""Files of detections: YOLO, MOT, COCO and tables; arrays hold what else there is."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.base.limits import open_text, refuse_damaged
from geoaim.mapping.video.detection_checks import MAX_SHARE, PAGE, RawBoxes
from geoaim.mapping.video.detection_columns import name_columns

FORMATS = ("YOLO", "MOT", "COCO", "table")
YOLO_FIELDS = {5: 4, 6: 4, 7: 4, 9: 8, 10: 8, 11: 8}  # numbers of a box by fields of its row


def read_raw_boxes(source: Path | pd.DataFrame, columns: Mapping[str, str] | None) -> RawBoxes:
    """Read a folder, a file or a table of detections."""
    if isinstance(source, pd.DataFrame):
        return _check(name_columns(Path("the table"), source, columns or {}))
    if not source.exists():
        raise FileNotFoundError(f"{source}: no such file or folder")
    if source.is_dir():
        return _check(_read_yolo(source))
    if source.suffix.lower() == ".xml":
        raise GeoaimError(f"{source}: XML is not read; export CVAT's boxes as YOLO, MOT or COCO")
    with refuse_damaged(source, GeoaimError, "a table of detections"):
        if source.suffix.lower() == ".json":
            return _check(_read_coco(source))
        return _check(_read_text(source, columns or {}))


def _check(raw: RawBoxes) -> RawBoxes:
    """Check the numbers of all formats."""
    table = raw.rows
    clocks = [name for name in ("frame", "time") if name in table]
    table[["score", *clocks]] = table[["score", *clocks]].astype(float)
    if np.isinf(table["score"]).any():
        raise ValueError("a score is infinite")
    for name in clocks:
        if not (table[name].abs() < 1e19).all():  # nanoseconds since 1970 are less
            raise ValueError(f"a {name} is missing or is not below 1e+19")
    if "frame" in table and (table["frame"] < 0).any():
        raise ValueError(f"frame {table['frame'].min():g} is negative; frames count from 0 or 1")
    return raw


def _read_yolo(folder: Path) -> RawBoxes:
    """Read rows `class x y width height` or `class x1 y1 ... x4 y4`, then confidence and id."""
    found: list[tuple[str, list[float]]] = []
    names: list[str] = []
    listed: list[str] = []
    for file in sorted(folder.glob("*.txt")):
        with refuse_damaged(file, GeoaimError, "a text file of boxes"):
            text = file.read_text("utf-8-sig")
            if file.name == "classes.txt":  # a name in each line
                names = [line.strip() for line in text.splitlines() if line.strip()]
            else:
                listed.append(file.stem)
                found += [(file.stem, row) for row in _parse_yolo(text)]
    if not listed:
        raise GeoaimError(
            f"{folder} holds no .txt files; a YOLO file for each frame is needed, or the path of "
            "one file for all frames"
        )
    widths = {YOLO_FIELDS[len(row)] for _, row in found} or {4}
    if len(widths) > 1:
        raise GeoaimError(f"{folder} mixes upright and oriented boxes; give one kind")
    [width] = widths
    # of a confidence and an id, which may follow, an id alone is whole, and one exceeds 1
    scores = np.array([[*row[1 + width :], np.nan][0] for _, row in found])
    if (scores > 1).any() and (scores[scores == scores] % 1 == 0).all():
        scores = np.full(len(scores), np.nan)
    rows = {
        "name": np.array([stem for stem, _ in found], object),
        "class": [f"{row[0]:g}" for _, row in found],
        "score": scores,
    }
    return RawBoxes(
        pd.DataFrame(rows),
        np.array([row[1 : 1 + width] for _, row in found], float).reshape(-1, width),
        ("xywh", "ltwh", "ltrb"),
        shares=True,
        class_names=names,
        listed=tuple(listed),
    )


def _parse_yolo(text: str) -> list[list[float]]:
    try:
        fields = [line.split() for line in text.splitlines() if line.strip()]
        if not all(len(row) in YOLO_FIELDS for row in fields):
            raise ValueError("5 or 9 fields are needed, a confidence and an id may follow")
        rows = [[float(value) for value in row] for row in fields]
        if any(len(row) in (7, 11) and row[-1] % 1 for row in rows):
            raise ValueError("its last field is no id, a whole number: are these polygons?")
    except ValueError as error:
        raise GeoaimError(f"a row is not `class x y width height`: {error}") from error
    boxes = [abs(value) for row in rows for value in row[1 : 1 + YOLO_FIELDS[len(row)]]]
    if not max(boxes, default=0.0) <= MAX_SHARE:
        raise GeoaimError(f"values reach {max(boxes)!r}; shares of the size are needed")
    return rows


def _read_text(path: Path, columns: Mapping[str, str]) -> RawBoxes:
    """Read text with a row for each box, with a header or without."""
    with open_text(path, GeoaimError) as file:
        lines = [line for line in (file.readline() for _ in range(5)) if line.strip()]
    head = next((line for line in lines if not line.startswith("#")), "")
    separator = next((sign for sign in (";", "\t", ",") if sign in head), r"\s+")
    decimal = "," if separator == ";" and "," in "".join(lines) else "."
    words = head.lower().replace("nan", "").replace("inf", "")
    is_table = any(sign.isalpha() and sign != "e" for sign in words)
    with open_text(path, GeoaimError) as file:
        table = pd.read_csv(
            file, header=0 if is_table else None, sep=separator, decimal=decimal, comment="#"
        )
    if is_table:
        table.columns = table.columns.str.strip()
        return name_columns(path, table, columns)
    if 6 <= table.shape[1] <= 10:
        return _read_mot(path, table.to_numpy(np.float64))
    raise GeoaimError(
        f"{path} has {table.shape[1]} columns and no header; MOT has 6 to 10, and a table a header "
        f"such as frame,left,top,width,height; {PAGE}"
    )


def _read_mot(path: Path, values: Float[Array, "m c"]) -> RawBoxes:
    """Read `frame,id,left,top,width,height`, then confidence and class."""
    if (values[:, :2] % 1).any():
        raise GeoaimError(
            f"{path} has {values.shape[1]} columns, of which the first two are not whole numbers "
            "of frames and ids as in MOT; give its columns a header, such as "
            "frame,left,top,right,bottom,score"
        )
    tail = np.column_stack([values[:, 6:], np.full((len(values), 2), -1.0)])
    # the last three of ten are coordinates on the ground, all -1, 0 or 1 where there are none
    is_class = values.shape[1] < 10 or (tail[:, 1:2] != tail[:, 1:4]).any()
    kinds = tail[:, 1] if is_class else np.full(len(values), -1.0)
    rows = {
        "frame": values[:, 0],
        "score": tail[:, 0],
        "class": ["" if not kind >= 0 else f"{kind:g}" for kind in kinds],
    }
    box = values[:, 2:6]
    return RawBoxes(pd.DataFrame(rows), box, ("ltwh", "ltrb"), usual_frame=1, usual_class=1)


def _read_coco(path: Path) -> RawBoxes:
    """Read COCO's annotations or its list of results, whose image_id numbers or names frames."""
    data = json.loads(path.read_text("utf-8-sig"))
    found = data.get("annotations") if isinstance(data, dict) else data
    if not found:
        raise GeoaimError(f"{path} has no annotations")
    if not all(isinstance(entry, dict) and "bbox" in entry for entry in found):
        raise GeoaimError(
            f"{path} is not COCO: an entry has no bbox; read other JSON by "
            f"read_detections(pandas.read_json({path.name!r})), as a table with a header; {PAGE}"
        )
    if any(entry.get("attributes", {}).get("rotation", 0) for entry in found):
        raise GeoaimError(
            f"{path} has boxes with a rotation, which COCO's boxes do not hold; export them as "
            "oriented boxes of YOLO"
        )
    data = data if isinstance(data, dict) else {}
    names = {entry["id"]: entry["name"] for entry in data.get("categories", [])}
    kinds = [entry.get("category_id") for entry in found]
    rows: dict[str, Any] = {
        "score": [entry.get("score", np.nan) for entry in found],
        "class": [str(names.get(kind, "" if names or kind is None else kind)) for kind in kinds],
    }
    images = [entry["image_id"] for entry in found]
    listed = list(map(str, images))
    size: Any = ()
    if data:
        stems = {image["id"]: Path(image["file_name"]).stem for image in data["images"]}
        rows["name"], listed = [stems[image] for image in images], list(stems.values())
        sizes = {(image.get("width"), image.get("height")) for image in data["images"]}
        if len(sizes) > 1:
            raise GeoaimError(f"{path} has images of several sizes; frames of one size are needed")
        size = next(iter(sizes), size)
    elif all(map(str.isdecimal, listed)):
        rows["frame"] = [float(image) for image in images]
    else:
        rows["name"] = listed
    return RawBoxes(
        pd.DataFrame(rows),
        np.array([entry["bbox"] for entry in found], np.float64),
        ("ltwh", "ltrb"),
        size=size if size and all(size) else None,
        usual_class=1,
        listed=tuple(dict.fromkeys(listed)),
    )
