"""What all formats share: `TrackFormat`, checks of columns, agent types and sizes."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import TracksError, warn
from geoaim.base.limits import MAX_POSITION_M
from geoaim.base.world import ORIGIN_STEP_M
from geoaim.tracks.agent_types import AGENT_TYPES, OTHER_SIZE, TYPICAL_SIZES
from geoaim.tracks.tracks import Tracks

MAX_NUMBER = 1e16  # a greater one is no measured value
MAX_CAR_LENGTH_M = 7.0  # a longer vehicle of no stated kind is a truck
KNOWN_TYPES = {*TYPICAL_SIZES, "pedestrian"}
Matcher = Callable[[Path, str], bool]  # takes a path and its first line; "" for a folder


@dataclass(frozen=True)
class TrackFormat:
    """A file format of tracks, as `read_tracks` needs it."""

    name: str  # usually that of the dataset
    matches: Matcher  # whether a file has this format
    read: Callable[..., Tracks]  # takes a path, and `options` as keywords
    options: tuple[str, ...] = ()  # keywords that `read` takes, of those of `read_tracks`
    required: tuple[str, ...] = ()  # the options without which it cannot read
    rank: int = 0  # of the formats that match a file, the lowest: general ones have higher ranks


def has_columns(*names: str, delimiter: str = ",") -> Matcher:
    """Make a matcher: the first line names all of these columns, among others.

    >>> has_columns("id", "x")(Path("a.csv"), 'time,"id",x,y')
    True
    """

    def matches(path: Path, line: str) -> bool:
        return set(names) <= {name.strip().strip('"') for name in line.split(delimiter)}

    return matches


def has_parquet_columns(*names: str) -> Matcher:
    """Make a matcher: a Parquet file that has all of these columns, among others."""

    def matches(path: Path, line: str) -> bool:
        if path.suffix.lower() != ".parquet":
            return False
        from pyarrow.parquet import read_schema

        try:
            return set(names) <= set(read_schema(path).names)
        except Exception:  # a damaged file, of which the reader says what is wrong
            return False

    return matches


def map_types(path: str | os.PathLike[str], names: "pd.Series[Any]") -> "pd.Series[Any]":
    """Map names of agent types to ours by `AGENT_TYPES`; warn of others and keep them."""
    types = names.str.lower().replace(AGENT_TYPES)
    unknown = sorted(set(types.dropna()) - KNOWN_TYPES)
    if unknown:
        warn(
            f"{Path(path)}: unknown agent types {', '.join(map(repr, unknown))}; they are kept as "
            "types of their own, which count neither as vehicles nor as pedestrians or cyclists, "
            f"and have {OTHER_SIZE[0]} x {OTHER_SIZE[1]} m where the file has no sizes. If one is "
            "another name of a known type, rename it: dataclasses.replace(tracks, types=...)"
        )
    return types


def choose_origin(points: Float[Array, "n 2"]) -> tuple[float, float]:
    """Choose the origin of a plane for points in metres: their mean, rounded to 100 m.

    >>> choose_origin(np.array([[8510.0, -2030.0], [8500.0, -2010.0]]))
    (8500.0, -2000.0)
    """
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return 0.0, 0.0
    middle = np.clip(points.mean(axis=0), -MAX_POSITION_M, MAX_POSITION_M)
    x, y = (np.round(middle / ORIGIN_STEP_M) * ORIGIN_STEP_M + 0.0).tolist()
    return x, y


def name_vehicles(
    types: "pd.Series[Any]", lengths: "pd.Series[float]", *, vehicle: str
) -> "pd.Series[Any]":
    """Replace the type `vehicle` by car, or by truck where longer than `MAX_CAR_LENGTH_M`."""
    kinds = np.where(lengths > MAX_CAR_LENGTH_M, "truck", "car")
    return types.where(types != vehicle, kinds)


def check_columns(
    path: str | os.PathLike[str],
    table: pd.DataFrame,
    *,
    numbers: tuple[str, ...],
    others: tuple[str, ...] = (),
) -> None:
    """Check that a table from `read_table` has rows and columns; missing values pass.

    Raises:
        TracksError: columns or all rows are missing, or a value is not a number.
    """
    missing = [name for name in (*others, *numbers) if name not in table.columns]
    if missing:
        columns = ", ".join(map(str, table.columns[:20]))
        raise TracksError(
            f"{Path(path)} lacks the columns {', '.join(missing)}; it has {columns}. "
            "Does it belong to another dataset?"
        )
    if len(table) == 0:
        raise TracksError(f"{Path(path)} has no rows")
    for name in numbers:
        if not pd.api.types.is_numeric_dtype(table[name]):
            wrong = ~table[name].map(_is_number)
            first = int(wrong.argmax())
            row, value = table.index[first], str(table[name].iloc[first])[:40]
            raise TracksError(f"{Path(path)}: {name} is {value!r} in row {row}; a number is needed")


def _is_number(value: object) -> bool:
    """Whether a value is missing, or a number of less than 16 digits."""
    try:
        return not abs(float(str(value))) >= MAX_NUMBER
    except ValueError:
        return False


def check_resolution(resolution: float) -> None:
    """Raise ValueError for metres per pixel that are not positive and finite."""
    if not 0 < resolution < np.inf:
        raise ValueError(f"resolution is {resolution}; a positive number of metres is needed")


def fill_sizes(rows: pd.DataFrame) -> Float[Array, "m 2"]:
    """Complete the columns length and width (m) of rows by `TYPICAL_SIZES` of the column type."""
    typical = np.array([TYPICAL_SIZES.get(name, OTHER_SIZE) for name in rows["type"]])
    sizes = rows[["length", "width"]].to_numpy(np.float64)
    return np.where(np.isnan(sizes) | (sizes == 0), typical.reshape(-1, 2), sizes)
