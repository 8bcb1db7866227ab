"""Tracks: the states of agents over time.

Speeds and headings that a file does not state are computed in `formats.motion`.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.base.displays import Display
from geoaim.base.world import World, describe_world
from geoaim.tracks.agent_types import get_colour
from geoaim.tracks.dates import add_dates

if TYPE_CHECKING:
    from datetime import datetime

    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes

COLUMNS = ("id", "type", "time", "x", "y", "heading", "speed", "length", "width")
# further columns of tracks that state them
OBSERVED_COLUMNS = ("observed_x", "observed_y", "observed_heading", "observed_speed")
OBSERVED_SIGMA_COLUMN = "observed_speed_sigma"
SEEN_COLUMN = "seen"
UNCERTAINTY_COLUMNS = ("position_sigma", "heading_sigma")
STATED = ("observed", "observed_sigma", "seen", "uncertainty")  # attributes of such tracks
TICKS_PER_S = 1e6  # times that fall on the same tick are one time
MIN_HEADING_SPEED = 0.3  # m/s; slower motion has no usable direction
MAX_STATES = 200_000_000  # agents times steps; more is a broken file, or one that must be cut


@dataclass(frozen=True, eq=False, repr=False)
class Tracks(Display):
    """The states of agents over time, as arrays with a mask of presence.

    Attributes:
        times: (T,) seconds, increasing.
        states: (N, T, 4) x, y (metres in the world; the middle of the agent's box), heading
            (radians, counter-clockwise from +x) and speed (m/s, negative in reverse); NaN while
            the agent is absent.
        present: (N, T) whether the agent is present.
        sizes: (N, 2) length and width of the agents' boxes, metres.
        types: N agent types: "car", "van", "truck", "bus", "motorcycle", "pedestrian", "cyclist";
            others are allowed, and belong to no group of `geoaim.tracks.agent_types`.
        ids: N unique names.
        world: the plane of x and y.
        observed: (N, T, 4) the states as they are known at each time, from the rows until then;
            NaN also where an agent was not yet seen for long enough. The speed is NaN where it is
            not known which end is the front. Predictions start from these.
            None: they are `states`, since the file has headings and speeds.
        seen: (N, T) whether the agent was detected at each time; where it is present and was not,
            the state bridges a gap. None: not stated.
        uncertainty: (N, T, 2) standard deviations of each coordinate of the position (m) and of the
            heading (rad); pi where the heading may be any, pi/2 where it may be the opposite. None:
            not stated.
        observed_sigma: (N, T) standard deviations of the observed speeds, m/s; NaN where these are
            not known. Who uses them says which are sure enough (`geoaim.prediction.sureness`).
            None: not stated.

    Raises:
        ValueError: shapes do not match, times do not increase, a present state is not finite, a
            size is not positive, or two agents have the same id.
    """

    times: Float[Array, "T"]
    states: Float[Array, "N T 4"]
    present: Bool[Array, "N T"]
    sizes: Float[Array, "N 2"]
    types: tuple[str, ...]
    ids: tuple[str, ...]
    world: World
    observed: Float[Array, "N T 4"] | None = field(default_factory=lambda: None)
    seen: Bool[Array, "N T"] | None = field(default_factory=lambda: None)
    uncertainty: Float[Array, "N T 2"] | None = field(default_factory=lambda: None)
    observed_sigma: Float[Array, "N T"] | None = field(default_factory=lambda: None)

    def __post_init__(self) -> None:
        agents, steps = len(self.ids), len(self.times)
        for name, shape in {
            "states": (agents, steps, 4),
            "present": (agents, steps),
            "sizes": (agents, 2),
            "types": (agents,),
        }.items():
            actual = np.shape(getattr(self, name))
            if actual != shape:
                raise ValueError(
                    f"{name} has the shape {actual}; {agents} ids and {steps} times need {shape}"
                )
        if repeated := agents - len(set(self.ids)):
            raise ValueError(f"{repeated} agents have the id of another agent; ids must be unique")
        if not (np.isfinite(self.sizes) & (np.asarray(self.sizes) > 0)).all():
            raise ValueError("a length or width is not a positive number of metres")
        if not (np.diff(self.times) > 0).all() or not np.isfinite(self.times).all():
            raise ValueError("times do not increase; sort the steps and drop repeated ones")
        if np.shape(observed := self.get_observed()) != (agents, steps, 4):
            raise ValueError(f"observed has the shape {observed.shape}; that of states is needed")
        for name, shape in {
            "observed_sigma": (agents, steps),
            "seen": (agents, steps),
            "uncertainty": (agents, steps, 2),
        }.items():
            value = getattr(self, name)
            if value is not None and np.shape(value) != shape:
                raise ValueError(f"{name} has the shape {np.shape(value)}; {shape} is needed")
        if not np.isfinite(self.states[self.present]).all():
            raise ValueError("a state is not finite where its agent is present")

    @classmethod
    def from_rows(
        cls, present: Bool[Array, "N T"], rows: dict[str, Array], **others: Any
    ) -> "Tracks":
        """Make tracks of long recordings, whose dense arrays are made where they are first used.

        Args:
            present: whether each agent is present.
            rows: by the names of the attributes, a row for each present state, by agent and time.
            others: the other attributes.

        Returns:
            The tracks; `get_rows` gives the rows again.

        >>> rows = {"states": np.ones((1, 4))}
        >>> tracks = Tracks.from_rows(np.array([[False, True]]), rows, times=np.arange(2.0))
        >>> tracks.states[0, :, 0]
        array([nan,  1.])
        """
        if not np.isfinite(rows["states"]).all():
            raise ValueError("a state is not finite where its agent is present")
        tracks = object.__new__(cls)
        vars(tracks).update(others, present=present, _rows=dict.fromkeys(STATED) | rows)
        return tracks

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            rows = vars(self).get("_rows", {})
            if name not in rows:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            dense, values = None, rows[name]
            if values is not None:
                absent = np.array(False if values.dtype == bool else np.nan, values.dtype)
                dense = np.full(self.present.shape + values.shape[1:], absent)
                dense[self.present] = values
            vars(self)[name] = dense
            return dense

    def get_rows(self, name: str) -> Any:
        """Get an attribute (N, T) at all present states, by agent and time; None if it has none."""
        rows = vars(self).get("_rows", {})
        if name in rows:
            return rows[name]
        values = getattr(self, name)
        return None if values is None else values[self.present]

    def get_observed(self) -> Float[Array, "N T 4"]:
        """Get the states as they are known at each time, from the rows until then."""
        return self.states if self.observed is None else self.observed

    def to_dataframe(self) -> pd.DataFrame:
        """Make a table with a row for each agent and time at which it is present (`COLUMNS`).

        Tracks that state them have the columns `OBSERVED_COLUMNS`, `OBSERVED_SIGMA_COLUMN`,
        `SEEN_COLUMN` and `UNCERTAINTY_COLUMNS` too.
        """
        return next(self.iterate_dataframes(None))

    @classmethod
    def from_dataframe(
        cls, frame: pd.DataFrame, *, world: World | None = None, frame_rate: float | None = None
    ) -> "Tracks":
        """Make tracks of a table with a row for each agent and time.

        Args:
            frame: the columns `id`, `time` (seconds, or dates), `x` and `y` (the middle, metres)
                are needed. Without `heading` (radians, counter-clockwise from +x) and `speed`
                (m/s), those of the positions are taken; without `type` agents are cars, and trucks
                if they are longer than cars are; without `length` and `width` (metres) they have
                the typical ones of their type. Further columns are those of `to_dataframe`.
            world: the plane of x and y. None: a local plane.
            frame_rate: frames per second, for a table with `frame` in place of `time`.

        Returns:
            The tracks; implausible values are warned of, as by `geoaim.read_tracks`.

        Raises:
            TracksError: a column is missing, or a value is missing, repeated or impossible.

        >>> rows = {"id": [7, 7, 7], "time": [0.0, 0.5, 1.0], "x": [0.0, 4.0, 8.0], "y": 0.0}
        >>> Tracks.from_dataframe(pd.DataFrame(rows)).states[0, 1]
        array([4., 0., 0., 8.])
        """
        # imported by name, since the formats stand above this file
        module = import_module("geoaim.tracks.formats.dataframes")
        tracks: Tracks = module.read_dataframe(frame, world=world, frame_rate=frame_rate)
        return tracks

    def iterate_dataframes(self, size: int | None) -> Iterator[pd.DataFrame]:
        """Make the table of `to_dataframe` in parts of so many rows, since long ones fill memory.

        Args:
            size: rows of each part, but of the last; None: one part of all.

        Yields:
            The parts.
        """
        places = np.flatnonzero(self.present)
        states = self.get_rows("states")
        observed, sigma, seen, uncertainty = (self.get_rows(name) for name in STATED)
        for begin in range(0, max(len(places), 1), size or max(len(places), 1)):
            part = slice(begin, None if size is None else begin + size)
            agent, step = np.unravel_index(places[part], self.present.shape)
            values = np.column_stack([self.times[step], states[part], self.sizes[agent]])
            frame = pd.DataFrame(values, columns=list(COLUMNS[2:]))
            frame.insert(0, "id", np.array(self.ids, object)[agent])
            frame.insert(1, "type", np.array(self.types, object)[agent])
            if observed is not None:
                frame[list(OBSERVED_COLUMNS)] = observed[part]
            if sigma is not None:
                frame[OBSERVED_SIGMA_COLUMN] = sigma[part]
            if seen is not None:
                frame[SEEN_COLUMN] = seen[part].astype(int)
            if uncertainty is not None:
                frame[list(UNCERTAINTY_COLUMNS)] = uncertainty[part]
            yield frame

    def to_geodataframe(self, start: "str | datetime | None" = None) -> "GeoDataFrame":
        """Make a table of geopandas: that of `to_dataframe`, with points in the CRS of the world.

        Args:
            start: the date and time (UTC if it names no zone) at which `time` is 0; it gives the
                column `datetime`. None: the table has no clock time.

        Returns:
            The table; x and y are absolute coordinates.

        Raises:
            ImportError: geopandas is missing; `pip install geopandas` installs it.
        """
        from geopandas import GeoDataFrame, points_from_xy

        frame = self.to_dataframe()
        frame[["x", "y"]] += np.array(self.world.origin)
        if start is not None:
            frame = add_dates(frame, start)
        points = points_from_xy(frame["x"], frame["y"])
        return GeoDataFrame(frame, geometry=points, crs=self.world.crs)

    def summarize(self) -> dict[str, str]:
        """Summarize the agents by type, the times, the extent and the world."""
        positions = self.get_rows("states")[:, :2]
        extent = "none present"
        if len(positions):
            extent = "{:.0f} x {:.0f} m".format(*np.ptp(positions, axis=0))
        return {
            "agents": count_agents(self.types),
            "time": describe_times(self.times),
            "extent": extent,
            "world": describe_world(self.world),
        }

    def _draw(self, axes: "Axes") -> None:
        from geoaim.base.map_axes import draw_lines, move_to_axes

        for kind in dict.fromkeys(self.types):
            rows = [row for row, other in enumerate(self.types) if other == kind]
            lines = [move_to_axes(axes, self.states[row, :, :2], self.world) for row in rows]
            draw_lines(axes, lines, get_colour(kind), label=f"{len(rows)} {kind}")


def count_agents(types: Sequence[str]) -> str:
    """Count agents by type, the most frequent first.

    >>> count_agents(("car", "bus", "car"))
    '3: 2 car, 1 bus'
    """
    counts = Counter(types).most_common()
    return f"{len(types)}: {', '.join(f'{count} {kind}' for kind, count in counts)}"


def describe_times(times: Float[Array, "T"]) -> str:
    """Describe times (s): the first, the last, how many, and how many in a second.

    >>> describe_times(np.arange(0.0, 1.05, 0.1))
    '0 to 1 s, 11 steps, 10 Hz'
    """
    if len(times) < 2:
        return f"{len(times)} steps"
    steps = np.diff(times)
    # the mean, since times are often rounded to milliseconds; without gaps
    rate = 1 / float(steps[steps < 1.5 * np.median(steps)].mean())
    return f"{times[0]:g} to {times[-1]:g} s, {len(times)} steps, {rate:.4g} Hz"


def estimate_heading(
    velocity: Float[Array, "N T 2"], *, min_speed: float = MIN_HEADING_SPEED, causal: bool = False
) -> Float[Array, "N T"]:
    """Estimate headings from velocities (m/s); below `min_speed` they have no usable direction.

    A slow agent keeps the direction of its last motion. Before its first motion it has the
    direction of that motion; an agent that never moves has 0.

    Args:
        velocity: m/s.
        min_speed: m/s.
        causal: whether agents have 0 before their first motion, so that no later step is used.

    Returns:
        Headings, radians.

    >>> estimate_heading(np.array([[[0.0, 2.0], [0.0, 0.0]]])).round(2)
    array([[1.57, 1.57]])
    """
    east, north = velocity[..., 0], velocity[..., 1]
    moving = np.hypot(east, north) > min_speed
    heading = np.where(moving, np.arctan2(north, east), np.nan)
    steps = np.arange(heading.shape[1])
    last = np.maximum.accumulate(np.where(moving, steps, -1), axis=1)
    first = np.zeros_like(last) if causal else np.argmax(moving, axis=1)[:, None]
    filled = np.take_along_axis(heading, np.where(last < 0, first, last), axis=1)
    return np.where(np.isfinite(filled), filled, 0.0)
