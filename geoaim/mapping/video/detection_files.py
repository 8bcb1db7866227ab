"""Files of detections: a registry of formats, and what each says of its boxes."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.csv_rows import parse_number
from geoaim.base.errors import GeoaimError
from geoaim.base.limits import open_text, refuse_damaged
from geoaim.mapping.video.detection_checks import MAX_SHARE, RawBoxes
from geoaim.mapping.video.detection_columns import name_columns
from geoaim.tracks.formats.geotrax import BOX as GEOTRAX_BOX
from geoaim.tracks.formats.geotrax import PIXEL_COLUMNS, VEHICLE_CLASSES

VISDRONE_CLASSES = (
    *("ignored", "pedestrian", "pedestrian", "cyclist", "car", "van", "truck"),
    *("tricycle", "tricycle", "bus", "motorcycle", "other"),
)
UAVDT_CLASSES = ("", "car", "truck", "bus")
YOLO_FIELDS = {5: False, 6: False, 7: False, 9: True, 10: True, 11: True}  # whether oriented
CLASS_NAMES = "classes.txt"  # a file with a class name in each line, beside the boxes
DOTA_FIELDS = (9, 10)
LETTERS_OF_NUMBERS = "eE"
MAX_FRAME = 1e19  # nanoseconds since 1970 are less
Kind = str  # "folder", "json", "xml", "numbers" or "table"


@dataclass(frozen=True, eq=False)
class Content:
    """The content of a file or folder, of which formats say whether it is theirs."""

    path: Path
    kind: Kind
    data: Any  # texts by file; what JSON holds; an XML element; an array of numbers; a table
    columns: Mapping[str, str]  # names of columns that the user gave
    class_names: tuple[str, ...] = ()  # of a `classes.txt`


@dataclass(frozen=True)
class DetectionFormat:
    """A format of detections, as `read_raw_boxes` needs it."""

    name: str
    kind: Kind
    matches: Callable[[Any], bool]  # whether data of the kind have this format
    read: Callable[[Content], RawBoxes]


def read_raw_boxes(source: Path | pd.DataFrame, columns: Mapping[str, str] | None) -> RawBoxes:
    """Read a folder, a file or a table of detections in a format of `FORMATS`."""
    if isinstance(source, pd.DataFrame):
        return _read_table(Content(Path("the table"), "table", source, columns or {}))
    if not source.exists():
        raise FileNotFoundError(f"{source}: no such file or folder")
    if source.is_dir():
        return _read_content(_load_folder(source))
    with refuse_damaged(source, GeoaimError, "a table of detections"):
        return _read_content(_load_file(source, columns or {}))


def _read_content(content: Content) -> RawBoxes:
    for known in FORMATS:
        if known.kind == content.kind and known.matches(content.data):
            return known.read(content)
    shape = (
        f" has {content.data.shape[1]} columns and no header;" if content.kind == "numbers" else ":"
    )
    names = ", ".join(known.name for known in FORMATS if known.kind == content.kind)
    raise GeoaimError(
        f"{content.path}{shape} its boxes are in no known format ({names}); a .csv with a header "
        "such as frame,left,top,width,height is read too"
    )


def _load_folder(folder: Path) -> Content:
    files = sorted(folder.glob("*.txt"))
    texts = {file: _read_text(file) for file in files if file.name != CLASS_NAMES}
    if not texts:
        raise GeoaimError(
            f"{folder} holds no .txt files; a YOLO file for each frame is needed, or the path of "
            "one file for all frames"
        )
    named = folder / CLASS_NAMES
    lines = _read_text(named).splitlines() if named.exists() else []
    names = tuple(line.strip() for line in lines if line.strip())
    return Content(folder, "folder", texts, {}, names)


def _read_text(file: Path) -> str:
    with refuse_damaged(file, GeoaimError, "a text file of boxes"):
        return file.read_text("utf-8-sig")


def _load_file(path: Path, columns: Mapping[str, str]) -> Content:
    suffix = path.suffix.lower()
    if suffix == ".json":
        return Content(path, "json", json.loads(path.read_text("utf-8-sig")), columns)
    if suffix == ".xml":
        text = path.read_text("utf-8-sig")
        if "<!ENTITY" in text:
            raise GeoaimError(f"{path} defines entities, which are not read")
        return Content(path, "xml", ElementTree.fromstring(text), columns)
    with open_text(path, GeoaimError) as file:
        lines = [line for line in (file.readline() for _ in range(5)) if line.strip()]
    head = next((line for line in lines if not line.startswith("#")), "")
    separator = next((sign for sign in (";", "\t", ",") if sign in head), r"\s+")
    decimal = "," if separator == ";" and "," in "".join(lines) else "."
    words = head.lower().replace("nan", "").replace("inf", "")
    is_table = any(sign.isalpha() and sign not in LETTERS_OF_NUMBERS for sign in words)
    with open_text(path, GeoaimError) as file:
        table = pd.read_csv(
            file, header=0 if is_table else None, sep=separator, decimal=decimal, comment="#"
        )
    if is_table:
        table.columns = table.columns.str.strip()
        return Content(path, "table", table, columns)
    return Content(path, "numbers", table.to_numpy(np.float64), columns)


def _get_first_row(texts: Mapping[Path, str]) -> str:
    lines = (line for text in texts.values() for line in text.splitlines())
    return next((line for line in lines if line.strip() and ":" not in line), "")


def _is_dota(texts: Mapping[Path, str]) -> bool:
    fields = _get_first_row(texts).split()
    return len(fields) in DOTA_FIELDS and any(map(str.isalpha, fields[8]))


def _parse_files(content: Content, parse: Callable[[str], list[Any]]) -> list[tuple[str, Any]]:
    """Parse the text of each file; the stem of the file and a row for each of its boxes."""
    rows = []
    for file, text in content.data.items():
        with refuse_damaged(file, GeoaimError, "a text file of boxes"):
            rows += [(file.stem, row) for row in parse(text)]
    return rows


def _read_dota(content: Content) -> RawBoxes:
    """Read rows x1 y1 ... x4 y4 category difficult, in pixels, under two lines of a header."""
    found = _parse_files(content, _parse_dota)
    rows = [{"name": stem, "class": kind} for stem, (_, kind) in found]
    numbers = np.array([corners for _, (corners, _) in found]).reshape(-1, 8)
    return RawBoxes("DOTA", _complete(rows), numbers, listed=_list_stems(content.data))


def _parse_dota(text: str) -> list[tuple[list[float], str]]:
    lines = [line.split() for line in text.splitlines()]
    boxes = [words for words in lines if len(words) in DOTA_FIELDS and ":" not in words[0]]
    return [([float(word) for word in words[:8]], words[8].replace("-", " ")) for words in boxes]


def _list_stems(texts: Mapping[Path, str]) -> tuple[str, ...]:
    return tuple(file.stem for file in texts)


def _read_yolo(content: Content) -> RawBoxes:
    """Read rows `class x y width height` or `class x1 y1 ... x4 y4`, then confidence and id."""
    rows: list[dict[str, Any]] = []
    numbers: list[list[float]] = []
    for stem, values in _parse_files(content, _parse_yolo):
        count = 8 if YOLO_FIELDS[len(values)] else 4
        numbers.append(values[1 : 1 + count])
        rest = values[1 + count :]
        row = {"name": stem, "class": f"{values[0]:g}", "extra": rest[0] if rest else np.nan}
        rows.append(row | {"id": f"{rest[1]:.0f}" if len(rest) > 1 else ""})
    if len({len(values) for values in numbers}) > 1:
        raise GeoaimError(f"{content.path} mixes upright and oriented boxes; give one kind")
    table = pd.DataFrame(rows, columns=["name", "class", "extra", "id"])
    width = len(numbers[0]) if numbers else 4
    return RawBoxes(
        "YOLO" if width == 4 else "YOLO, oriented boxes",
        _complete(_separate_ids(table)),
        np.array(numbers, float).reshape(-1, width),
        ("xywh", "ltwh", "ltrb"),
        shares=True,
        class_names=content.class_names,
        listed=_list_stems(content.data),
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
    largest = max((abs(v) for row in rows for v in row[1 : 9 if len(row) > 8 else 5]), default=0.0)
    if not largest <= MAX_SHARE:
        raise GeoaimError(f"values reach {largest!r}; shares of the size are needed")
    return rows


def _separate_ids(rows: pd.DataFrame) -> pd.DataFrame:
    """Take the only further field of YOLO's rows for ids where it is whole and exceeds 1."""
    extra, rows = rows["extra"].astype(float), rows.drop(columns="extra")
    is_id = (rows["id"] == "").all() and bool((extra > 1).any())
    if is_id and bool((extra.dropna() % 1 == 0).all()):
        return rows.assign(id=["" if np.isnan(value) else f"{value:.0f}" for value in extra])
    return rows.assign(score=extra)


def _read_visdrone_images(content: Content) -> RawBoxes:
    """Read rows left, top, width, height, score, class, truncation, occlusion of each image."""
    found = _parse_files(content, _parse_visdrone)
    values = np.array([row for _, row in found]).reshape(-1, 8)
    names = [stem for stem, _ in found]
    rows = pd.DataFrame({"name": names, "score": values[:, 4], "class": _to_names(values[:, 5])})
    return RawBoxes(
        "VisDrone, images",
        _complete(rows),
        values[:, :4],
        ("ltwh",),
        class_names=VISDRONE_CLASSES,
        listed=_list_stems(content.data),
    )


def _parse_visdrone(text: str) -> list[list[float]]:
    lines = [line.strip().rstrip(",") for line in text.splitlines() if line.strip()]
    try:
        rows = [[float(value) for value in line.split(",")] for line in lines]
        if any(len(row) != 8 for row in rows):
            raise ValueError("8 are needed")
    except ValueError as error:
        raise GeoaimError(f"a row has not the 8 numbers of VisDrone: {error}") from error
    return rows


def _to_names(numbers: Float[Array, "m"]) -> list[str]:
    """Names of whole numbers; "" for negative ones."""
    return ["" if value < 0 or np.isnan(value) else f"{value:g}" for value in numbers]


def _complete(rows: Any) -> pd.DataFrame:
    """Complete columns that a format lacks."""
    table = pd.DataFrame(rows).reset_index(drop=True)
    defaults: dict[str, Any] = {"name": "", "score": np.nan, "class": "", "id": ""}
    for name, value in defaults.items():
        if name not in table and (name != "name" or not {"frame", "time"} & set(table)):
            table[name] = value
    numbers = [name for name in ("score", "frame", "time") if name in table]
    table[numbers] = table[numbers].astype(float)
    if np.isinf(table["score"]).any():
        raise ValueError("a score is infinite")
    for name in numbers[1:]:
        if not (table[name].abs() < MAX_FRAME).all():
            raise ValueError(f"a {name} is missing or is not below {MAX_FRAME:g}")
    if "frame" in table and (table["frame"] < 0).any():
        raise ValueError(f"frame {table['frame'].min():g} is negative; frames count from 0 or 1")
    return table


def _is_geotrax(values: Float[Array, "m c"]) -> bool:
    return values.shape[1] in (len(PIXEL_COLUMNS), len(PIXEL_COLUMNS) + 1)


def _read_geotrax(content: Content) -> RawBoxes:
    column = {name: content.data[:, number] for number, name in enumerate(PIXEL_COLUMNS)}
    rows = {
        "frame": column["frame"],
        "id": _to_names(column["track"]),
        "class": _to_names(column["class"]),
        "score": column["confidence"],
    }
    names = [VEHICLE_CLASSES.get(number, "") for number in range(max(VEHICLE_CLASSES) + 1)]
    box = np.column_stack([column[name] for name in GEOTRAX_BOX])
    return RawBoxes(
        "geo-trax", _complete(rows), box, ("xywh",), usual_frame=0, class_names=tuple(names)
    )


def _is_visdrone_video(values: Float[Array, "m c"]) -> bool:
    """Ten columns whose last three are no tail of MOT's: the class is positive, and varies."""
    if values.shape[1] != 10:
        return False
    tail = values[:, 7:]
    return bool((tail[:, 0] >= 0).all() and (tail.min(axis=1) < tail.max(axis=1)).any())


def _is_uavdt(values: Float[Array, "m c"]) -> bool:
    """Nine columns: out of view (1 to 3), occlusion (1 to 4) and class (1 to 3)."""
    if values.shape[1] != 9:
        return False
    view, _, kind = values[:, 6:].T
    whole = bool((values[:, 6:] % 1 == 0).all() and (values[:, 6:] >= 1).all())
    return whole and bool(view.max() <= 3 and kind.max() <= 3 and max(view.max(), kind.max()) > 1)


def _read_mot(content: Content) -> RawBoxes:
    """Read `frame,id,left,top,width,height`, then confidence and class."""
    values = content.data
    count = values.shape[1]
    if not (values[:, :2] % 1 == 0).all():
        raise GeoaimError(
            f"{content.path} has {count} columns, of which the first two are not whole numbers of "
            "frames and ids as in MOT; give its columns a header, such as "
            "frame,left,top,right,bottom,score"
        )
    minus = np.full(len(values), -1.0)
    score = values[:, 6] if count > 6 else minus
    names: tuple[str, ...] = ()
    name, number = "MOT", values[:, 7] if count in (8, 9) else minus
    if _is_visdrone_video(values):
        name, number, names = "VisDrone, video", values[:, 7], VISDRONE_CLASSES
    elif _is_uavdt(values):
        name, number, names, score = "UAVDT", values[:, 8], UAVDT_CLASSES, minus
    rows = {"frame": values[:, 0], "id": _to_names(values[:, 1]), "class": _to_names(number)}
    return RawBoxes(
        name,
        _complete(rows | {"score": score}),
        values[:, 2:6],
        ("ltwh", "ltrb"),
        usual_frame=1,  # all of these count frames from 1
        class_names=names,
        usual_class=1,
    )


def _is_coco(data: Any) -> bool:
    return isinstance(data, dict) or not data or (isinstance(data[0], dict) and "bbox" in data[0])


def _read_coco(content: Content) -> RawBoxes:
    """Read COCO's annotations, or its list of results, whose image_id numbers or names frames."""
    path, data = content.path, content.data
    found = data if isinstance(data, list) else data["annotations"]
    if not found:
        raise GeoaimError(f"{path} has no annotations")
    if any(entry.get("attributes", {}).get("rotation", 0) for entry in found):
        raise GeoaimError(
            f"{path} has boxes with a rotation, which COCO's boxes do not hold; export them as "
            "oriented boxes of YOLO"
        )
    known = [] if isinstance(data, list) else data.get("categories", [])
    names = {entry["id"]: entry["name"] for entry in known}
    kinds = [entry.get("category_id") for entry in found]
    rows: dict[str, Any] = {
        "score": [entry.get("score", np.nan) for entry in found],
        "class": [str(names.get(kind, "" if known or kind is None else kind)) for kind in kinds],
        "id": [
            str(entry.get("track_id", entry.get("attributes", {}).get("track_id", "")))
            for entry in found
        ],
    }
    images = [entry["image_id"] for entry in found]
    listed, size = list(dict.fromkeys(map(str, images))), None
    if not isinstance(data, list):
        stems = {image["id"]: Path(image["file_name"]).stem for image in data["images"]}
        rows["name"], listed = [stems[image] for image in images], list(stems.values())
        sizes = {(image.get("width"), image.get("height")) for image in data["images"]}
        if len(sizes) > 1:
            raise GeoaimError(f"{path} has images of several sizes; frames of one size are needed")
        size = next(iter(sizes), None)
    elif all(str(image).isdecimal() for image in images):
        rows["frame"] = [float(image) for image in images]
    else:
        rows["name"] = [str(image) for image in images]
    box = np.array([entry["bbox"] for entry in found], np.float64)
    return RawBoxes(
        "COCO",
        _complete(rows),
        box,
        ("ltwh", "ltrb"),
        size=size if size and all(size) else None,
        usual_class=1,
        listed=tuple(dict.fromkeys(listed)),
    )


def _read_records(content: Content) -> RawBoxes:
    """Read a list of objects with a box each, as supervision's JSONSink writes them."""
    if not isinstance(content.data[0], dict):
        raise GeoaimError(f"{content.path} is a list of no objects; boxes are needed")
    table = pd.json_normalize(content.data)
    table.columns = [name.split(".")[-1] for name in table.columns]
    return _read_table(Content(content.path, "table", table, content.columns))


def _read_table(content: Content) -> RawBoxes:
    """Read a table with a header."""
    raw = name_columns(content.path, content.data, content.columns)
    return replace(raw, rows=_complete(raw.rows))


def _read_cvat(content: Content) -> RawBoxes:
    """Read CVAT's XML, of a video (tracks) or of images, with turned boxes too."""
    root = content.data
    rows: list[dict[str, Any]] = []
    corners: list[Array] = []
    for parent in [*root.iter("track"), *root.iter("image")]:
        for box in parent.iter("box"):
            if box.get("outside", "0") == "1":
                continue
            label = parent.get("label") or box.get("label", "")
            row: dict[str, Any] = {"class": label}
            if parent.tag == "track":
                row |= {
                    "frame": parse_number("frame", box.attrib["frame"]),
                    "id": parent.get("id", ""),
                }
            else:
                row |= {"name": Path(parent.attrib["name"]).stem}
            rows.append(row)
            left, top, right, bottom = (
                parse_number(name, box.attrib[name]) for name in ("xtl", "ytl", "xbr", "ybr")
            )
            angle = np.radians(parse_number("rotation", box.get("rotation", "0")))
            along = (right - left) / 2 * np.array([np.cos(angle), np.sin(angle)])
            across = (bottom - top) / 2 * np.array([-np.sin(angle), np.cos(angle)])
            middle = np.array([left + right, top + bottom]) / 2
            corners.append(
                middle + np.outer((-1, 1, 1, -1), along) + np.outer((-1, -1, 1, 1), across)
            )
    if not rows:
        raise GeoaimError(f"{content.path} has no boxes; export CVAT's boxes, not polygons")
    images = list(root.iter("image"))
    sizes = {(image.get("width"), image.get("height")) for image in images}
    sizes |= {
        (node.findtext("width"), node.findtext("height")) for node in root.iter("original_size")
    }
    given = [(int(w), int(h)) for w, h in sizes if w and h]
    points = np.array(corners).reshape(-1, 8)
    turned = any(float(box.get("rotation", "0")) for box in root.iter("box"))
    numbers = points if turned else points[:, [0, 1, 4, 5]]
    return RawBoxes(
        "CVAT",
        _complete(rows),
        numbers,
        ("ltrb",),
        size=given[0] if len(given) == 1 else None,
        usual_frame=0,
        listed=tuple(Path(image.attrib["name"]).stem for image in images),
    )


FORMATS: tuple[DetectionFormat, ...] = (
    DetectionFormat("DOTA", "folder", _is_dota, _read_dota),
    DetectionFormat(
        "VisDrone, images", "folder", lambda d: "," in _get_first_row(d), _read_visdrone_images
    ),
    DetectionFormat("YOLO", "folder", lambda d: True, _read_yolo),
    DetectionFormat("COCO", "json", _is_coco, _read_coco),
    DetectionFormat("supervision", "json", lambda d: isinstance(d, list), _read_records),
    DetectionFormat("CVAT", "xml", lambda d: d.tag == "annotations", _read_cvat),
    DetectionFormat("geo-trax", "numbers", _is_geotrax, _read_geotrax),
    DetectionFormat("VisDrone, video", "numbers", _is_visdrone_video, _read_mot),
    DetectionFormat("UAVDT", "numbers", _is_uavdt, _read_mot),
    DetectionFormat("MOT", "numbers", lambda d: 6 <= d.shape[1] <= 10, _read_mot),
    DetectionFormat("table", "table", lambda d: True, _read_table),
)
