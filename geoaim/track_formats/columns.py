"""Columns that all formats share: required columns, numbers, agent types and sizes."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import TracksError

if TYPE_CHECKING:
    from pandas import DataFrame, Series

# names of agent types in datasets -> ours; all others are only written in lower case
AGENT_TYPES = {
    "bicycle": "cyclist",
    "bicyclist": "cyclist",
    "biker": "cyclist",
    "truck_bus": "truck",
}
# length and width in metres of agents whose size a file does not give
TYPICAL_SIZES = {
    "car": (4.5, 1.8),
    "van": (5.5, 2.0),
    "truck": (8.0, 2.5),
    "bus": (12.0, 2.5),
    "motorcycle": (2.1, 0.8),
    "cyclist": (1.8, 0.65),
}
OTHER_SIZE = (0.5, 0.5)


def map_types(names: "Series[Any]") -> "Series[Any]":
    """Map a dataset's names of agent types to ours."""
    lower = names.str.lower()
    return lower.map(AGENT_TYPES).fillna(lower)


def check_columns(
    path: str | os.PathLike[str],
    table: "DataFrame",
    *,
    numbers: tuple[str, ...],
    others: tuple[str, ...] = (),
) -> None:
    """Refuse a table without rows or columns, or with text where numbers are needed.

    Args:
        path: of the table, for the message.
        table: as it was read.
        numbers: columns that must hold numbers.
        others: columns that must be there.

    Raises:
        TracksError: a column or all rows are missing, or a value is not a number.
    """
    import pandas as pd

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
            text = table[name][pd.to_numeric(table[name], errors="coerce").isna()].iloc[0]
            raise TracksError(f"{Path(path)}: {name} is {text!r} in a row; a number is needed")


def check_resolution(resolution: float) -> None:
    """Refuse metres per pixel that are not positive and finite."""
    if not 0 < resolution < np.inf:
        raise ValueError(f"resolution is {resolution}; a positive number of metres is needed")


def fill_sizes(rows: "DataFrame") -> Float[Array, "m 2"]:
    """Length and width in metres; where a size is 0 or missing, the typical one of the type."""
    typical = np.array([TYPICAL_SIZES.get(name, OTHER_SIZE) for name in rows["type"]])
    sizes = rows[["length", "width"]].to_numpy(np.float64)
    return np.where(np.isnan(sizes) | (sizes == 0), typical.reshape(-1, 2), sizes)
