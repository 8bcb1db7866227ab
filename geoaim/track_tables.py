"""Tables with one row for each agent and time -> `Tracks`."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import TracksError
from geoaim.geometry import wrap_angle
from geoaim.tracks import COLUMNS, MAX_STATES, TICKS_PER_S, Tracks
from geoaim.world import World

if TYPE_CHECKING:
    from pandas import DataFrame

MAX_TIME_S = 1e11  # a greater number is not a time in seconds


def make_tracks(rows: "DataFrame", world: World) -> Tracks:
    """Make tracks from a table with the columns `COLUMNS`, one row for each agent and time.

    An agent's type and size are those of its first row, and agents are in the order of their first
    rows.

    Raises:
        TracksError: there are no rows, a value is missing or not a number, a heading is not in
            radians, a size is not positive, an agent has two rows at one time, or the table is
            too large.
    """
    import pandas as pd

    values = _read_values(rows)
    _check_values(rows, values)
    heading = values[:, 3]
    heading = np.where(np.abs(heading) < np.pi, heading, wrap_angle(heading))
    ticks = np.rint(values[:, 0] * TICKS_PER_S).astype(np.int64)
    ticks, step = np.unique(ticks, return_inverse=True)
    agent, ids = pd.factorize(rows["id"].astype(str).to_numpy(object))
    first = np.unique(agent, return_index=True)[1]
    if len(ids) * len(ticks) > MAX_STATES:
        raise TracksError(
            f"{len(ids)} agents times {len(ticks)} times exceed {MAX_STATES} states; "
            "cut the recording"
        )
    present = np.zeros((len(ids), len(ticks)), bool)
    present[agent, step] = True
    if present.sum() < len(rows):
        raise TracksError(
            f"{len(rows) - present.sum()} rows repeat an agent's time; give each agent its own id"
        )
    states = np.full((*present.shape, 4), np.nan)
    states[agent, step] = values[:, 1:5]
    states[agent, step, 2] = heading
    return Tracks(
        times=ticks / TICKS_PER_S,
        states=states,
        present=present,
        sizes=values[first, 5:],
        types=tuple(rows["type"].astype(str).to_numpy()[first].tolist()),
        ids=tuple(ids.tolist()),
        world=world,
    )


def _read_values(rows: "DataFrame") -> Float[Array, "M 7"]:
    """Read the numeric columns, from time on; refuse missing values."""
    if len(rows) == 0:
        raise TracksError("the table has no rows; one row for each agent and time is needed")
    try:
        values = rows[list(COLUMNS[2:])].to_numpy(np.float64)
    except (ValueError, TypeError) as error:
        raise TracksError(f"a value is not a number: {error}") from error
    missing = ~np.isfinite(values)
    if missing.any():
        row, column = np.argwhere(missing)[0]
        raise TracksError(
            f"{missing.any(axis=1).sum()} rows have missing values; the first is "
            f"{COLUMNS[2 + column]} in row {row}. Leave out the rows of absent agents, and give "
            "each present agent a full state"
        )
    return values


def _check_values(rows: "DataFrame", values: Float[Array, "M 7"]) -> None:
    """Refuse rows without a name or type, and numbers in other units."""
    for name in ("id", "type"):
        empty = rows[name].isna() | (rows[name].astype(str) == "")
        if empty.any():
            raise TracksError(f"{empty.sum()} rows have no {name}; give each agent one")
    for wrong, problem in (
        (np.abs(values[:, 0]) > MAX_TIME_S, f"a time beyond {MAX_TIME_S:g}; seconds are needed"),
        (np.abs(values[:, 3]) > 2 * np.pi, "a heading beyond a full turn; radians are needed"),
        ((values[:, 5:] <= 0).any(axis=1), "a length or width that is not positive"),
    ):
        if wrong.any():
            raise TracksError(
                f"{wrong.sum()} rows have {problem}; the first is row {wrong.argmax()}"
            )
