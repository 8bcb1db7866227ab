"""Traffic lights: where they stop traffic, and their states over time.

The plain table has a row for each change, and each light keeps its state until its next one:

    time,signal,state
    0.0,east,green
    24.5,east,yellow
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int8
from numpy import ndarray as Array

from geoaim.errors import TracksError
from geoaim.world import World

GREEN, YELLOW, RED = 0, 1, 2
STATES = ("green", "yellow", "red")
UNKNOWN = -1
COLUMNS = ("time", "signal", "state")


@dataclass(frozen=True, eq=False)
class Lights:
    """Traffic lights.

    Attributes:
        names: of the lights.
        lines: (L, 2, 2) both ends of each one's stop line, metres in the world.
        times: (K,) seconds at which states begin, increasing.
        states: (K, L) from each of the times until the next one: `GREEN`, `YELLOW`, `RED`, or
            `UNKNOWN`.
        world: the plane that the metres lie in.
    """

    names: tuple[str, ...]
    lines: Float[Array, "L 2 2"]
    times: Float[Array, "K"]
    states: Int8[Array, "K L"]
    world: World


def states_at(lights: Lights, times: Float[Array, "T"]) -> Int8[Array, "T L"]:
    """The state of each light at each time; `UNKNOWN` before the first one is told."""
    last = np.searchsorted(lights.times, np.asarray(times), side="right") - 1
    states = lights.states[np.maximum(last, 0)]
    return np.where(last[:, None] < 0, UNKNOWN, states).astype(np.int8)


def read_lights(
    path: str | os.PathLike[str], lines: Mapping[str, Float[Array, "2 2"]], world: World
) -> Lights:
    """Read the plain table, of the lights whose stop lines are given.

    Args:
        path: the table of changes, CSV.
        lines: both ends of the stop line of each light by name, metres in the world; lights of
            the table without one are left out.
        world: the plane of the lines.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: it is not such a table, a state is none of `STATES`, or no light has a line.
    """
    import pandas as pd

    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        rows = pd.read_csv(path, dtype={"signal": str, "state": str})
    except (ValueError, OSError) as error:
        raise TracksError(f"{path} is no table of lights: {error}") from error
    if not set(COLUMNS) <= set(rows.columns):
        raise TracksError(f"{path} has the columns {', '.join(rows.columns)}; {COLUMNS} are needed")
    moments = pd.to_numeric(rows["time"], errors="coerce").to_numpy(np.float64)
    strange = ~rows["state"].isin(STATES).to_numpy() | ~np.isfinite(moments)
    if strange.any():
        row = rows.iloc[int(strange.argmax())].to_dict()
        raise TracksError(
            f"{path}: {strange.sum()} rows have no time in seconds or a state other than "
            f"{', '.join(STATES)}; the first is {row}"
        )
    names = tuple(name for name in pd.unique(rows["signal"]) if name in lines)
    if not names:
        raise TracksError(
            f"{path}: none of the lights {', '.join(map(str, pd.unique(rows['signal'])))} has a "
            f"stop line; there are lines of {', '.join(lines) or 'none'}"
        )
    times, step = np.unique(moments, return_inverse=True)
    states = np.full((len(times), len(names)), UNKNOWN, np.int8)
    for light, name in enumerate(names):
        mine = (rows["signal"] == name).to_numpy()
        states[step[mine], light] = [STATES.index(state) for state in rows["state"][mine]]
        told = np.maximum.accumulate(np.where(states[:, light] >= 0, np.arange(len(times)), -1))
        states[:, light] = np.where(told >= 0, states[told, light], UNKNOWN)
    ends = np.array([lines[name] for name in names], np.float64)
    return Lights(names, ends, times, states, world)
