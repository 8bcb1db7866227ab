"""Traffic lights: their stop lines, and their states over time.

The plain table has a row for each change; a light keeps its state until its next change:

    time,signal,state
    0.0,east,green
    24.5,east,yellow

SinD's tables (github.com/SOTIF-AVLab/SinD) have a row for each time at which any light changes and
a column for each light, whose name is that of the signal.
"""

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from jaxtyping import Float, Int8
from numpy import ndarray as Array

from geoaim.base.displays import Display
from geoaim.base.errors import MapError, TracksError
from geoaim.base.geojson import read_features
from geoaim.base.limits import MAX_TIME_S, name_file, open_text
from geoaim.base.world import World, describe_world

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GREEN, YELLOW, RED = 0, 1, 2
STATES = ("green", "yellow", "red")
UNKNOWN = -1
STOP_LINE_COLOUR = "#d00000"
COLUMNS = ["time", "signal", "state"]
MIN_STOP_LINE_M = 0.1  # degrees mistaken for metres are shorter
SIND_TIME = "timestamp(ms)"
SIND_STATES = {"0": "red", "1": "green", "3": "yellow"}


@dataclass(frozen=True, eq=False)
class StopLine:
    """A line at which a signal stops traffic; a signal may have several."""

    signal: str  # its name, as in `Lights`
    ends: Float[Array, "2 2"]  # both ends, metres in the world


@dataclass(frozen=True, eq=False, repr=False)
class Lights(Display):
    """Traffic lights: L stop lines and their states over time.

    Attributes:
        names: L names of signals; a signal with several stop lines comes several times.
        lines: (L, 2, 2) both ends of each stop line, metres in the world.
        times: (K,) seconds at which states begin, increasing.
        states: (K, L) `GREEN`, `YELLOW`, `RED` or `UNKNOWN`, from each of the times until the
            next one.
        world: the plane of the lines.
    """

    names: tuple[str, ...]
    lines: Float[Array, "L 2 2"]
    times: Float[Array, "K"]
    states: Int8[Array, "K L"]
    world: World

    def summarize(self) -> dict[str, str]:
        """Summarize the signals, the times of their changes and the world."""
        return {
            "signals": ", ".join(dict.fromkeys(self.names)),
            "stop lines": str(len(self.lines)),
            "states": f"{len(self.times)} changes, {self.times[0]:g} to {self.times[-1]:g} s",
            "world": describe_world(self.world),
        }

    def _draw(self, axes: "Axes") -> None:
        from geoaim.base.map_axes import draw_lines, label_place, move_to_axes

        axes.margins(0.1)
        lines = move_to_axes(axes, self.lines, self.world)
        draw_lines(axes, lines, STOP_LINE_COLOUR, width=2.5, label="stop lines of lights")
        for name, line in zip(self.names, lines, strict=True):
            label_place(axes, name, line.mean(axis=0))


def find_light_states(lights: Lights, times: Float[Array, "T"]) -> Int8[Array, "T L"]:
    """Find the state of each light at each time (s); `UNKNOWN` before its first one."""
    last = np.searchsorted(lights.times, np.asarray(times), side="right") - 1
    states = lights.states[np.maximum(last, 0)]
    return np.where(last[:, None] < 0, UNKNOWN, states).astype(np.int8)


def read_stop_lines(path: str | os.PathLike[str], world: World) -> tuple[StopLine, ...]:
    """Read stop lines drawn by hand in GeoJSON: lines with the property `signal`, its name.

    The file is in longitude and latitude, or in metres for a world without a CRS. Of a line with
    bends, only the two ends are used.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: the file is not GeoJSON, has no line with a signal, or one without a length.
    """
    features = read_features(path, world)
    lines = [
        (str(feature.properties["signal"]), line)
        for feature in features
        for line in getattr(feature.geometry, "geoms", [feature.geometry])
        if line.geom_type == "LineString" and feature.properties.get("signal") is not None
    ]
    if not lines:
        kinds = sorted({feature.geometry.geom_type for feature in features})
        raise MapError(
            f"{path} holds {', '.join(kinds) or 'nothing'}; a LineString with the property "
            "'signal' is needed"
        )
    short = [signal for signal, line in lines if not line.length > MIN_STOP_LINE_M]
    if short:
        unit = "metres" if world.crs is None else "longitude and latitude"
        raise MapError(
            f"{path}: a line of signal {short[0]!r} is shorter than {MIN_STOP_LINE_M} m; its "
            f"coordinates are taken for {unit}"
        )
    return tuple(StopLine(signal, np.array(line.coords)[[0, -1], :2]) for signal, line in lines)


def read_lights(path: str | os.PathLike[str], lines: Sequence[StopLine], world: World) -> Lights:
    """Read states of traffic lights from a plain table, or one of SinD.

    Args:
        path: a CSV file with the columns time (s), signal and state, or a table of SinD with
            times in milliseconds.
        lines: stop lines of the signals, from `read_stop_lines` or `HDMap.stop_lines`; signals of
            the table without a line are left out.
        world: the plane of the lines.

    Returns:
        The lights, in the order in which the table first names their signals. Before its first
        row a light is `UNKNOWN`.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file is not such a table, a state is not one of `STATES`, a signal has
            two states at one time, or no signal has a stop line.
    """
    rows = read_light_changes(path)
    signals = list(dict.fromkeys(rows["signal"]))
    used = [line for signal in signals for line in lines if line.signal == signal]
    if not used:
        example = str(signals[0]) if signals else "east"
        raise TracksError(
            f"{path}: none of the signals {', '.join(map(str, signals))} has a stop line; "
            f"{_describe_lines(lines)}. Draw a line for each signal in GeoJSON, with the property "
            f"'signal' such as {example!r}, and give that as stop lines (--stop-lines)"
        )
    rows = rows.drop_duplicates().assign(state=rows["state"].map(STATES.index))
    states = rows.pivot(index="time", columns="signal", values="state").ffill().fillna(UNKNOWN)
    names = tuple(line.signal for line in used)
    return Lights(
        names=names,
        lines=np.array([line.ends for line in used], np.float64),
        times=states.index.to_numpy(np.float64),
        states=states[list(names)].to_numpy(np.int8),
        world=world,
    )


def _describe_lines(lines: Sequence[StopLine]) -> str:
    """Describe which stop lines there are, and where."""
    if not lines:
        return "no stop lines were given"
    places = [(line.signal, *line.ends.mean(axis=0)) for line in lines[:8]]
    named = ", ".join(f"{name} at ({x:.0f}, {y:.0f}) m" for name, x, y in places)
    return f"stop lines were given of {named}{', ...' if len(lines) > len(places) else ''}"


def read_light_changes(path: str | os.PathLike[str]) -> pd.DataFrame:
    """Read the changes of lights, without their places: the columns time (s), signal and state.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: as in `read_lights`.
    """
    path = Path(path)
    with name_file(path):
        rows = _read_rows(path)
    _check_rows(path, rows)
    return rows


def _check_rows(path: Path, rows: pd.DataFrame) -> None:
    """Refuse unknown states, missing times, and two states of a signal at one time."""
    possible = np.abs(rows["time"].to_numpy(np.float64)) <= MAX_TIME_S
    invalid = ~rows["state"].isin(STATES).to_numpy() | ~possible
    if invalid.any():
        row = rows.iloc[int(invalid.argmax())].to_dict()
        raise TracksError(
            f"{path}: {invalid.sum()} rows have no time in seconds or a state other than "
            f"{', '.join(STATES)}; the first is {row}"
        )
    unique = rows.drop_duplicates()
    repeated = unique[unique.duplicated(["time", "signal"], keep=False)]
    if len(repeated):
        first = repeated.sort_values(["time", "signal"])[:2].to_dict("records")
        raise TracksError(f"{path}: a signal has two states at one time: {first}; keep one")


def _read_rows(path: Path) -> pd.DataFrame:
    """Read the table's `COLUMNS` from either format; a time that is not a number is NaN."""
    try:
        with warnings.catch_warnings():  # a row may end in a comma, but not in an extra field
            warnings.simplefilter("error", pd.errors.ParserWarning)
            with open_text(path, TracksError) as file:
                rows = pd.read_csv(  # a signal may be called NA
                    file, dtype=str, index_col=False, keep_default_na=False, na_values=[""]
                )
    except (ValueError, pd.errors.ParserWarning, IsADirectoryError) as error:
        raise TracksError(f"{path} is not a table of traffic lights: {error}") from error
    lights = [name for name in rows.columns if "traffic light" in name.lower()]
    if SIND_TIME in rows.columns and lights:
        rows["time"] = pd.to_numeric(rows[SIND_TIME], errors="coerce") / 1000
        rows = rows.melt("time", lights, "signal", "state").dropna(subset="state")
        rows["state"] = rows["state"].replace(SIND_STATES)
    if not set(COLUMNS) <= set(rows.columns):
        raise TracksError(
            f"{path} has the columns {', '.join(rows.columns)}; {', '.join(COLUMNS)} are needed, "
            f"or SinD's {SIND_TIME} and lights; docs/formats/lights.md makes them of KIT's phases"
        )
    return rows[COLUMNS].assign(time=pd.to_numeric(rows["time"], errors="coerce"))
