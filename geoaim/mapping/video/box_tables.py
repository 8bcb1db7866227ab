"""Which frame the boxes of a file are of: by its number, its time, or the name of its image."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError, warn
from geoaim.mapping.video.frames import FrameList

if TYPE_CHECKING:
    import pandas as pd

MAX_TIME_OFFSET_S = 0.5  # of a frame from the boxes that are nearest in time
MIN_REGULAR = 5  # numbers of frames that tell their stride
MIN_COVERED = 0.6  # share of the video's frames before the last one with boxes; fewer are odd
MAX_LISTED = 3  # names that a message lists


@dataclass(frozen=True, eq=False)
class FrameRows:
    """The rows of each frame: by the name of its image, or by its number."""

    of_name: Mapping[str, Int[Array, " _"]] | None = None
    numbers: Float[Array, " K"] | None = None  # of frames with rows, increasing
    rows: tuple[Int[Array, " _"], ...] = ()  # of each
    stride: float = 1.0  # from one frame with boxes to the next
    remarks: tuple[str, ...] = ()

    def find(self, name: str | None, index: int) -> Int[Array, " _"] | None:
        """Find the rows of a frame by the name of its image if it has one, or by its number.

        None: the boxes of the frame are not known. Between the first and the last frame with rows,
        one where rows are to be expected by the stride has no boxes.
        """
        if self.of_name is not None and name is not None:
            return self.of_name.get(strip_zeros(Path(name).stem))
        if self.numbers is None or not len(self.numbers):
            return None
        after = int(np.searchsorted(self.numbers, index))
        if after < len(self.numbers) and self.numbers[after] == index:
            return self.rows[after]
        if not 0 < after < len(self.numbers):
            return None
        before, gap = self.numbers[after - 1], self.numbers[after] - self.numbers[after - 1]
        count = max(round(gap / self.stride), 1)
        expected = before + round((index - before) * count / gap) * gap / count
        return np.empty(0, int) if np.floor(expected + 0.5) == index else None


def strip_zeros(stem: str) -> str:
    """Strip leading zeros of a file's stem, so that 000123 is 123 and 000 is 0."""
    return stem.lstrip("0") or "0"


def group_by_name(
    names: "pd.Series[str]", listed: Collection[str], numbers: Mapping[str, int] | None
) -> FrameRows:
    """Group rows by the names of frames."""
    indices = names.reset_index(drop=True).map(strip_zeros).to_numpy(str)
    known = {strip_zeros(name): np.empty(0, int) for name in listed}
    order = np.argsort(indices, kind="stable")
    found, starts = np.unique(indices[order], return_index=True)
    parts = np.split(order, starts[1:]) if len(found) else []
    known |= dict(zip(found.tolist(), parts, strict=True))
    if not numbers:
        return FrameRows(known)
    by_number = sorted((number, known[strip_zeros(name)]) for name, number in numbers.items())
    return FrameRows(
        known,
        np.array([number for number, _ in by_number], float),
        tuple(rows for _, rows in by_number),
        stride=np.inf,  # only those that are listed are known
    )


def place_numbers(
    groups: FrameRows,
    *,
    rate: float | None,
    first: int | None,
    usual: int | None,
    frames: FrameList | None,
    source: str | Path,
) -> FrameRows:
    """Place rows that are grouped by numbers of frames."""
    numbers = groups.numbers
    if numbers is None or not len(numbers):
        return groups
    if rate is not None:
        start = first if first is not None else usual if usual and numbers.min() > 0 else 0
        timed = replace(groups, numbers=(numbers - start) / rate, stride=groups.stride / rate)
        return place_times(timed, frames=frames, source=source)
    chosen = {int(number) for number in numbers.tolist()}
    start = find_first(chosen, frames, source, usual=usual) if first is None else first
    stride = max(groups.stride, 1.0) if len(numbers) >= MIN_REGULAR else 1.0
    groups = replace(groups, numbers=numbers - start, stride=stride)
    count, last = None if frames is None else frames.count, float(numbers.max()) - start
    step = stride if np.isfinite(stride) else 1.0
    if frames is None or not count or last + step >= MIN_COVERED * count:
        return groups
    usual_rate = (last + 1) / count * frames.rate
    remark = (
        f"its frame numbers end at {last + start:.0f} and the video has {count} frames; if it has "
        f"not all frames of the video, give their --rate in a second (such as {usual_rate:.3g})"
    )
    return replace(groups, remarks=(remark,))


def place_times(groups: FrameRows, *, frames: FrameList | None, source: str | Path) -> FrameRows:
    """Place rows that are grouped by time, s: those of each belong to the nearest frame."""
    times, stride, remarks = groups.numbers, groups.stride, []
    if times is None or not len(times):
        return groups
    if frames is None or frames.times is None:
        raise GeoaimError(
            f"{source} has boxes by time, and the times of the frames are not known; number the "
            "frames, or give the video to read_detections"
        )
    known = frames.times
    nearest = np.searchsorted((known[1:] + known[:-1]) / 2, times)
    distance = np.abs(known[nearest] - times)
    half = float(np.median(np.diff(known))) / 2 if len(known) > 1 else MAX_TIME_OFFSET_S
    usable = distance <= max(half, min(stride / 2, MAX_TIME_OFFSET_S)) * (1 + 1e-6)
    if not usable.any():
        raise GeoaimError(
            f"{source} has boxes of {times.min():g} to {times.max():g} s, and {frames.source} "
            f"lasts {known[-1]:.1f} s: none is of a frame; give seconds since the first frame, or "
            "frame numbers and --rate"
        )
    chosen = np.lexsort((distance, nearest))
    chosen = chosen[usable[chosen]]
    chosen = chosen[np.unique(nearest[chosen], return_index=True)[1]]
    rows = tuple(groups.rows[number] for number in chosen)
    late = sum(map(len, groups.rows[int(np.searchsorted(times, known[-1] + 2 * half)) :]))
    if late:
        remarks.append(
            f"{late} boxes are of times after the video's end ({known[-1]:.1f} s), up to "
            f"{times[-1]:.1f} s, and are left out: are they of this video, and in seconds?"
        )
    count = sum(map(len, groups.rows)) - late
    if unused := count - sum(map(len, rows)):
        remarks.append(f"{unused} of {count} boxes are left out: another time is nearer to a frame")
    numbers = nearest[chosen].astype(float)
    stride = stride if np.isinf(stride) else max(find_stride(numbers), 1.0)
    return FrameRows(None, numbers, rows, stride, remarks=tuple(remarks))


def group_by_value(values: Float[Array, "m"]) -> FrameRows:
    """Group rows by their numbers of frames, or by their times."""
    if not len(values):
        return FrameRows(None, values)
    numbers, place = np.unique(values, return_inverse=True)
    order = np.argsort(place, kind="stable")
    parts = np.split(order, np.searchsorted(place[order], np.arange(1, len(numbers))))
    return FrameRows(None, numbers, tuple(parts), find_stride(numbers))


def find_stride(numbers: Float[Array, " n"]) -> float:
    """Find the usual distance of successive numbers; gaps where nothing was detected aside."""
    gaps = np.diff(numbers)
    if not len(gaps):
        return 1.0
    least = float(np.quantile(gaps, 0.1))
    return float(gaps[gaps <= 1.5 * least + 1e-9].mean())


def number_names(
    stems: Sequence[str], frames: FrameList | None, source: str | Path, first: int | None = None
) -> dict[str, int] | None:
    """Find the frames that files are named by: `000012`, or ultralytics' `hover_13`."""
    parts = [re.fullmatch(r"(.*?)(\d+)", stem) for stem in stems]
    found = [part for part in parts if part is not None]
    if len(found) < len(parts) or len({part[1] for part in found}) != 1:
        return None
    numbers = [int(part[2]) for part in found]
    is_padded = any(part[2].startswith("0") and len(part[2]) > 1 for part in found)
    prefix = found[0][1].removesuffix("_")
    is_of_video = frames is None or prefix == Path(frames.source).stem
    by_ultralytics = found[0][1] != prefix and is_of_video and not is_padded
    if first is None:
        first = find_first(numbers, frames, source, usual=1 if by_ultralytics else None)
    return {stem: number - first for stem, number in zip(stems, numbers, strict=True)}


def match_names(
    names: Sequence[str], frames: FrameList | None, source: str | Path, first: int | None = None
) -> dict[str, int] | None:
    """Number the names of frames of a video; refuse those of which none is that of a frame."""
    if frames is not None and frames.names is not None:
        images = [Path(name).stem for name in frames.names]
        if not {name.lstrip("0") for name in images} & {name.lstrip("0") for name in names}:
            refuse_other_names(names, images, frames, source)
        return None
    numbers = number_names(names, frames, source, first)
    if numbers is None and frames is not None:
        refuse_other_names(names, (), frames, source)
    return numbers


def find_first(
    numbers: Collection[int],
    frames: FrameList | None,
    source: str | Path,
    *,
    usual: int | None = None,
) -> int:
    """Find the number of the first frame, 0 or 1, by the numbers that are there."""
    if not numbers:
        return 0
    least, greatest = min(numbers), max(numbers)
    count = None if frames is None else frames.count
    if least == 0:
        first = 0
    elif count is not None and greatest == count:
        first = 1
    else:
        first = usual or 0
    if count is not None and greatest - first >= count:
        raise GeoaimError(
            f"{source} has boxes of frame number {greatest}, but {frames and frames.source} has "
            f"{count} frames; are they of another video, or of one at another rate?"
        )
    if usual is None and least > 0 and first == 0 and frames is not None:
        warn(
            f"{source} has no boxes of a frame number 0, so that nothing shows whether its numbers "
            f"({least} to {greatest}) count from 0 or from 1; they are taken to count from 0"
        )
    return first


def refuse_other_names(
    stems: Collection[str], wanted: Collection[str], frames: FrameList, source: str | Path
) -> None:
    """Refuse names of which none is that of a frame."""
    found = ", ".join(sorted(stems)[:MAX_LISTED])
    if wanted:
        looked_for = f"the names of its images ({', '.join(sorted(wanted)[:MAX_LISTED])}, ...)"
    else:
        stem = Path(frames.source).stem
        looked_for = f"frame numbers from 0 (000000, 000001, ...), or {stem}_1, {stem}_2, ..."
    raise GeoaimError(
        f"{source} has boxes of {found}, ..., of which none is a frame of {frames.source}; needed "
        f"are {looked_for}"
    )
