"""Detections: boxes of vehicles in frames, from YOLO text files or arrays."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.errors import GeoaimError
from geoaim.mapping.video.frames import Frame

BOX_SCALE = 1.12  # detectors' boxes leave out shadows and mirrors
# Boxes of a frame as (N, 4) left, top, right, bottom in pixels; None for a frame without labels.
Detections = Callable[[Frame], Float[Array, "N 4"] | None]
DetectionSource = str | Path | Sequence[Float[Array, "N 4"]] | Detections


def read_detections(source: DetectionSource) -> Detections:
    """Read boxes of vehicles from a folder of YOLO text files, or from arrays, one for each frame.

    An array has rows left, top, right, bottom in pixels. A text file is named like the frame's
    image, or by the frame's index (`000123.txt` or `123.txt`), and has one row per box: class,
    centre x, centre y, width, height; all but the class are shares of the image's size.

    Returns:
        A function from a `Frame` to its boxes (N, 4) left, top, right, bottom in pixels, or to None
        for a frame without a file or array. A source that is such a function is returned as it is.

    Raises:
        GeoaimError: the folder holds no text files; or, when the boxes of a frame are read, a row
            has another form.
    """
    if callable(source):
        return source
    if not isinstance(source, str | Path):
        return lambda frame: source[frame.index] if frame.index < len(source) else None
    if not Path(source).is_dir():
        raise GeoaimError(f"{source} is not a folder; a folder of YOLO .txt files is needed")
    files = {file.stem.lstrip("0") or "0": file for file in Path(source).glob("*.txt")}
    if not files:
        raise GeoaimError(f"{source} holds no .txt files; one YOLO file for each frame is needed")

    def read_boxes(frame: Frame) -> Float[Array, "N 4"] | None:
        stem = Path(frame.name).stem if frame.name else str(frame.index)
        file = files.get(stem.lstrip("0") or "0")
        return None if file is None else _read_yolo(file, frame.grey.shape)

    return read_boxes


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


def _read_yolo(file: Path, size: tuple[int, int]) -> Float[Array, "N 4"]:
    """Boxes in pixels of a (height, width) image."""
    try:
        rows = [line.split() for line in file.read_text("utf-8").splitlines() if line.strip()]
        if not all(len(row) in (5, 6) for row in rows):
            raise ValueError("5 fields are needed, a confidence may follow")
        values = np.array([[float(value) for value in row[1:5]] for row in rows]).reshape(-1, 4)
    except ValueError as error:
        raise GeoaimError(f"{file}: a row is not `class x y width height`: {error}") from error
    if not ((values >= 0) & (values <= 1)).all():
        raise GeoaimError(f"{file}: values reach {values.max():g}; shares of the size are needed")
    low, high = values[:, :2] - values[:, 2:] / 2, values[:, :2] + values[:, 2:] / 2
    return np.concatenate([low * size[::-1], high * size[::-1]], axis=1)
