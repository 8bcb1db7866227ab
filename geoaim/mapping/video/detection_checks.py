"""What the numbers of boxes mean, judged by the picture that they lie in; damaged ones left out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError

if TYPE_CHECKING:
    import pandas as pd

FORMS: Mapping[str, str] = {
    "ltrb": "left, top, right and bottom",
    "ltwh": "left, top, width and height",
    "xywh": "the middle x and y, width and height",
}
# where other forms are made into these
PAGE = "docs/formats/detections.md has two lines that make a table of any other form"
IGNORED = "ignored"  # the name for classes that are left out
MAX_SHARE = 1.5  # boxes may end outside the image
BORDER_PX = 3.0  # by which noise takes boxes beyond the picture
MIN_WRONG = 4  # boxes that a reading takes out of the picture, and another one does not
MAX_OUTSIDE = 0.05  # share of boxes whose middles are not in the picture; more are refused
MIN_REACH = 0.75  # share of the picture that boxes reach; less is odd where there are many
MIN_JUDGED = 50  # boxes


@dataclass(frozen=True, eq=False)
class RawBoxes:
    """Boxes as they are written, before the meaning of their numbers is judged; M of them."""

    rows: "pd.DataFrame"  # the columns score and class, and one of name, frame and time
    numbers: Float[Array, "M n"]  # four of a form, or the corners of oriented boxes
    forms: tuple[str, ...] = ("ltrb",)  # keys of `FORMS`: the usual one, then its usual slips
    is_named: bool = True  # whether the source says which form it is; a doubtful one is stated
    shares: bool | None = False  # whether numbers are shares of the picture; None: found
    size: tuple[int, int] | None = None  # (width, height) of the picture, where it is stated
    usual_frame: int | None = None  # number of the first frame; None: formats differ
    class_names: Sequence[str] = ()  # of class numbers from 0
    usual_class: int | None = 0  # number of the first class; None: formats differ
    listed: tuple[str, ...] = ()  # names of all frames, with boxes or without
    all_frames: tuple[int, ...] | None = None  # numbers of those; None: those with rows tell
    remarks: tuple[str, ...] = ()  # on what reading assumed


@dataclass(frozen=True)
class BoxOptions:
    """What the user says about boxes; None and empty: found."""

    rate: float | None = None
    first: int | None = None
    form: str | None = None
    size: tuple[int, int] | None = None
    classes: tuple[str, ...] = ()


def parse_size(text: str) -> tuple[int, int]:
    """Parse the value of --size.

    Raises:
        ValueError: the text has another form.

    >>> parse_size("1920x1080")
    (1920, 1080)
    """
    width, _, height = text.lower().partition("x")
    if not (width.strip().isdecimal() and height.strip().isdecimal()):
        raise ValueError(f"size {text!r} is not of the form WIDTHxHEIGHT, such as 1920x1080")
    return int(width), int(height)


def judge_boxes(
    raw: RawBoxes, picture: tuple[int, int], options: BoxOptions, source: str
) -> tuple[Float[Array, "M n"], Bool[Array, "M"], list[str]]:
    """Judge what the numbers of boxes mean, by the picture that they should lie in."""
    remarks: list[str] = []
    numbers = np.asarray(raw.numbers, np.float64)
    finite = np.asarray(np.isfinite(numbers).all(axis=1))
    numbers, remark = _scale_shares(raw, numbers, finite, picture)
    size = options.size or (None if remark or raw.shares else raw.size)
    remarks += [remark] if remark else []
    if size is not None and abs(size[0] * picture[1] / (size[1] * picture[0]) - 1) > 0.02:
        raise GeoaimError(
            f"{source} has boxes of pictures of {size[0]} x {size[1]} pixels, and the frames have "
            f"{picture[0]} x {picture[1]}, which is another shape; give boxes of whole frames"
        )
    within = size or picture
    usable = finite.copy()
    if numbers.shape[1] == 4:
        form, remark = choose_form(raw, numbers[finite], within, options.form)
        numbers = convert_form(numbers, form)
        remarks += [remark] if remark else []
        sides = numbers[:, 2:] - numbers[:, :2]
        is_points = not sides[finite].any()
        usable &= is_points | (sides > 0).all(axis=1)
    if dropped := int((~usable).sum()):
        remarks.append(f"{dropped} boxes without an area, or with values missing, are left out")
    ends = get_bounds(numbers)
    if size is None and not raw.shares:
        remarks += _judge_reach(ends[usable], picture)
    _refuse_outside(ends[usable], size or picture, source)
    if size is not None and tuple(size) != picture:
        scale = np.array(picture) / np.array(size)
        if raw.size == size and options.size is None:
            remarks.append(f"they are of pictures of {size[0]} x {size[1]}, and are scaled")
        numbers = numbers * np.tile(scale, numbers.shape[1] // 2)
    return numbers, usable, remarks


def get_bounds(numbers: Float[Array, "M n"]) -> Float[Array, "M 4"]:
    """Get left, top, right and bottom of boxes of these, or of corners."""
    if numbers.shape[1] == 4:
        return numbers
    corners = numbers.reshape(-1, 4, 2)
    return np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)


def convert_form(numbers: Float[Array, "M 4"], form: str) -> Float[Array, "M 4"]:
    """Convert boxes of a form to left, top, right, bottom.

    >>> convert_form(np.array([[10.0, 20, 4, 2]]), "xywh")
    array([[ 8., 19., 12., 21.]])
    """
    if form == "ltrb":
        return numbers
    start = numbers[:, :2] - (numbers[:, 2:] / 2 if form == "xywh" else 0.0)
    return np.concatenate([start, start + numbers[:, 2:]], axis=1)


def choose_form(
    raw: RawBoxes, numbers: Float[Array, "M 4"], size: tuple[int, int], form: str | None
) -> tuple[str, str]:
    """Choose the form that keeps boxes in the picture, and remark where it is not the usual one."""
    if form is not None or len(raw.forms) == 1:
        return form or raw.forms[0], ""
    wrong = [_count_wrong(convert_form(numbers, other), size) for other in raw.forms]
    best = int(np.argmin(wrong))
    usual, chosen = raw.forms[0], raw.forms[best]
    if best and wrong[0] >= MIN_WRONG and wrong[best] <= wrong[0] / 5:
        return chosen, (
            f"its numbers are taken for {FORMS[chosen]}, since {wrong[0]} of {len(numbers)} boxes "
            f"would not lie in the picture as {FORMS[usual]}; --form {usual} says otherwise"
        )
    if not raw.is_named and max(wrong[1:]) < MIN_WRONG and len(numbers) >= MIN_JUDGED:
        others = " or ".join(raw.forms[1:])
        return usual, f"its numbers are taken for {FORMS[usual]}; --form {others} says otherwise"
    return usual, ""


def _count_wrong(ends: Float[Array, "M 4"], size: tuple[int, int]) -> int:
    """Count boxes that end beyond the picture, or before they begin."""
    limits = np.array(size) + BORDER_PX
    beyond = (ends[:, :2] < -BORDER_PX).any(axis=1) | (ends[:, 2:] > limits).any(axis=1)
    return int((beyond | (ends[:, 2:] <= ends[:, :2]).any(axis=1)).sum())


def _scale_shares(
    raw: RawBoxes, numbers: Float[Array, "M n"], finite: Bool[Array, "M"], size: tuple[int, int]
) -> tuple[Float[Array, "M n"], str]:
    known = numbers[finite]
    is_share, remark = bool(raw.shares), ""
    if raw.shares is None and len(known) and known.any() and np.abs(known).max() <= MAX_SHARE:
        is_share, remark = True, "its numbers are taken for shares of the picture's size"
    if is_share:
        numbers = numbers * np.tile(np.array(size, float), numbers.shape[1] // 2)
    return numbers, remark


def _judge_reach(ends: Float[Array, "M 4"], picture: tuple[int, int]) -> list[str]:
    """Remark on boxes that leave a part of the picture empty, as those of a smaller one do."""
    if len(ends) < MIN_JUDGED:
        return []
    reach = ends[:, 2:].max(axis=0)
    if (reach > MIN_REACH * np.array(picture)).any():
        return []
    return [
        f"they reach to {reach[0]:.0f} x {reach[1]:.0f} of {picture[0]} x {picture[1]} pixels "
        "only; if they are of pictures of another size, give that as --size WIDTHxHEIGHT"
    ]


def _refuse_outside(ends: Float[Array, "M 4"], size: tuple[int, int], source: str) -> None:
    if not len(ends):
        return
    middle = (ends[:, :2] + ends[:, 2:]) / 2
    limits = np.array(size) + BORDER_PX
    outside = ((middle < -BORDER_PX) | (middle > limits)).any(axis=1)
    huge = (ends[:, 2:] - ends[:, :2] > 1.2 * limits).any(axis=1)
    share = (outside | huge).mean()
    if share > MAX_OUTSIDE:
        reach = ends[:, 2:].max(axis=0)
        raise GeoaimError(
            f"{source}: {share:.0%} of the boxes do not lie in the picture of "
            f"{size[0]} x {size[1]} pixels; they reach to {reach[0]:.0f} x {reach[1]:.0f}. "
            "Are they of pictures of another size (--size WIDTHxHEIGHT), or their four numbers of "
            "another form "
            f"(--form {', '.join(FORMS)}), or x and y exchanged, as TensorFlow's are?"
        )


def find_oriented_boxes(corners: Float[Array, "M 8"]) -> Bool[Array, "M"]:
    """Find which four corners are those of a rectangle, in pixels, and not of any polygon."""
    points = corners.reshape(-1, 4, 2)
    diagonals = np.linalg.norm(points[:, :2] - points[:, 2:], axis=2)
    offset = np.linalg.norm(points[:, 0] + points[:, 2] - points[:, 1] - points[:, 3], axis=1)
    longest = np.maximum(diagonals.max(axis=1), 1e-9)
    uneven = np.maximum(np.abs(diagonals[:, 0] - diagonals[:, 1]), offset / 2)
    return uneven <= np.maximum(0.08 * longest, 2.0)


def judge_scores(scores: Float[Array, "M"]) -> tuple[Float[Array, "M"], str]:
    """Judge confidences: from 0 to 1, or of no known scale (NaN)."""
    known = scores[np.isfinite(scores)]
    if not len(known) or (known.max() <= 1 and known.min() >= 0):
        return scores, ""
    if (known == -1).all():
        return np.full(len(scores), np.nan), ""
    wrong = int(((known > 1) | (known < 0)).sum())
    return np.full(len(scores), np.nan), (
        f"its scores are not used, since {wrong} of {len(known)} are not from 0 to 1; if they are "
        "angles, give turned boxes by their four corners"
    )


def name_classes(
    classes: Sequence[str], names: Sequence[str], usual: int | None
) -> tuple[list[str], str]:
    """Name classes that are numbers, and remark on what was assumed.

    Names are in order of the numbers, or pairs such as `3=car`. The first class in the format has
    the usual number; None: formats differ, and it is 0.
    """
    numbers = sorted({int(name) for name in set(classes) if name.isdecimal()})
    if not names or not numbers:
        several = len(numbers) > 1 and not names
        remark = "its classes are numbers without names, so that types follow from sizes"
        return list(classes), f"{remark}; --classes names them" if several else ""
    if all("=" in name for name in names):
        pairs = (name.partition("=") for name in names)
        known = {number.strip(): name.strip() for number, _, name in pairs}
        return [known.get(name, name) for name in classes], ""
    first = 0 if numbers[0] == 0 else usual or 0
    known = {str(number + first): name for number, name in enumerate(names)}
    remark = ""
    if unnamed := [str(number) for number in numbers if str(number) not in known]:
        remark = f"its classes {', '.join(unnamed[:5])} have no name in --classes"
    elif first or (numbers[0] and usual is None):
        example = ",".join(f"{number}=..." for number in numbers[:3])
        remark = (
            f"its classes count from {first}, it is assumed; --classes {example} says otherwise"
        )
    return [known.get(name, name) for name in classes], remark
