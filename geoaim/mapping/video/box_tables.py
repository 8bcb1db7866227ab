"""A table of the boxes of all frames, as files of detections hold them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from numpy import ndarray as Array

CORNERS = ("u0", "v0", "u1", "v1", "u2", "v2", "u3", "v3")
BOX = ("left", "top", "right", "bottom")
DEFAULTS: Mapping[str, float | str] = {"score": np.nan, "class": "", "id": ""}
MAX_TIME_OFFSET_S = 0.5  # of a frame from the boxes that are nearest in time


@dataclass(frozen=True, eq=False)
class BoxTable:
    """The boxes of all frames: a row for each, with `BOX`, score, class, id and maybe `CORNERS`."""

    rows: pd.DataFrame
    has_shares: bool  # whether positions are shares of the image's size, and not pixels
    rows_of_name: Mapping[str, Int[Array, " _"]] | None = None  # by the frame's name or number
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
        if self.rows_of_name is not None:
            stem = Path(name).stem if name else str(index)
            return self.rows_of_name.get(strip_zeros(stem))
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
    rows: pd.DataFrame, names: Iterable[str], *, has_shares: bool = False
) -> BoxTable:
    """Make a table whose rows have the names of frames.

    Args:
        rows: a row for each box, with the column `name`.
        names: of all frames, with boxes or without.
        has_shares: whether positions are shares of the image's size.

    Returns:
        The table.
    """
    rows = _complete(rows)
    known = {strip_zeros(name): np.empty(0, int) for name in names}
    known |= _find_groups(rows["name"].map(strip_zeros))
    return BoxTable(rows, has_shares, known)


def make_numbered_table(rows: pd.DataFrame, rate: float | None) -> BoxTable:
    """Make a table of rows with a column `frame`, from 0; with a rate (Hz) it counts as a time."""
    rows = rows.assign(frame=rows["frame"].round().astype(int))
    if rate is not None:
        return make_timed_table(rows.assign(time=rows["frame"] / rate))
    rows = _complete(rows)
    numbers = range(int(rows["frame"].min()), int(rows["frame"].max()) + 1)
    known = {str(number): np.empty(0, int) for number in numbers}
    return BoxTable(rows, False, known | _find_groups(rows["frame"].map(str)))


def make_timed_table(rows: pd.DataFrame) -> BoxTable:
    """Make a table of rows with a column `time` (s); the boxes of a frame are the nearest ones."""
    rows = _complete(rows)
    times, place = np.unique(rows["time"].to_numpy(np.float64), return_inverse=True)
    order = np.argsort(place, kind="stable")
    parts = np.split(order, np.searchsorted(place[order], np.arange(1, len(times))))
    return BoxTable(rows, False, None, times, parts)


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
