"""Detections: boxes of agents in frames, from files, arrays or a detector's results."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray as Array

from geoaim.mapping.video.box_tables import CORNERS, BoxTable
from geoaim.mapping.video.detection_files import read_box_table
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video
from geoaim.tracks.formats.shared import AGENT_TYPES

# names of classes in datasets of detections -> agent types
CLASS_TYPES = AGENT_TYPES | {
    "motor": "motorcycle",
    "motorbike": "motorcycle",
    "people": "pedestrian",
    "person": "pedestrian",
}
BOX_SCALE = 1.12  # detectors' boxes leave out shadows and mirrors


@dataclass(frozen=True, eq=False)
class DetectedBoxes:
    """The boxes of a frame, with what the detector says of them."""

    boxes: Float[Array, "N 4"]  # left, top, right, bottom, pixels
    # corners of oriented boxes in pixels, the first side along the agent; None: boxes are upright
    corners: Float[Array, "N 4 2"] | None = None
    scores: Float[Array, " N"] | None = None  # confidences, 0 to 1; None: not known
    types: tuple[str, ...] = ()  # agent types, "" for one that is not known; (): none is
    ids: tuple[str, ...] = ()  # ids that a tracker gave, "" for none; (): none

    def get_corners(self) -> Float[Array, "N 4 2"]:
        """Get the corners of all boxes; of upright ones top-left, top-right and so on."""
        if self.corners is not None:
            return self.corners
        left, top, right, bottom = np.asarray(self.boxes, np.float64).T
        corners = [left, top, right, top, right, bottom, left, bottom]
        return np.stack(corners, axis=-1).reshape(-1, 4, 2)

    def get_scores(self) -> Float[Array, " N"]:
        """Get the confidences, NaN where they are not known."""
        return np.full(len(self.boxes), np.nan) if self.scores is None else self.scores

    def get_types(self) -> Shaped[Array, " N"]:
        """Get the types, "" where they are not known."""
        return np.array(self.types or ("",) * len(self.boxes), object)

    def get_ids(self) -> Shaped[Array, " N"]:
        """Get the ids, "" where there are none."""
        return np.array(self.ids or ("",) * len(self.boxes), object)


# Boxes of a frame; None for a frame without labels.
Detections = Callable[[Frame], DetectedBoxes | None]
DetectionSource = str | Path | Sequence[Any] | Callable[[Frame], Any]


def read_detections(
    source: DetectionSource,
    *,
    columns: Mapping[str, str] | None = None,
    rate: float | None = None,
    classes: Sequence[str] = (),
    video: Video | None = None,
) -> Detections:
    """Read boxes of agents from files, arrays or a detector's results.

    Args:
        source: a folder of text files in YOLO's format or VisDrone's, named like the frames'
            images or by the frames' indices (`000123.txt`, `123.txt`, or `hover_124.txt` as
            ultralytics names them, from 1); a file of all frames (MOT, VisDrone, geo-trax, COCO's
            JSON, or a CSV with a header); a sequence with an entry for each frame, or a function
            of a `Frame`. An entry is an array of rows left, top, right, bottom in pixels, an
            object with `xyxy` as those of supervision and ultralytics, a `DetectedBoxes`, or None
            for a frame without labels.
        columns: names of a CSV's columns by what they hold: frame or time (s), id, class, score,
            and left, top, right, bottom or x, y, width, height (of the box's middle), pixels.
        rate: frames per second by which frame numbers of a file count; None: they number the
            frames of the video.
        classes: names of class numbers; those of a `classes.txt` in the folder if empty.
        video: the video that the boxes are of. With it the names of files are checked, and
            numbers that count from 1 are found; None: names tell nothing of that.

    Returns:
        A function from a `Frame` to its boxes, or to None for a frame without any known.

    Raises:
        GeoaimError: the file or folder holds no detections in a known format, or none of the
            frames of the video.
    """
    if callable(source):
        return lambda frame: convert_boxes(source(frame))
    if not isinstance(source, str | Path):
        entries = source
        return lambda f: convert_boxes(entries[f.index]) if f.index < len(entries) else None
    table = read_box_table(Path(source), columns=columns, rate=rate, classes=classes, video=video)
    return lambda frame: _select_frame(table, frame)


def convert_boxes(value: Any) -> DetectedBoxes | None:
    """Convert an array of boxes, or the result of a detector, by its attributes alone.

    Results of ultralytics have `boxes` or `obb`, with xyxy (or xyxyxyxy), conf, cls and id; those
    of supervision xyxy, confidence, class_id, tracker_id and names in `data`.
    """
    if value is None or isinstance(value, DetectedBoxes):
        return value
    names = getattr(value, "names", None) or {}
    for part in ("obb", "boxes"):
        if getattr(value, part, None) is not None:
            value = getattr(value, part)
            break
    if not hasattr(value, "xyxy"):
        return DetectedBoxes(np.asarray(value, np.float64).reshape(-1, 4))
    boxes = _to_array(value.xyxy).astype(np.float64).reshape(-1, 4)
    corners, data = getattr(value, "xyxyxyxy", None), getattr(value, "data", None)
    numbers = _get_first(value, "cls", "class_id")
    ids = _get_first(value, "id", "tracker_id")
    types = tuple(str(names.get(int(n), int(n))) for n in numbers) if numbers is not None else ()
    if isinstance(data, dict):
        types = tuple(map(str, data.get("class_name", types)))
        corners = data.get("xyxyxyxy", corners)
    scores = _get_first(value, "conf", "confidence")
    return DetectedBoxes(
        boxes,
        None if corners is None else order_corners(_to_array(corners).reshape(-1, 4, 2)),
        None if scores is None else scores.astype(np.float64),
        map_classes(types),
        () if ids is None else tuple(str(int(number)) for number in ids),
    )


def map_classes(names: Sequence[str]) -> tuple[str, ...]:
    """Map names of classes to agent types; bare numbers and blanks are not known, hence ""."""
    lower = (str(name).strip().lower() for name in names)
    return tuple(
        "" if name.lstrip("-").isdecimal() else CLASS_TYPES.get(name, name) for name in lower
    )


def order_corners(corners: Float[Array, "N 4 2"]) -> Float[Array, "N 4 2"]:
    """Turn the corners of oriented boxes so that the first side is the longer one."""
    corners = np.asarray(corners, np.float64)
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    turned = sides[:, 1] > sides[:, 0]
    return np.where(turned[:, None, None], np.roll(corners, -1, axis=1), corners)


def grow_boxes(boxes: Float[Array, "N 4"]) -> Float[Array, "N 4"]:
    """Enlarge boxes (left, top, right, bottom; pixels): width and height by 12 %, same centres."""
    centre, half = (boxes[:, :2] + boxes[:, 2:]) / 2, (boxes[:, 2:] - boxes[:, :2]) / 2 * BOX_SCALE
    return np.concatenate([centre - half, centre + half], axis=1)


def mask_boxes(boxes: Float[Array, "N 4"], size: tuple[int, int]) -> Bool[Array, "H W"]:
    """Make a mask of a (height, width) image, True inside the boxes that `grow_boxes` returns."""
    mask = np.zeros(size, bool)
    limits = np.array(size[::-1])
    grown = grow_boxes(boxes)
    low = np.clip(np.floor(grown[:, :2]), 0, limits).astype(int)
    high = np.clip(np.ceil(grown[:, 2:]), 0, limits).astype(int)
    for (left, top), (right, bottom) in zip(low, high, strict=True):
        mask[top:bottom, left:right] = True
    return mask


def _to_array(value: Any) -> Array:
    """Make an array of one, or of a tensor on any device."""
    return np.asarray(value.cpu() if hasattr(value, "cpu") else value)


def _get_first(value: Any, *names: str) -> Array | None:
    found = [getattr(value, name) for name in names if getattr(value, name, None) is not None]
    return _to_array(found[0]).reshape(-1) if found else None


def _select_frame(table: BoxTable, frame: Frame) -> DetectedBoxes | None:
    """Select the rows of a frame: by the name of its image, by its number, or by its time."""
    rows = table.find_rows(frame.name, frame.index, frame.time)
    if rows is None:
        return None
    height, width = frame.grey.shape
    part = table.rows.iloc[rows]
    scale = np.array([width, height] if table.has_shares else [1.0, 1.0])
    boxes = part[["left", "top", "right", "bottom"]].to_numpy(np.float64) * np.tile(scale, 2)
    corners = None
    if CORNERS[0] in part:
        corners = order_corners(part[list(CORNERS)].to_numpy(np.float64).reshape(-1, 4, 2) * scale)
    return DetectedBoxes(
        boxes,
        corners,
        part["score"].to_numpy(np.float64),
        map_classes(part["class"].tolist()),
        tuple(part["id"]),
    )
