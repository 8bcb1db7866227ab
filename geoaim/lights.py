"""Traffic lights: where they stop traffic, and their states over time.

The plain table has a row for each change, and each light keeps its state until its next one:

    time,signal,state
    0.0,east,green
    24.5,east,yellow

SinD's tables (github.com/SOTIF-AVLab/SinD) have a row for each time at which any light changes and
a column for each light; its name there is the signal's.
"""

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int8
from numpy import ndarray as Array

from geoaim.errors import MapError, TracksError
from geoaim.geojson import read_features
from geoaim.world import World

if TYPE_CHECKING:
    import pandas as pd

GREEN, YELLOW, RED = 0, 1, 2
STATES = ("green", "yellow", "red")
UNKNOWN = -1
COLUMNS = ["time", "signal", "state"]
SHORTEST = 0.1  # m of a stop line: degrees taken for metres are shorter
SIND_TIME = "timestamp(ms)"
SIND_LIGHT = "traffic light"
SIND_STATES = {"0": "red", "1": "green", "3": "yellow"}


@dataclass(frozen=True, eq=False)
class StopLine:
    """Where a signal stops traffic: both ends of the line, metres. A signal may have several."""

    signal: str
    ends: Float[Array, "2 2"]


@dataclass(frozen=True, eq=False)
class Lights:
    """Traffic lights.

    Attributes:
        names: of the signals.
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


def find_light_states(lights: Lights, times: Float[Array, "T"]) -> Int8[Array, "T L"]:
    """The state of each light at each time; `UNKNOWN` before the first one is told."""
    last = np.searchsorted(lights.times, np.asarray(times), side="right") - 1
    states = lights.states[np.maximum(last, 0)]
    return np.where(last[:, None] < 0, UNKNOWN, states).astype(np.int8)


def read_stop_lines(path: str | os.PathLike[str], world: World) -> tuple[StopLine, ...]:
    """Read hand-drawn stop lines, GeoJSON: lines with the property `signal`.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: it is no GeoJSON, holds no line with a signal's name, or one without a length.
    """
    features = read_features(path, world)
    named = [
        (str(f.properties["signal"]), line)
        for f in features
        for line in getattr(f.geometry, "geoms", [f.geometry])  # the parts of several lines
        if line.geom_type == "LineString" and f.properties.get("signal") is not None
    ]
    if not named:
        kinds = ", ".join(sorted({f.geometry.geom_type for f in features})) or "nothing"
        raise MapError(f"{path} holds {kinds}; a LineString with the property 'signal' is needed")
    short = [signal for signal, line in named if not line.length > SHORTEST]
    if short:
        raise MapError(
            f"{path}: a line of signal {short[0]!r} is shorter than {SHORTEST} m; its numbers are "
            f"taken for {'metres' if world.crs is None else 'longitude and latitude'}"
        )
    return tuple(StopLine(name, np.array(line.coords)[[0, -1], :2]) for name, line in named)


def read_lights(path: str | os.PathLike[str], lines: Sequence[StopLine], world: World) -> Lights:
    """Read a plain table or one of SinD's, of the signals whose stop lines are given.

    Args:
        path: the table, CSV.
        lines: where the signals stop traffic, metres in the world; signals of the table without a
            line are left out.
        world: the plane of the lines.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: it is no such table, a state is none of `STATES`, a signal has two at one
            time, or no signal has a line.
    """
    path = Path(path)
    rows = _changes(path)
    moments = rows["time"].to_numpy(np.float64)
    strange = ~rows["state"].isin(STATES).to_numpy() | ~np.isfinite(moments)
    if strange.any():
        row = rows.iloc[int(strange.argmax())].to_dict()
        raise TracksError(
            f"{path}: {strange.sum()} rows have no time in seconds or a state other than "
            f"{', '.join(STATES)}; the first is {row}"
        )
    once = rows.drop_duplicates()
    twice = once[once.duplicated(["time", "signal"], keep=False)].sort_values(["time", "signal"])
    if len(twice):
        raise TracksError(
            f"{path}: a signal has two states at one time: {twice[:2].to_dict('records')}; keep one"
        )
    signals = list(dict.fromkeys(rows["signal"]))
    mine = [line for signal in signals for line in lines if line.signal == signal]
    if not mine:
        there = ", ".join(line.signal for line in lines) or "none"
        raise TracksError(
            f"{path}: none of the lights {', '.join(map(str, signals))} has a stop line; there are "
            f"lines of {there}"
        )
    times, step = np.unique(moments, return_inverse=True)
    states = np.full((len(times), len(mine)), UNKNOWN, np.int8)
    for light, line in enumerate(mine):
        its = (rows["signal"] == line.signal).to_numpy()
        states[step[its], light] = [STATES.index(state) for state in rows["state"][its]]
        told = np.maximum.accumulate(np.where(states[:, light] >= 0, np.arange(len(times)), -1))
        states[:, light] = np.where(told >= 0, states[told, light], UNKNOWN)
    ends = np.array([line.ends for line in mine], np.float64)
    return Lights(tuple(line.signal for line in mine), ends, times, states, world)


def _changes(path: Path) -> "pd.DataFrame":
    """The table's `COLUMNS`, whichever form it has; times are NaN that are no numbers."""
    import pandas as pd

    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        with warnings.catch_warnings():  # a row may end in a comma, but not in another field
            warnings.simplefilter("error", pd.errors.ParserWarning)
            rows = pd.read_csv(  # a signal may be called NA
                path, dtype=str, index_col=False, keep_default_na=False, na_values=[""]
            )
    except (ValueError, OSError, pd.errors.ParserWarning) as error:
        raise TracksError(f"{path} is no table of lights: {error}") from error
    lights = [name for name in rows.columns if SIND_LIGHT in name.lower()]
    if SIND_TIME in rows.columns and lights:
        rows["time"] = pd.to_numeric(rows[SIND_TIME], errors="coerce") / 1000
        rows = rows.melt("time", lights, "signal", "state").dropna(subset="state")
        rows["state"] = rows["state"].replace(SIND_STATES)
    if not set(COLUMNS) <= set(rows.columns):
        raise TracksError(
            f"{path} has the columns {', '.join(rows.columns)}; {', '.join(COLUMNS)} are needed, "
            f"or SinD's {SIND_TIME} and lights"
        )
    return rows[COLUMNS].assign(time=pd.to_numeric(rows["time"], errors="coerce"))
