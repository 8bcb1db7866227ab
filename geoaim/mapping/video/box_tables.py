"""A table of the boxes of all frames, as files of detections hold them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.mapping.video.frame_numbers import find_first
from geoaim.mapping.video.video import Video

CORNERS = ("u0", "v0", "u1", "v1", "u2", "v2", "u3", "v3")
BOX = ("left", "top", "right", "bottom")
DEFAULTS: Mapping[str, float | str] = {"score": np.nan, "class": "", "id": ""}
MAX_TIME_OFFSET_S = 0.5  # of a frame from the boxes that are nearest in time


@dataclass(frozen=True, eq=False)
class BoxTable:
    """The boxes of all frames: a row for each, with `BOX`, score, class, id and maybe `CORNERS`."""

    rows: pd.DataFrame
    has_shares: bool  # whether positions are shares of the image's size, and not pixels
    rows_of_name: Mapping[str, Int[Array, " _"]] | None = None  # by the name of the image
    rows_of_number: Mapping[int, Int[Array, " _"]] | None = None  # by the index of the frame
    times: Float[Array, " K"] | None = None  # of the frames that have rows, increasing, s
    rows_of_time: Sequence[Int[Array, " _"]] = ()

    def find_rows(self, name: str | None, index: int, time: float) -> Int[Array, " _"] | None:
        """Find the rows of a frame.

        Args:
            name: file name of its image; None: it has none.
            index: number of the frame.
            time: of the frame, s.

        Returns:
            Numbers of rows; None: the boxes of the frame are not known. Between the first and the
            last frame with rows, one without rows has no boxes.
        """
        if self.rows_of_name is not None and name is not None:
            return self.rows_of_name.get(strip_zeros(Path(name).stem))
        if self.rows_of_number is not None:
            return self.rows_of_number.get(index)
        if self.times is None or not len(self.times):
            return None
        nearest = int(np.abs(self.times - time).argmin())
        gaps = np.diff(self.times)
        usual = float(np.median(gaps)) if len(gaps) else MAX_TIME_OFFSET_S
        if abs(self.times[nearest] - time) <= min(usual / 2 * (1 + 1e-6), MAX_TIME_OFFSET_S):
            return self.rows_of_time[nearest]
        inside = self.times[0] < time < self.times[-1]
        return np.empty(0, int) if inside else None


def strip_zeros(stem: str) -> str:
    """Strip leading zeros of a file's stem, so that 000123 is 123 and 000 is 0."""
    return stem.lstrip("0") or "0"


def make_named_table(
    rows: pd.DataFrame,
    names: Iterable[str],
    numbers: Mapping[str, int] | None,
    *,
    has_shares: bool = False,
) -> BoxTable:
    """Make a table whose rows have the names of frames.

    Args:
        rows: a row for each box, with the column `name`.
        names: of all frames, with boxes or without.
        numbers: the index of the frame of each name; None where names tell none.
        has_shares: whether positions are shares of the image's size.

    Returns:
        The table.
    """
    rows = _complete(rows)
    known = {strip_zeros(name): np.empty(0, int) for name in names}
    known |= _find_groups(rows["name"].map(strip_zeros))
    by_number = {number: known[strip_zeros(name)] for name, number in (numbers or {}).items()}
    return BoxTable(rows, has_shares, known, by_number or None)


def make_numbered_table(
    rows: pd.DataFrame, rate: float | None, video: Video | None, source: Path, usual: int | None
) -> BoxTable:
    """Make a table of rows with a column `frame`.

    Args:
        rows: a row for each box.
        rate: frames per second by which numbers count as times; None: they number the frames.
        video: as in `find_first`.
        source: as there.
        usual: as there.

    Returns:
        The table.
    """
    rows = rows.assign(frame=rows["frame"].round().astype(int))
    if rate is not None:
        first = usual if usual and rows["frame"].min() > 0 else 0
        return make_timed_table(rows.assign(time=(rows["frame"] - first) / rate))
    first = find_first(set(rows["frame"]), video, source, usual=usual)
    rows = _complete(rows.assign(frame=rows["frame"] - first))
    known = {number: np.empty(0, int) for number in range(rows["frame"].min(), rows["frame"].max())}
    groups = {int(name): found for name, found in _find_groups(rows["frame"].map(str)).items()}
    return BoxTable(rows, False, None, known | groups)


def make_timed_table(rows: pd.DataFrame) -> BoxTable:
    """Make a table of rows with a column `time` (s); the boxes of a frame are the nearest ones."""
    rows = _complete(rows)
    times, place = np.unique(rows["time"].to_numpy(np.float64), return_inverse=True)
    order = np.argsort(place, kind="stable")
    parts = np.split(order, np.searchsorted(place[order], np.arange(1, len(times))))
    return BoxTable(rows, False, times=times, rows_of_time=parts)


def _find_groups(names: "pd.Series[str]") -> dict[str, Int[Array, " _"]]:
    """Find the rows of each name."""
    indices = names.reset_index(drop=True).groupby(names.to_numpy()).indices
    return {str(name): np.asarray(rows, int) for name, rows in indices.items()}


def _complete(rows: pd.DataFrame) -> pd.DataFrame:
    """Complete columns that a format lacks."""
    rows = rows.reset_index(drop=True)
    for name, value in DEFAULTS.items():
        if name not in rows:
            rows[name] = value
    return rows
