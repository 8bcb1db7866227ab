"""Detections: boxes of agents in frames, from files, arrays or a detector's results."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError, warn
from geoaim.mapping.video.box_tables import (
    FrameRows,
    group_by_name,
    group_by_value,
    match_names,
    place_numbers,
    place_times,
)
from geoaim.mapping.video.detection_checks import (
    FORMS,
    IGNORED,
    BoxOptions,
    RawBoxes,
    convert_form,
    find_oriented_boxes,
    get_bounds,
    judge_boxes,
    judge_scores,
    name_classes,
)
from geoaim.mapping.video.frames import Frame, FrameList
from geoaim.mapping.video.video import Video
from geoaim.tracks.agent_types import AGENT_TYPES

# names of classes in datasets of detections -> agent types
CLASS_TYPES = AGENT_TYPES | {
    "large vehicle": "",  # a truck or a bus: its size tells
    "large-vehicle": "",
    "motor": "motorcycle",
    "motorbike": "motorcycle",
    "people": "pedestrian",
    "person": "pedestrian",
    "small vehicle": "car",  # DOTA
    "small-vehicle": "car",
    "vehicle": "",
}
MIN_ORIENTED = 0.5  # share of boxes of four corners that are rectangles, if they are oriented boxes
BOX_SCALE = 1.12  # detectors' boxes leave out shadows and mirrors


@dataclass(frozen=True, eq=False)
class DetectedBoxes:
    """The boxes of a frame, with what the detector says of them."""

    boxes: Float[Array, "N 4"]  # left, top, right, bottom, pixels
    # corners of oriented boxes in pixels, the first side along the agent; None: boxes are upright
    corners: Float[Array, "N 4 2"] | None = None
    scores: Float[Array, " N"] | None = None  # confidences, 0 to 1; None: not known
    types: tuple[str, ...] = ()  # agent types, "" for one that is not known; (): none is
    # which corners lie where what was searched ends, beside the frame's border; None: none does
    at_border: Bool[Array, "N 4"] | None = None

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

    def get_at_border(self) -> Bool[Array, "N 4"]:
        """Get which corners lie where what was searched ends."""
        return np.zeros((len(self.boxes), 4), bool) if self.at_border is None else self.at_border

    def get_types(self) -> Shaped[Array, " N"]:
        """Get the types, "" where they are not known."""
        return np.array(self.types or ("",) * len(self.boxes), object)


# Boxes of a frame; None for a frame without labels.
Detections = Callable[[Frame], DetectedBoxes | None]
# Tables of pandas are iterables.
DetectionSource = str | Path | Iterable[Any] | Callable[[Frame], Any]


class BoxReader:
    """Boxes that are read and judged: a function from a `Frame` to its boxes."""

    def __init__(
        self, raw: RawBoxes, source: str, options: BoxOptions, listed: FrameList | None = None
    ) -> None:
        self._raw, self._source, self._options, self._listed = raw, source, options, listed
        self._frames: FrameRows | None = None
        self._picture: tuple[int, int] | None = None
        if listed is not None:
            self._frames = _find_frames(raw, source, options, listed)
            self._judge(listed.size)

    def bind(self, listed: FrameList | None) -> "BoxReader":
        """Read the same boxes as those of a video, by which they are judged.

        Boxes that were read without it may be those of a longer one, of which it is a part.
        """
        if listed is None or self._listed is listed:
            return self
        try:
            return BoxReader(self._raw, self._source, self._options, listed)
        except GeoaimError as error:
            if self._listed is None and "has boxes of" in str(error):
                return self
            raise

    def __call__(self, frame: Frame) -> DetectedBoxes | None:
        """Get the boxes of a frame; None where they are not known."""
        if self._frames is None:
            self._frames = _find_frames(self._raw, self._source, self._options, None)
        rows = self._frames.find(frame.name, frame.index)
        if rows is None:
            return None
        if self._listed is None or self._picture is None:
            height, width = frame.grey.shape
            if self._picture != (width, height):
                self._judge((width, height))
        rows = rows[self._usable[rows]]
        corners = None if self._corners is None else self._corners[rows]
        return DetectedBoxes(
            self._boxes[rows], corners, self._scores[rows], tuple(self._types[rows])
        )

    def _judge(self, picture: tuple[int, int]) -> None:
        raw, options = self._raw, self._options
        numbers, usable, remarks = judge_boxes(raw, picture, options, self._source)
        self._scores, remark = judge_scores(raw.rows["score"].to_numpy(np.float64))
        names, usual = options.classes or raw.class_names, raw.usual_class
        classes, other = name_classes(raw.rows["class"].tolist(), names, usual)
        self._types = np.array(map_classes(classes), object)
        self._usable = usable & (np.array(classes, object) != IGNORED)
        self._boxes, self._corners = get_bounds(numbers), None
        if numbers.shape[1] == 8:
            oriented = find_oriented_boxes(numbers[usable])
            if oriented.mean() > MIN_ORIENTED:
                self._corners = order_corners(numbers.reshape(-1, 4, 2))
            else:
                remarks.append("its four corners are no rectangles: their upright bounds are taken")
        assert self._frames is not None
        remarks = [*raw.remarks, *self._frames.remarks, *remarks, *filter(None, (remark, other))]
        is_first, self._picture = self._picture is None, picture
        if remarks and is_first:
            warn(f"{self._source}: {'; '.join(remarks)}")


def _find_frames(
    raw: RawBoxes, source: str, options: BoxOptions, listed: FrameList | None
) -> FrameRows:
    """Find which rows are of which frame."""
    rows = raw.rows
    if "time" in rows:
        groups = group_by_value(rows["time"].to_numpy(np.float64))
        return place_times(groups, frames=listed, source=source)
    if "frame" in rows:
        groups = group_by_value(np.round(rows["frame"].to_numpy(np.float64)))
        if raw.all_frames is not None:
            by_number = dict(zip(groups.numbers, groups.rows, strict=True))  # type: ignore[arg-type]
            parts = tuple(by_number.get(n, np.empty(0, int)) for n in raw.all_frames)
            groups = FrameRows(None, np.array(raw.all_frames, float), parts, np.inf)
        return place_numbers(
            groups,
            rate=options.rate,
            first=options.first,
            usual=raw.usual_frame,
            frames=listed,
            source=source,
        )
    numbers = match_names(raw.listed, listed, source, options.first)
    groups = group_by_name(rows["name"], raw.listed, numbers)
    return place_numbers(
        groups, rate=options.rate, first=0, usual=None, frames=listed, source=source
    )


def read_detections(  # noqa: PLR0913  (its options)
    source: DetectionSource,
    *,
    columns: Mapping[str, str] | None = None,
    rate: float | None = None,
    classes: Sequence[str] = (),
    form: str | None = None,
    size: tuple[int, int] | None = None,
    first: int | None = None,
    video: Video | None = None,
) -> Detections:
    """Read boxes of agents from files, arrays or a detector's results.

    What a source does not say is judged by the boxes themselves: which four numbers they are, of a
    picture of which size, in pixels or in shares of it, and how frames and classes are counted.
    What was assumed is said in one warning that names the option which says otherwise.

    Args:
        source: a folder of text files in YOLO's format, named like the frames' images or by the
            frames' indices (`000123.txt`, `123.txt`, or `hover_124.txt` as ultralytics names them,
            from 1); a file of all frames (MOT, COCO's JSON, or a CSV with a header); a table of
            pandas with the columns of such a CSV; an iterable with an entry for each frame, or a
            function of a `Frame`. An entry is an array of rows left, top, right, bottom in pixels,
            after which score and class may follow; an object with `xyxy` as those of supervision
            and ultralytics; a `DetectedBoxes`; or None for a frame without labels.
        columns: names of a CSV's columns by what they hold: frame or time (s), class, score, and
            left, top, right, bottom or x, y, width, height (of the box's middle), pixels.
        rate: frames per second by which frame numbers of a file, or entries, count; None: they
            number the frames of the video.
        classes: names of class numbers from 0 on, or pairs such as `3=car`; those of a
            `classes.txt` in the folder if empty.
        form: the four numbers of a box: "ltrb", "ltwh" or "xywh" (the middle); None: found.
        size: (width, height) of the pictures that boxes are of, pixels; None: found.
        first: number of the first frame; None: found.
        video: the video that the boxes are of. With it the names of files are checked, numbers
            that count from 1 are found, and times belong to their nearest frames; None: the one
            that the boxes are given to next tells.

    Returns:
        A function from a `Frame` to its boxes, or to None for a frame without any known.

    Raises:
        GeoaimError: the file or folder holds no detections in a known format, or none of the
            frames of the video.
    """
    from geoaim.mapping.video.detection_files import read_raw_boxes  # which needs pandas

    listed = None if video is None else video.listed
    if isinstance(source, BoxReader):
        return source.bind(listed)
    if form is not None and form not in FORMS:
        raise ValueError(f"form is {form!r}; one of {', '.join(FORMS)} is needed")
    if callable(source):
        return lambda frame: convert_boxes(source(frame), form)
    options = BoxOptions(rate, first, form, size, tuple(classes))
    if isinstance(source, str | Path):
        return BoxReader(read_raw_boxes(Path(source), columns), str(source), options, listed)
    if hasattr(source, "columns"):
        table: Any = source.to_pandas() if hasattr(source, "to_pandas") else source  # of polars
        return BoxReader(read_raw_boxes(table, columns), "the table", options, listed)
    return BoxReader(_join_entries(source), "the boxes", options, listed)


def _join_entries(entries: Iterable[Any]) -> RawBoxes:
    """Join the entries of all frames."""
    import pandas as pd

    from geoaim.mapping.video.detection_entries import convert_entry

    known: list[int] = []
    parts: list[RawBoxes] = []
    for number, entry in enumerate(entries):
        if entry is not None:
            raw = convert_entry(entry)
            known.append(number)
            parts.append(replace(raw, rows=raw.rows.assign(frame=float(number))))
    filled = [part for part in parts if len(part.rows)]
    if not filled:
        filled = parts[:1] or [convert_entry(np.empty((0, 4)))]
        filled = [replace(filled[0], rows=filled[0].rows.assign(frame=0.0))]
    if len({part.numbers.shape[1] for part in filled}) > 1:
        filled = [replace(part, numbers=get_bounds(part.numbers)) for part in filled]
    plain = next((part for part in filled if len(part.forms) > 1), filled[0])
    return replace(
        plain,
        rows=pd.concat([part.rows for part in filled], ignore_index=True),
        numbers=np.concatenate([part.numbers for part in filled]),
        all_frames=tuple(known),
        usual_frame=0,
    )


def convert_boxes(value: Any, form: str | None = None) -> DetectedBoxes | None:
    """Convert an array of boxes, or the result of a detector, by its attributes alone.

    Results of ultralytics have `boxes` or `obb`, with xyxy (or xyxyxyxy), conf, cls and id; those
    of supervision xyxy, confidence, class_id, tracker_id and names in `data`.
    """
    if value is None:
        return None
    if isinstance(value, DetectedBoxes):
        return replace(value, types=map_classes(value.types))
    from geoaim.mapping.video.detection_entries import convert_entry  # which needs pandas

    raw = convert_entry(value)
    numbers = raw.numbers
    if numbers.shape[1] == 4 and len(raw.forms) > 1:
        numbers = convert_form(numbers, form or raw.forms[0])
    ends = get_bounds(numbers)
    if (ends[:, 2:] < ends[:, :2]).any():
        raise GeoaimError(
            "a box ends before it begins, so that its numbers are not left, top, right and bottom; "
            f"say what they are by form, one of {', '.join(FORMS)}"
        )
    scores = raw.rows["score"].to_numpy(np.float64)
    return DetectedBoxes(
        ends,
        order_corners(numbers.reshape(-1, 4, 2)) if numbers.shape[1] == 8 else None,
        None if np.isnan(scores).all() else scores,
        map_classes(raw.rows["class"].tolist()) if raw.rows["class"].astype(bool).any() else (),
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
