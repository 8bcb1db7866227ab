"""What all forms share: which columns a table has, whether they are numbers, what agents are."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import TracksError

if TYPE_CHECKING:
    from pandas import DataFrame, Series

# our words for what data sets call their agents
TYPES = {
    "bicycle": "cyclist",
    "bicyclist": "cyclist",
    "biker": "cyclist",
    "truck_bus": "truck",
}
# length and width in metres of who is written as a point, and of all others
SIZES = {
    "car": (4.5, 1.8),
    "van": (5.5, 2.0),
    "truck": (8.0, 2.5),
    "bus": (12.0, 2.5),
    "motorcycle": (2.1, 0.8),
    "cyclist": (1.8, 0.65),
}
POINT = (0.5, 0.5)


def types_of(names: "Series[Any]") -> "Series[Any]":
    """What agents are, in our words."""
    lower = names.str.lower()
    return lower.map(TYPES).fillna(lower)


def need_columns(path: str | os.PathLike[str], table: "DataFrame", names: tuple[str, ...]) -> None:
    """Refuse a table that lacks columns."""
    missing = [name for name in names if name not in table.columns]
    if missing:
        found = ", ".join(map(str, table.columns[:20]))
        raise TracksError(
            f"{Path(path)} lacks the columns {', '.join(missing)}; it has {found}. "
            "Is it of another data set?"
        )


def need_numbers(path: str | os.PathLike[str], table: "DataFrame", names: tuple[str, ...]) -> None:
    """Refuse a table that has text, or nothing at all, where numbers are needed."""
    import pandas as pd

    if len(table) == 0:
        raise TracksError(f"{Path(path)} has no rows")
    for name in names:
        if not pd.api.types.is_numeric_dtype(table[name]):
            found = table[name][pd.to_numeric(table[name], errors="coerce").isna()].iloc[0]
            raise TracksError(f"{Path(path)}: {name} is {found!r} in a row; a number is needed")


def sizes_of(rows: "DataFrame") -> Float[Array, "m 2"]:
    """Length and width in metres; what is 0 or missing is what the type usually has."""
    usual = np.array([SIZES.get(kind, POINT) for kind in rows["type"]]).reshape(-1, 2)
    found = rows[["length", "width"]].to_numpy(np.float64)
    return np.where(np.isnan(found) | (found == 0), usual, found)
