"""Tables with one row for each agent and time -> `Tracks`."""

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.base.errors import TracksError
from geoaim.base.geometry import wrap_angle
from geoaim.base.limits import MAX_GB_VARIABLE, MAX_POSITION_M, MAX_TIME_S, read_memory_limit
from geoaim.base.world import World
from geoaim.tracks.tracks import (
    COLUMNS,
    MAX_STATES,
    OBSERVED_COLUMNS,
    OBSERVED_SIGMA_COLUMN,
    SEEN_COLUMN,
    TICKS_PER_S,
    UNCERTAINTY_COLUMNS,
    Tracks,
)

UNITS = {
    "x": "metres from the origin",
    "y": "metres from the origin",
    "speed": "m/s",
    "length": "metres",
    "width": "metres",
}
MAX_STATES_PER_ROW = 500  # agents times times, for each of the few of them that have a row


def make_tracks(rows: pd.DataFrame, world: World) -> Tracks:
    """Make tracks from a table with one row for each agent and time.

    The columns are those of `COLUMNS`: id, type, time (s), x, y (m), heading (rad, at most 2 pi
    either way), speed (m/s), length, width (m). An agent's type and size are those of its first
    row, and agents are in the order of their first rows. Error messages name a row by its label in
    the table's index, which in tables from `read_table` is the row's number in the file. Observed
    states, and whether and how certainly agents were seen, are read where the table has all of
    their columns (`OBSERVED_COLUMNS`, `OBSERVED_SIGMA_COLUMN`, `SEEN_COLUMN`,
    `UNCERTAINTY_COLUMNS`).

    Raises:
        TracksError: there are no rows, a value is missing or not a number, a heading is not in
            radians, a position is off the Earth, a size is not positive, an agent has two rows at
            one time, or the table is too large.
    """
    values = _read_values(rows)
    heading = values[:, 3]
    heading = np.where(np.abs(heading) < np.pi, heading, wrap_angle(heading))
    ticks = np.rint(values[:, 0] * TICKS_PER_S).astype(np.int64)
    ticks, step = np.unique(ticks, return_inverse=True)
    agent, ids = pd.factorize(rows["id"].astype(str).to_numpy(object))
    first = np.unique(agent, return_index=True)[1]
    # 80 bytes are needed for a state, while tracks are made
    least = read_memory_limit() / 80
    limit = int(min(max(least, MAX_STATES_PER_ROW * len(rows)), MAX_STATES))
    if len(ids) * len(ticks) > limit:
        raise TracksError(
            f"{len(ids)} agents times {len(ticks)} times, of {len(rows)} rows, exceed {limit} "
            f"states; cut the recording, or set the variable {MAX_GB_VARIABLE} to more"
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
        **_spread_further_columns(rows, agent, step, present),
    )


def _spread_further_columns(
    rows: pd.DataFrame, agent: Int[Array, " M"], step: Int[Array, " M"], present: Bool[Array, "N T"]
) -> dict[str, Array]:
    """Spread the columns of observed states, of what was seen and of uncertainty over agents."""
    fields = {}
    for name, columns in {
        "observed": OBSERVED_COLUMNS,
        "observed_sigma": (OBSERVED_SIGMA_COLUMN,),
        "seen": (SEEN_COLUMN,),
        "uncertainty": UNCERTAINTY_COLUMNS,
    }.items():
        if set(columns) <= set(rows.columns):
            numbers = rows[list(columns)].apply(pd.to_numeric, errors="coerce")
            for column in columns:
                wrong = numbers[column].isna() & rows[column].notna()
                _refuse_rows(rows, column, wrong, "is not a number")
            values = np.full((*present.shape, len(columns)), np.nan)
            values[agent, step] = numbers.to_numpy(np.float64)
            fields[name] = values if len(columns) > 1 else values[..., 0]
    if "seen" in fields:
        fields["seen"] = fields["seen"] > 0
    return fields


def _read_values(rows: pd.DataFrame) -> Float[Array, "M 7"]:
    """Read the numeric columns, from time on; refuse values that are missing or impossible."""
    if len(rows) == 0:
        raise TracksError("the table has no rows; one row for each agent and time is needed")
    values = rows[list(COLUMNS[2:])].apply(pd.to_numeric, errors="coerce").astype(np.float64)
    absent = "leave out rows of absent agents, and give the others a full state"
    for name in values:
        _refuse_rows(rows, name, rows[name].isna(), f"is missing; {absent}")
        _refuse_rows(rows, name, ~np.isfinite(values[name]), f"is not a number; {absent}")
    for name in ("id", "type"):
        empty = rows[name].isna() | (rows[name].astype(str) == "")
        _refuse_rows(rows, name, empty, "is missing; give each agent one")
    _refuse_rows(rows, "time", values["time"].abs() > MAX_TIME_S, "is not in seconds")
    over = "is beyond 2 pi radians: is it in degrees, or unwrapped?"
    _refuse_rows(rows, "heading", values["heading"].abs() > 2 * np.pi, over)
    for name, unit in UNITS.items():
        _refuse_rows(rows, name, values[name].abs() > MAX_POSITION_M, f"is not in {unit}")
    for name in ("length", "width"):
        _refuse_rows(rows, name, values[name] <= 0, "is not positive")
    return values.to_numpy()


def _refuse_rows(rows: pd.DataFrame, name: str, wrong: "pd.Series[bool]", problem: str) -> None:
    """Raise TracksError if values of a column are wrong; the index has the rows of the file."""
    if wrong.any():
        first = int(wrong.argmax())
        row, value = rows.index[first], rows[name].iloc[first]
        raise TracksError(f"row {row}: {name} '{value}' {problem} ({wrong.sum()} such rows)")
