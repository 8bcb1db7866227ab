"""Files of detections: YOLO, VisDrone, MOT, geo-trax, COCO, and tables with a header."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.base.limits import refuse_damaged
from geoaim.mapping.video.box_tables import (
    BOX,
    CORNERS,
    BoxTable,
    make_named_table,
    make_numbered_table,
    make_timed_table,
    strip_zeros,
)
from geoaim.mapping.video.detection_columns import name_columns
from geoaim.mapping.video.frame_numbers import number_names, refuse_other_names
from geoaim.mapping.video.video import Video
from geoaim.tracks.formats.geotrax import VEHICLE_CLASSES
from geoaim.tracks.formats.geotrax_pixels import BOX as GEOTRAX_BOX
from geoaim.tracks.formats.geotrax_pixels import PIXEL_COLUMNS

VISDRONE_CLASSES = (
    *("ignored", "pedestrian", "pedestrian", "cyclist", "car", "van", "truck"),
    *("tricycle", "tricycle", "bus", "motorcycle", "other"),
)
IGNORED = "ignored"  # regions that VisDrone does not label
YOLO_FIELDS = {5: False, 6: False, 7: False, 9: True, 10: True, 11: True}  # whether oriented
CLASS_NAMES = "classes.txt"  # a file with a class name in each line, beside the boxes
MAX_SHARE = 1.5  # boxes may end outside the image


def read_box_table(
    path: Path,
    *,
    columns: Mapping[str, str] | None = None,
    rate: float | None = None,
    classes: Sequence[str] = (),
    video: Video | None = None,
) -> BoxTable:
    """Read a folder or a file of detections.

    Args:
        path: the folder or file.
        columns: as in `read_detections`.
        rate: as there, frames per second.
        classes: names of class numbers.
        video: the video that the boxes are of, by which names and numbers are checked.

    Returns:
        The boxes of all frames.

    Raises:
        GeoaimError: it holds no detections in a known format.
        FileNotFoundError: there is no such file or folder.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file or folder")
    if path.is_dir():
        return _read_folder(path, classes, video)
    with refuse_damaged(path, GeoaimError, "a table of detections"):
        if path.suffix.lower() == ".json":
            return _read_coco(path, rate, video)
        with open(path, encoding="utf-8-sig", errors="replace") as file:
            head = file.readline()
        if any(character.isalpha() and character not in "eE" for character in head):
            return _read_table(path, columns, rate, classes, video)
        return _read_numbers(path, rate, classes, video)


def _read_folder(folder: Path, classes: Sequence[str], video: Video | None) -> BoxTable:
    files = sorted(folder.glob("*.txt"))
    texts = {file: _read_text(file) for file in files if file.name != CLASS_NAMES}
    if not texts:
        raise GeoaimError(
            f"{folder} holds no .txt files; a YOLO file for each frame is needed, or the path of "
            "one file for all frames"
        )
    named = folder / CLASS_NAMES
    if not classes and named.exists():
        classes = [line.strip() for line in _read_text(named).splitlines() if line.strip()]
    first = next((text for text in texts.values() if text.strip()), "")
    is_visdrone = "," in first.splitlines()[0] if first else False
    read = _read_visdrone_file if is_visdrone else _read_yolo_file
    tables = [read(file, text) for file, text in texts.items()]
    rows = pd.concat([table for table in tables if len(table)] or tables[:1], ignore_index=True)
    if not is_visdrone and len(rows):
        rows = _separate_ids(rows)
    rows["class"] = _name_classes(rows["class"], VISDRONE_CLASSES if is_visdrone else classes)
    if CORNERS[0] in rows and rows[list(CORNERS)].isna().to_numpy().any():
        raise GeoaimError(f"{folder} mixes upright and oriented boxes; give one kind")
    names = [file.stem for file in texts]
    numbers = _match_names(names, video, folder)
    kept = rows[rows["class"] != IGNORED]
    return make_named_table(kept, names, numbers, has_shares=not is_visdrone)


def _match_names(names: Sequence[str], video: Video | None, source: Path) -> dict[str, int] | None:
    """Number the names of frames of a video; refuse those of which none is that of a frame."""
    if video is not None and video.names is not None:
        images = {strip_zeros(Path(name).stem) for name in video.names}
        if not images & {strip_zeros(name) for name in names}:
            refuse_other_names(names, [Path(name).stem for name in video.names], video, source)
        return None
    numbers = number_names(names, video, source)
    if numbers is None and video is not None:
        refuse_other_names(names, (), video, source)
    return numbers


def _read_text(file: Path) -> str:
    with refuse_damaged(file, GeoaimError, "a text file of boxes"):
        return file.read_text("utf-8-sig")


def _read_yolo_file(file: Path, text: str) -> pd.DataFrame:
    """Read rows `class x y width height` or `class x1 y1 ... x4 y4`, then confidence and id."""
    try:
        rows = [line.split() for line in text.splitlines() if line.strip()]
        if not all(len(row) in YOLO_FIELDS for row in rows):
            raise ValueError("5 or 9 fields are needed, a confidence and an id may follow")
        numbers = [[float(value) for value in row] for row in rows]
        if any(len(row) in (7, 11) and row[-1] % 1 for row in numbers):
            raise ValueError("its last field is no id, a whole number: are these polygons?")
    except ValueError as error:
        raise GeoaimError(f"{file}: a row is not `class x y width height`: {error}") from error
    table = pd.DataFrame([_describe_yolo_row(row) for row in numbers])
    if not len(table):
        return pd.DataFrame(columns=[*BOX, "class", "extra", "id", "name"])
    shares = table[[name for name in (*BOX, *CORNERS) if name in table]].to_numpy()
    if not (np.abs(shares) <= MAX_SHARE).all():
        largest = np.abs(shares).max()
        raise GeoaimError(f"{file}: values reach {float(largest)!r}; shares of the size are needed")
    return table.assign(name=file.stem)


def _describe_yolo_row(row: list[float]) -> dict[str, Any]:
    box, rest = (row[1:9], row[9:]) if YOLO_FIELDS[len(row)] else (row[1:5], row[5:])
    described: dict[str, Any] = {"class": f"{row[0]:g}"}
    if len(box) == 8:
        described |= dict(zip(CORNERS, box, strict=True))
        ends = [min(box[::2]), min(box[1::2]), max(box[::2]), max(box[1::2])]
    else:
        x, y, width, height = box
        ends = [x - width / 2, y - height / 2, x + width / 2, y + height / 2]
    described |= dict(zip(BOX, ends, strict=True))
    described["extra"] = rest[0] if rest else np.nan
    described["id"] = f"{rest[1]:.0f}" if len(rest) > 1 else ""
    return described


def _separate_ids(rows: pd.DataFrame) -> pd.DataFrame:
    """Take the only further field of YOLO's rows for ids where it is whole and exceeds 1."""
    extra, rows = rows["extra"], rows.drop(columns="extra")
    is_id = (rows["id"] == "").all() and bool((extra > 1).any())
    if is_id and bool((extra.dropna() % 1 == 0).all()):
        return rows.assign(id=["" if np.isnan(value) else f"{value:.0f}" for value in extra])
    return rows.assign(score=extra)


def _read_visdrone_file(file: Path, text: str) -> pd.DataFrame:
    """Read rows left, top, width, height, score, class, truncation, occlusion of one image."""
    try:
        lines = [line.strip().rstrip(",") for line in text.splitlines() if line.strip()]
        values = np.array([[float(value) for value in line.split(",")] for line in lines])
        values = values.reshape(-1, 8)
    except ValueError as error:
        raise GeoaimError(f"{file}: a row has not the 8 numbers of VisDrone: {error}") from error
    table = _make_rows(values[:, :4], values[:, 4], values[:, 5])
    return table.assign(id="", name=file.stem)


def _make_rows(
    box: Float[Array, "m 4"], score: Float[Array, "m"], number: Float[Array, "m"]
) -> pd.DataFrame:
    """Make rows of left, top, width, height, score and class number."""
    ends = np.concatenate([box[:, :2], box[:, :2] + box[:, 2:]], axis=1)
    table = pd.DataFrame(ends, columns=list(BOX))
    return table.assign(score=score, **{"class": [f"{value:g}" for value in number]})


def _name_classes(numbers: "pd.Series[Any]", names: Sequence[str]) -> list[str]:
    """Name classes that are numbers, where there is a name; the others stay as they are."""
    known = {str(number): name for number, name in enumerate(names)}
    return [known.get(str(number), str(number)) for number in numbers]


def _read_numbers(
    path: Path, rate: float | None, classes: Sequence[str], video: Video | None
) -> BoxTable:
    """Read a file without a header: geo-trax (14 columns or 15), VisDrone or MOT (7 to 10)."""
    with open(path, encoding="utf-8-sig") as file:
        delimiter = "," if "," in file.readline() else r"\s+"
    table = pd.read_csv(path, header=None, sep=delimiter)
    values = table.to_numpy(np.float64)
    count = values.shape[1]
    if count in (len(PIXEL_COLUMNS), len(PIXEL_COLUMNS) + 1):
        return _make_geotrax(values, rate, video, path)
    if not 6 <= count <= 10:
        raise GeoaimError(
            f"{path} has {count} columns and no header; MOT and VisDrone have 6 to 10, geo-trax 14"
        )
    ones, missing = np.ones(len(values)), np.full(len(values), -1.0)
    score = values[:, 6] if count > 6 else ones
    is_visdrone = count == 10 and bool((values[:, 7:] >= 0).all())
    number = values[:, 7] if count > 7 and (is_visdrone or count == 9) else missing
    rows = _make_rows(values[:, 2:6], np.where((score < 0) | (score > 1), np.nan, score), number)
    rows["class"] = _name_classes(rows["class"], VISDRONE_CLASSES if is_visdrone else classes)
    ids = ["" if value < 0 else f"{value:.0f}" for value in values[:, 1]]
    rows = rows.assign(frame=values[:, 0], id=ids)
    # both formats count frames from 1
    return make_numbered_table(rows[rows["class"] != IGNORED], rate, video, path, 1)


def _make_geotrax(
    values: Float[Array, "m c"], rate: float | None, video: Video | None, path: Path
) -> BoxTable:
    column = {name: values[:, number] for number, name in enumerate(PIXEL_COLUMNS)}
    box = np.column_stack([column[name] for name in GEOTRAX_BOX])
    box[:, :2] -= box[:, 2:] / 2
    rows = _make_rows(box, column["confidence"], column["class"])
    names = [VEHICLE_CLASSES.get(number, "") for number in range(max(VEHICLE_CLASSES) + 1)]
    rows["class"] = _name_classes(rows["class"], names)
    ids = [f"{value:.0f}" for value in column["track"]]
    return make_numbered_table(rows.assign(frame=column["frame"], id=ids), rate, video, path, 0)


def _read_coco(path: Path, rate: float | None, video: Video | None) -> BoxTable:
    """Read COCO's annotations, or its list of results, whose image_id numbers or names frames."""
    content = json.loads(path.read_text("utf-8-sig"))
    found = content if isinstance(content, list) else content["annotations"]
    if not found:
        raise GeoaimError(f"{path} has no annotations")
    if any(entry.get("attributes", {}).get("rotation", 0) for entry in found):
        raise GeoaimError(
            f"{path} has boxes with a rotation, which COCO's boxes do not hold; export them as "
            "oriented boxes of YOLO"
        )
    box = np.array([entry["bbox"] for entry in found], np.float64)
    score = np.array([entry.get("score", np.nan) for entry in found], np.float64)
    rows = _make_rows(box, score, np.zeros(len(found)))
    known = [] if isinstance(content, list) else content.get("categories", [])
    names = {entry["id"]: entry["name"] for entry in known}
    rows["class"] = [str(names.get(entry.get("category_id"), "")) for entry in found]
    rows["id"] = [
        str(entry.get("track_id", entry.get("attributes", {}).get("track_id", "")))
        for entry in found
    ]
    if not isinstance(content, list):
        if video is not None:
            _check_image_sizes(path, content["images"], video)
        stems = {image["id"]: Path(image["file_name"]).stem for image in content["images"]}
    elif all(str(entry["image_id"]).isdecimal() for entry in found):
        numbers = [int(entry["image_id"]) for entry in found]
        return make_numbered_table(rows.assign(frame=numbers), rate, video, path, None)
    else:
        stems = {entry["image_id"]: str(entry["image_id"]) for entry in found}
    rows["name"] = [stems[entry["image_id"]] for entry in found]
    names_of_frames = list(dict.fromkeys(stems.values()))
    return make_named_table(rows, names_of_frames, _match_names(names_of_frames, video, path))


def _check_image_sizes(path: Path, images: Sequence[Mapping[str, Any]], video: Video) -> None:
    """Refuse boxes of images of another size than the frames."""
    for image in images:
        size = image.get("width", video.width), image.get("height", video.height)
        if size != (video.width, video.height):
            raise GeoaimError(
                f"{path} has boxes of images of {size[0]} x {size[1]} pixels, and the frames of "
                f"{video.source} have {video.width} x {video.height}; give boxes of that size"
            )


def _read_table(
    path: Path,
    columns: Mapping[str, str] | None,
    rate: float | None,
    classes: Sequence[str],
    video: Video | None,
) -> BoxTable:
    """Read a CSV with a header."""
    delimiter = None if path.suffix.lower() != ".csv" else ","
    table = pd.read_csv(
        path, sep=delimiter, engine="python" if delimiter is None else "c", comment="#"
    )
    table.columns = table.columns.str.strip()
    rows = name_columns(path, table, columns or {})
    rows["class"] = _name_classes(rows["class"], classes)
    if "time" in rows:
        return make_timed_table(rows)
    return make_numbered_table(rows, rate, video, path, None)
