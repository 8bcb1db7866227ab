"""Tracks: agents over time, and the plain file format for them.

The plain format is a CSV or Parquet table with a row for each agent and time:

    # crs: EPSG:32635
    # origin: 583000 6062000
    id,type,time,x,y,heading,speed,length,width
    17,car,0.1,182.103,233.870,1.5011,8.21,4.53,1.84

Time in seconds; x and y in metres from the origin in the CRS, x east and y north; heading in
radians counter-clockwise from +x; speed in m/s, negative in reverse; length and width in metres.
`# crs: local` is a plane of its own. In Parquet files both lines stand in the metadata
`geoaim_world`.
"""

import json
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.errors import TracksError
from geoaim.files import atomic_write
from geoaim.geometry import wrap_angle
from geoaim.world import World

if TYPE_CHECKING:
    from pandas import DataFrame

COLUMNS = ("id", "type", "time", "x", "y", "heading", "speed", "length", "width")
DECIMALS = (3, 3, 3, 4, 3, 2, 2)  # of the numbers from time on, in CSV
LOCAL = "local"
METADATA = b"geoaim_world"
ABSENT = ["", "nan", "NaN", "NA", "null"]
TICKS = 1e6  # a second; times that are closer are one
LATEST = 1e11  # s; later is no time in seconds
MOST = 200_000_000  # agents times steps: more is a broken file, or one to be cut


@dataclass(frozen=True, eq=False)
class Tracks:
    """Agents over time, as arrays with a mask of presence.

    Attributes:
        times: (T,) seconds, increasing.
        states: (N, T, 4) x, y (metres in the world), heading (radians, counter-clockwise from
            +x), and the speed of that point (m/s, negative in reverse); NaN while absent.
        present: (N, T) whether the agent is there.
        sizes: (N, 2) length and width of the agents' boxes, whose middle x and y are, metres.
        types: what each agent is: "car", "van", "truck", "bus", "pedestrian", "cyclist", ...
        ids: a name for each agent.
        world: the plane that the metres lie in.

    Raises:
        ValueError: shapes do not match, times do not increase, a present state is not finite, a
            size is not positive, two agents have one name.
    """

    times: Float[Array, "T"]
    states: Float[Array, "N T 4"]
    present: Bool[Array, "N T"]
    sizes: Float[Array, "N 2"]
    types: tuple[str, ...]
    ids: tuple[str, ...]
    world: World

    def __post_init__(self) -> None:
        agents, steps = len(self.ids), len(self.times)
        wanted = {
            "states": (agents, steps, 4),
            "present": (agents, steps),
            "sizes": (agents, 2),
            "types": (agents,),
        }
        for name, shape in wanted.items():
            found = np.shape(getattr(self, name))
            if found != shape:
                raise ValueError(
                    f"{name} has the shape {found}; {agents} ids and {steps} times need {shape}"
                )
        if len(set(self.ids)) < agents:
            raise ValueError(f"{agents - len(set(self.ids))} agents have the name of another")
        if not (np.isfinite(self.sizes) & (np.asarray(self.sizes) > 0)).all():
            raise ValueError("a length or width is not a positive number of metres")
        if not (np.diff(self.times) > 0).all() or not np.isfinite(self.times).all():
            raise ValueError("times do not increase; sort the steps and drop repeated ones")
        if not np.isfinite(self.states[self.present]).all():
            raise ValueError("a state is not finite where its agent is present")

    def to_frame(self) -> "DataFrame":
        """One row for each agent and time at which it is present; columns are `COLUMNS`."""
        import pandas as pd

        agent, step = np.nonzero(self.present)
        columns = {
            "id": np.array(self.ids, object)[agent],
            "type": np.array(self.types, object)[agent],
            "time": self.times[step],
        }
        values = np.column_stack([self.states[agent, step], self.sizes[agent]])
        columns |= {name: values[:, k] for k, name in enumerate(COLUMNS[3:])}
        return pd.DataFrame(columns)


def write_tracks(tracks: Tracks, path: str | os.PathLike[str]) -> None:
    """Write tracks in the plain format, as .csv (to the millimetre) or .parquet (exactly).

    Times are kept to the millisecond and to the microsecond.

    Raises:
        ValueError: the name ends otherwise, nobody is present, or times are too close for the form.
    """
    path = Path(path)
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise ValueError(f"{path}: the name must end in .csv or .parquet")
    if not tracks.present.any():
        raise ValueError(f"nobody is present in the tracks; {path} would have no rows")
    closest = np.diff(tracks.times).min(initial=np.inf)
    if closest < (1e-3 if path.suffix.lower() == ".csv" else 1 / TICKS):
        raise ValueError(f"{path}: times are {closest:.1g} s apart, too close for the form")
    frame, world = tracks.to_frame(), tracks.world
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".parquet":
            _write_parquet(frame, world, temporary)
            return
        with open(temporary, "w", encoding="utf-8", newline="") as file:
            file.write(format_world(world))
            for name, decimals in zip(COLUMNS[2:], DECIMALS, strict=True):
                frame[name] = frame[name].round(decimals) + 0.0  # no minus zero
            frame.to_csv(file, index=False, lineterminator="\n")


def format_world(world: World) -> str:
    """The first lines of a table of places: its CRS and origin."""
    east, north = map(float, world.origin)
    crs = " ".join((world.crs or LOCAL).split())  # WKT may have lines
    return f"# crs: {crs}\n# origin: {east!r} {north!r}\n"


def read_tracks(path: str | os.PathLike[str]) -> Tracks:
    """Read tracks in the plain format.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: it is not in the plain format; the message says what was found.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        frame, world = (_read_parquet if path.suffix.lower() == ".parquet" else _read_csv)(path)
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise TracksError(f"{path} is no table of tracks: {error}") from error
    missing = [name for name in COLUMNS if name not in frame.columns]
    if missing:
        found = ", ".join(map(str, frame.columns))
        raise TracksError(f"{path} lacks the columns {', '.join(missing)}; it has {found}")
    return make_tracks(frame, world)


def make_tracks(rows: "DataFrame", world: World) -> Tracks:
    """Tracks from one row for each agent and time, with the columns `COLUMNS`.

    An agent's type and size are those of its first row.

    Raises:
        TracksError: there are no rows, a value is missing or no number, a heading is not in
            radians, a size is not positive, an agent is twice at one time, or the table would be
            too large.
    """
    if len(rows) == 0:
        raise TracksError("the table has no rows; a row for each agent and time is needed")
    try:
        values = rows[list(COLUMNS[2:])].to_numpy(np.float64)
    except (ValueError, TypeError) as error:
        raise TracksError(f"a value is no number: {error}") from error
    broken = ~np.isfinite(values).all(axis=1)
    if broken.any():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise TracksError(
            f"{broken.sum()} rows have missing values; the first is {COLUMNS[2 + column]} in row "
            f"{row}. Leave out rows of absent agents, and give each present one a full state"
        )
    for name in ("id", "type"):
        empty = rows[name].isna() | (rows[name].astype(str) == "")
        if empty.any():
            raise TracksError(f"{empty.sum()} rows have no {name}; give each agent one")
    for wrong, what in (
        (np.abs(values[:, 0]) > LATEST, "a time beyond 1e11; seconds are needed"),
        (np.abs(values[:, 3]) > 2 * np.pi, "a heading beyond a full turn; radians are needed"),
        ((values[:, 5:] <= 0).any(axis=1), "a length or width that is not positive"),
    ):
        if wrong.any():
            raise TracksError(f"{wrong.sum()} rows have {what}; the first is row {wrong.argmax()}")
    heading = values[:, 3]
    heading = np.where(np.abs(heading) < np.pi, heading, wrap_angle(heading))
    ticks, step = np.unique(np.rint(values[:, 0] * TICKS).astype(np.int64), return_inverse=True)
    names, first, agent = np.unique(
        rows["id"].astype(str).to_numpy(), return_index=True, return_inverse=True
    )
    order = np.argsort(first)  # ids in the order in which they come
    rank = np.empty(len(names), int)
    rank[order] = np.arange(len(names))
    if len(names) * len(ticks) > MOST:
        raise TracksError(
            f"{len(names)} agents times {len(ticks)} times are too many; cut the recording"
        )
    present = np.zeros((len(names), len(ticks)), bool)
    present[rank[agent], step] = True
    if present.sum() < len(rows):
        raise TracksError(
            f"{len(rows) - present.sum()} rows repeat an agent's time; give each agent its own id"
        )
    states = np.full((*present.shape, 4), np.nan)
    states[rank[agent], step] = values[:, 1:5]
    states[rank[agent], step, 2] = heading
    return Tracks(
        times=ticks / TICKS,
        states=states,
        present=present,
        sizes=values[first[order], 5:],
        types=tuple(rows["type"].astype(str).to_numpy()[first[order]].tolist()),
        ids=tuple(names[order].tolist()),
        world=world,
    )


def estimate_heading(velocity: Float[Array, "N T 2"], *, least: float = 0.3) -> Float[Array, "N T"]:
    """The direction of motion, radians; what is slower than `least` (m/s) keeps its direction.

    Velocities are NaN where an agent is absent. Who never moves gets 0.

    >>> estimate_heading(np.array([[[0.0, 2.0], [0.0, 0.0]]])).round(2)
    array([[1.57, 1.57]])
    """
    east, north = velocity[..., 0], velocity[..., 1]
    known = np.hypot(east, north) > least
    heading = np.where(known, np.arctan2(north, east), np.nan)
    steps = np.arange(heading.shape[1])
    last = np.maximum.accumulate(np.where(known, steps, -1), axis=1)
    first = np.argmax(known, axis=1)[:, None]  # before the first motion, the direction it will have
    filled = np.take_along_axis(heading, np.where(last < 0, first, last), axis=1)
    return np.where(np.isfinite(filled), filled, 0.0)


def _read_csv(path: Path) -> tuple["DataFrame", World]:
    with open(path, encoding="utf-8-sig") as file:
        heads = []
        for line in file:
            if not line.startswith("#"):
                break
            heads.append(line[1:])
    told = {}
    for head in heads:
        name, _, value = head.partition(":")
        told[name.strip()] = value.strip()
    if "crs" not in told:
        raise ValueError("its first line does not say '# crs: EPSG:n' or '# crs: local'")
    origin = [float(word) for word in told.get("origin", "0 0").split()]
    if len(origin) != 2:
        raise ValueError(f"its origin {told['origin']!r} is not two numbers")
    frame = read_table(path, text=("id", "type"), skiprows=len(heads))
    return frame, _world(told["crs"], origin)


def read_table(
    path: str | os.PathLike[str], *, text: tuple[str | int, ...], **options: Any
) -> "DataFrame":
    """`pandas.read_csv`, strict about the number of fields; an agent may be called NA.

    Args:
        path: the file.
        text: columns that are kept as they are written.
        options: of `pandas.read_csv`.

    Raises:
        TracksError: the file is empty, or a row has more fields than there are columns.
    """
    import pandas as pd

    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        try:
            columns = pd.read_csv(path, index_col=False, nrows=1, **options).columns
            return pd.read_csv(
                path,
                index_col=False,
                dtype=dict.fromkeys(set(columns) & set(text), str),
                keep_default_na=False,
                na_values={name: ABSENT for name in columns if name not in text},
                **options,
            )
        except (ValueError, pd.errors.ParserWarning) as error:
            reason = "a row has more fields than there are columns"
            told = reason if isinstance(error, pd.errors.ParserWarning) else str(error).strip()
            raise TracksError(f"{Path(path)} is no table of tracks: {told}") from error


def _read_parquet(path: Path) -> tuple["DataFrame", World]:
    import pyarrow.parquet as parquet

    table = parquet.read_table(path)
    told = (table.schema.metadata or {}).get(METADATA)
    if told is None:
        raise ValueError(f"it has no metadata {METADATA.decode()}")
    place = json.loads(told)
    return table.to_pandas(), _world(place["crs"], place["origin"])


def _write_parquet(frame: "DataFrame", world: World, path: Path) -> None:
    import pyarrow
    import pyarrow.parquet as parquet

    table = pyarrow.Table.from_pandas(frame, preserve_index=False)
    place = json.dumps({"crs": world.crs or LOCAL, "origin": world.origin}).encode()
    table = table.replace_schema_metadata({**(table.schema.metadata or {}), METADATA: place})
    parquet.write_table(table, path)


def _world(crs: str, origin: list[float]) -> World:
    return World(None if crs == LOCAL else crs, (origin[0], origin[1]))
