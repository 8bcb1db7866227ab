"""The plain file format of tracks: a CSV or Parquet table with a row for each agent and time.

    # crs: EPSG:32635
    # origin: 583000 6062000
    # format: 1
    id,type,time,x,y,heading,speed,length,width
    17,car,0.1,182.103,233.870,1.5011,8.21,4.53,1.84

Time in seconds; x and y in metres from the origin in the CRS, x east and y north; heading in
radians counter-clockwise from +x; speed in m/s, negative in reverse; length and width in metres.
Further columns may hold the observed states, whether an agent was seen, and uncertainties
(`geoaim.tracks.tracks`); others are ignored.
`# crs: local` is a local plane without CRS. Parquet files have CRS, origin and format in the
metadata `geoaim_world`, and a checksum. They are GeoParquet too: the column geometry has the
positions in the CRS.
"""

import csv
import json
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from datetime import datetime
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from pyproj import CRS

from geoaim.base.checksums import (
    PLACEHOLDER,
    FileFormat,
    check_version,
    verify_checksum,
    write_checksum,
)
from geoaim.base.csv_rows import trim_comment
from geoaim.base.errors import TracksError
from geoaim.base.files import atomic_write
from geoaim.base.limits import check_memory, open_text, refuse_damaged
from geoaim.base.texts import mark_formulas, unmark_formulas
from geoaim.base.world import (
    LONLAT,
    World,
    choose_world,
    describe_crs_problem,
    parse_crs,
    transform_crs,
    world_from_crs,
)
from geoaim.tracks.dates import EPOCH, add_dates
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import (
    COLUMNS,
    OBSERVED_COLUMNS,
    OBSERVED_SIGMA_COLUMN,
    SEEN_COLUMN,
    TICKS_PER_S,
    UNCERTAINTY_COLUMNS,
    Tracks,
)

PART_ROWS = 10_000  # rows that are written at a time

if TYPE_CHECKING:
    from pyarrow import DataType
    from pyarrow.parquet import ParquetFile

CSV_DECIMALS = dict(zip(COLUMNS[2:], (3, 3, 3, 4, 3, 2, 2), strict=True))
CSV_DECIMALS |= dict(zip(OBSERVED_COLUMNS, (3, 3, 4, 3), strict=True))
CSV_DECIMALS |= dict.fromkeys((OBSERVED_SIGMA_COLUMN, *UNCERTAINTY_COLUMNS), 3)
KNOWN_COLUMNS = (
    *(*COLUMNS, *OBSERVED_COLUMNS, OBSERVED_SIGMA_COLUMN),
    *(SEEN_COLUMN, *UNCERTAINTY_COLUMNS),
)
MIN_CSV_DT_S = 1e-3
LOCAL_CRS = "local"
METADATA_KEY = b"geoaim_world"
GEOMETRY = "geometry"  # column of points in Parquet, which other programs show on a map
CSV = FileFormat("tracks", 1, 1, first_checked=2, error=TracksError)
PARQUET = FileFormat("tracks", 1, 2, first_checked=2, error=TracksError)


def write_tracks(
    tracks: Tracks, path: str | os.PathLike[str], *, start: str | datetime | None = None
) -> None:
    """Write tracks in the plain format, as .csv (to the millimetre) or .parquet (exactly).

    A .parquet file is a GeoParquet too. A name that ends in .gpkg is written as a GeoPackage
    (`geoaim.tracks.formats.write_geopackage`).

    Args:
        tracks: the tracks.
        path: the file.
        start: the date and time (UTC if it names no zone) at which `time` is 0, for a column
            `datetime` in .parquet and .gpkg. None: .parquet has none, .gpkg counts from 1970.

    Raises:
        ValueError: the suffix is another one, no agent is present, or `start` is no date, or is
            given for .csv.
        TracksError: times are closer than a millisecond (CSV) or a microsecond (Parquet).
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".gpkg":  # imported by name, since the formats of others stand above this one
        write_geopackage = import_module("geoaim.tracks.formats.geopackage").write_geopackage
        write_geopackage(tracks, path, start=start or EPOCH)
        return
    if suffix not in (".csv", ".parquet"):
        raise ValueError(f"{path}: the name must end in .csv, .parquet or .gpkg")
    if start is not None and suffix == ".csv":
        raise ValueError(f"{path}: a table has no dates; name a .gpkg or .parquet")
    if not tracks.present.any():
        raise ValueError(f"no agent is present in the tracks; {path} would have no rows")
    dt = np.diff(tracks.times).min(initial=np.inf)
    min_dt = MIN_CSV_DT_S if suffix == ".csv" else 1 / TICKS_PER_S
    if dt < min_dt * (1 - 1e-6):  # times are rounded
        raise TracksError(f"{path}: times are {dt:.1g} s apart; {suffix} needs {min_dt:g} s")
    with atomic_write(path) as temporary:
        if suffix == ".csv":
            _write_csv(tracks, temporary)
        else:
            places = tracks.get_rows("states")[:, :2]
            parts = tracks.iterate_dataframes(PART_ROWS)
            if start is not None:
                parts = (add_dates(part, start) for part in parts)
            _write_parquet(parts, tracks.world, places, temporary)


def read_plain_tracks(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
    """Read tracks in the plain format; `geoaim.read_tracks` reads every known format."""
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    with refuse_damaged(path, TracksError, "a table of tracks"):
        read = _read_parquet if path.suffix.lower() == ".parquet" else _read_csv
        frame, own = read(path, world)
    missing = [name for name in COLUMNS if name not in frame.columns]
    if missing:
        columns = ", ".join(map(str, frame.columns))
        raise TracksError(f"{path} lacks the columns {', '.join(missing)}; it has {columns}")
    with refuse_damaged(path, TracksError, "a table of tracks"):
        return make_tracks(frame, own)


def format_world(world: World) -> str:
    """Format the first two lines of a table of positions: `# crs: ...` and `# origin: ...`."""
    east, north = map(float, world.origin)
    crs = " ".join((world.crs or LOCAL_CRS).split())  # WKT may have line breaks
    return f"# crs: {crs}\n# origin: {east!r} {north!r}\n"


def read_table(
    path: str | os.PathLike[str],
    *,
    text: tuple[str | int, ...],
    delimiter: str = ",",
    header: bool = True,
    skip_rows: int = 0,
) -> pd.DataFrame:
    """Read a text table strictly: each row must have as many fields as there are columns.

    Args:
        path: the file; it may be gzipped.
        text: names or numbers of columns that stay text, so that an agent may be called 007 or NA.
        delimiter: the character between fields.
        header: whether the first row names the columns; without it they are numbered.
        skip_rows: number of lines above the table.

    Returns:
        The table; missing values of the columns that are not text are NaN. Its index is the row in
        the file, counted from 1.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file is empty or unreadable, or a row has more fields than columns.
    """
    options: dict[str, Any] = {
        "index_col": False,
        "sep": delimiter,
        "header": 0 if header else None,
        "skiprows": skip_rows,
    }
    with warnings.catch_warnings(), refuse_damaged(path, TracksError, "a table of tracks"):
        warnings.simplefilter("error", pd.errors.ParserWarning)
        try:
            with open_text(path, TracksError) as file:
                top = pd.read_csv(file, nrows=1, **options)
                texts = {name for name in top.columns if (name.strip() if header else name) in text}
                file.seek(0)
                table = pd.read_csv(
                    file,
                    dtype=dict.fromkeys(texts, str),
                    keep_default_na=False,
                    na_values={
                        name: ["", "nan", "NaN", "NA", "null"]
                        for name in top.columns
                        if name not in texts
                    },
                    low_memory=False,
                    **options,
                )
        except pd.errors.ParserWarning as error:
            raise ValueError("a row has more fields than there are columns") from error
    if header:
        table.columns = table.columns.str.strip()
    table.index += skip_rows + header + 1
    return table


def _read_csv(path: Path, world: World | None) -> tuple[pd.DataFrame, World]:
    with open(path, encoding="utf-8-sig") as file:
        lines = list(takewhile(lambda line: line.startswith(("#", '"#')), file))
    pairs = (trim_comment(line)[1:].partition(":") for line in lines)
    fields = {name.strip(): value.strip() for name, _, value in pairs}
    if "crs" not in fields and world is None:
        raise ValueError(
            "its first line is not '# crs: EPSG:n' or '# crs: local', and no world was given "
            "(--tracks-world 'EPSG:n EAST NORTH')"
        )
    version = fields.get("format", "1")
    known = int(version) if version.isdecimal() else version
    check_version(path, known, CSV, has_checksum=True)  # text may be edited, and has none
    origin = [float(word) for word in fields.get("origin", "0 0").split()]
    if len(origin) != 2:
        raise ValueError(f"its origin {fields['origin']!r} is not two numbers")
    frame = read_table(path, text=("id", "type"), skip_rows=len(lines))
    for name in {"id", "type"} & set(frame.columns):
        frame[name] = unmark_formulas(frame[name].astype(str))
    if "crs" in fields:
        _refuse_other_world(world, stated := _make_world(fields["crs"], origin))
        return frame, stated
    assert world is not None
    return frame, world


def _write_csv(tracks: Tracks, path: Path) -> None:
    has_breaks = any("\r" in text for text in (*tracks.ids, *tracks.types))
    quoting: Literal[0, 2] = csv.QUOTE_NONNUMERIC if has_breaks else csv.QUOTE_MINIMAL
    with open(path, "w", encoding="utf-8", newline="") as file:
        file.write(f"{format_world(tracks.world)}# format: {CSV.newest}\n")
        for number, part in enumerate(tracks.iterate_dataframes(PART_ROWS)):
            frame = part.assign(id=mark_formulas(part["id"]), type=mark_formulas(part["type"]))
            for name, decimals in CSV_DECIMALS.items():
                if name in frame:
                    frame[name] = frame[name].round(decimals) + 0.0  # turns -0.0 into 0.0
            header = number == 0
            frame.to_csv(file, index=False, header=header, lineterminator="\n", quoting=quoting)


def open_parquet(path: str | os.PathLike[str]) -> "ParquetFile":
    """Open a Parquet file of which no table needs far more memory than its size explains."""
    import pyarrow.parquet as parquet

    metadata, size = parquet.read_metadata(path), os.path.getsize(path)
    schema = metadata.schema.to_arrow_schema()
    texts = [field.name for field in schema if _is_text(field.type)]
    # a text once, however often it is told
    file = parquet.ParquetFile(path, metadata=metadata, read_dictionary=texts)
    unpacked = sum(metadata.row_group(i).total_byte_size for i in range(metadata.num_row_groups))
    check_memory(path, unpacked, size, TracksError, f"{unpacked / 1e6:.0f} MB")
    rows, columns = metadata.num_rows, metadata.num_columns
    needed = rows * columns * 40  # bytes of memory for a value of Parquet
    check_memory(path, needed, size, TracksError, f"{rows} rows of {columns} columns")
    return file


def read_columns(
    file: "ParquetFile", path: str | os.PathLike[str], names: Iterable[str]
) -> pd.DataFrame:
    """Read the columns of numbers and texts that a file has of the names, and no others.

    A text is kept once in the file however often a column tells it, so that a small file may need
    any memory: that is counted before.
    """
    import pyarrow
    import pyarrow.compute as compute

    schema = file.schema_arrow
    named = [schema.field(name) for name in names if name in schema.names]
    if nested := [field.name for field in named if pyarrow.types.is_nested(field.type)]:
        raise ValueError(f"its column {nested[0]} holds lists or structures")
    table, needed = file.read([field.name for field in named]), 0
    for index, field in enumerate(named):
        column = table.column(index)
        if pyarrow.types.is_dictionary(column.type):
            for chunk in column.chunks:
                sizes = compute.binary_length(chunk.dictionary)
                needed += compute.sum(sizes.take(chunk.indices)).as_py() or 0
            check_memory(path, needed, os.path.getsize(path), TracksError, "texts")
            values = column.cast(column.type.value_type)
            table = table.set_column(index, field.name, values)
    return table.to_pandas()


def _is_text(kind: "DataType") -> bool:
    from pyarrow import types

    tests = (types.is_string, types.is_large_string, types.is_binary, types.is_large_binary)
    return any(test(kind) for test in tests)


def _refuse_other_world(given: World | None, stated: World) -> None:
    if given is not None and given != stated:
        raise ValueError(
            f"its world is {stated.crs} {stated.origin}, and {given.crs} {given.origin} was given; "
            "omit it"
        )


def _read_geoparquet(
    file: "ParquetFile", path: Path, world: World | None
) -> tuple[pd.DataFrame, World]:
    """Read a GeoParquet of another program: points in its CRS, and the other columns."""
    metadata = file.schema_arrow.metadata or {}
    if b"geo" not in metadata:
        if world is None:
            raise ValueError(
                f"it has no metadata {METADATA_KEY.decode()} or geo, and no world was given "
                "(--tracks-world 'EPSG:n EAST NORTH')"
            )
        return read_columns(file, path, KNOWN_COLUMNS), world
    stated = json.loads(metadata[b"geo"])
    name = stated["primary_column"]
    crs = stated["columns"][name].get("crs", LONLAT)  # the default of GeoParquet
    crs = crs if crs is None or isinstance(crs, str) else CRS.from_json_dict(crs).to_string()
    table = read_columns(file, path, (*KNOWN_COLUMNS, name))
    points = shapely.from_wkb(table.pop(name).to_numpy(object))
    if {shape.geom_type for shape in points} != {"Point"}:
        raise ValueError(f"its column {name} does not hold points only")
    places = np.column_stack([shapely.get_x(points), shapely.get_y(points)])
    return place_rows(table, places, crs, world), world or choose_own_world(places, crs)


def choose_own_world(places: Float[Array, "m 2"], crs: str | None) -> World:
    """Choose the world of positions: in their own CRS if it is metric, else in their UTM zone."""
    if crs is None:
        return World(None)
    east, north = (float(value) for value in places.mean(axis=0))
    metric = not describe_crs_problem(crs, (east, north))
    return choose_world(transform_crs(crs, LONLAT, places), crs=crs if metric else None)


def place_rows(
    rows: pd.DataFrame, places: Float[Array, "m 2"], crs: str | None, world: World | None
) -> pd.DataFrame:
    """Add x and y to rows of tracks."""
    world = world or choose_own_world(places, crs)
    metres = places - world.origin if crs is None else world_from_crs(world, places, crs)
    return rows.assign(x=metres[:, 0], y=metres[:, 1])


def _read_parquet(path: Path, world: World | None) -> tuple[pd.DataFrame, World]:
    has_checksum = verify_checksum(path, PARQUET)
    file = open_parquet(path)
    if METADATA_KEY not in (file.schema_arrow.metadata or {}):
        return _read_geoparquet(file, path, world)
    table = read_columns(file, path, KNOWN_COLUMNS)
    stated = json.loads(file.schema_arrow.metadata[METADATA_KEY])
    check_version(path, stated.get("format", 1), PARQUET, has_checksum=has_checksum)
    own = _make_world(stated["crs"], stated["origin"])
    _refuse_other_world(world, own)
    return table, own


def write_dated_tracks(
    recordings: Mapping[str, tuple[Tracks, datetime]], path: str | os.PathLike[str]
) -> None:
    """Write the tracks of several recordings of one world into one GeoParquet, with their dates.

    An agent's id is RECORDING/ID; `time` counts from the start of the first recording. Observed
    states and uncertainties are left out, since not all recordings may have them.

    Args:
        recordings: tracks and the date and time at which their `time` is 0, by name.
        path: the .parquet file.
    """
    begin = min(start for _, start in recordings.values())

    def iterate_frames() -> Iterator[pd.DataFrame]:
        for name, (tracks, start) in recordings.items():
            for frame in tracks.iterate_dataframes(PART_ROWS):
                frame = add_dates(frame[list(COLUMNS)].assign(recording=name), start)
                frame["id"] = f"{name}/" + frame["id"]
                frame["time"] += (start - begin).total_seconds()
                yield frame

    every = [tracks for tracks, _ in recordings.values()]
    places = np.concatenate([tracks.get_rows("states")[:, :2] for tracks in every])
    with atomic_write(path) as temporary:
        _write_parquet(iterate_frames(), every[0].world, places, temporary)


def _write_parquet(
    frames: Iterable[pd.DataFrame], world: World, places: Float[Array, "m 2"], path: Path
) -> None:
    import pyarrow
    import pyarrow.parquet as parquet

    stated = {"crs": world.crs or LOCAL_CRS, "origin": world.origin, "format": PARQUET.newest}
    metadata = {METADATA_KEY: json.dumps(stated), b"geoaim_checksum": PLACEHOLDER}
    metadata[b"geo"] = json.dumps(_describe_geometry(places, world))
    with ExitStack() as opened:
        writer = None
        for frame in frames:
            table = pyarrow.Table.from_pandas(frame, preserve_index=False)
            points = shapely.to_wkb(shapely.points(frame[["x", "y"]].to_numpy() + world.origin))
            table = table.append_column(GEOMETRY, pyarrow.array(points, pyarrow.binary()))
            if writer is None:
                metadata = {**(table.schema.metadata or {}), **metadata}
                schema = table.schema.with_metadata(metadata)
                writer = opened.enter_context(parquet.ParquetWriter(path, schema))
            writer.write_table(table.replace_schema_metadata(metadata))
    write_checksum(path)


def _describe_geometry(places: Float[Array, "m 2"], world: World) -> dict[str, Any]:
    """The metadata of GeoParquet 1.1.0 (geoparquet.org): what the column of points holds."""
    bounds = np.concatenate([places.min(axis=0), places.max(axis=0)]) + np.tile(world.origin, 2)
    column = {
        "encoding": "WKB",
        "geometry_types": ["Point"],
        "crs": None if world.crs is None else parse_crs(world.crs).to_json_dict(),
        "bbox": bounds.tolist(),
    }
    return {"version": "1.1.0", "primary_column": GEOMETRY, "columns": {GEOMETRY: column}}


def _make_world(crs: str, origin: list[float]) -> World:
    return World(None if crs == LOCAL_CRS else crs, (origin[0], origin[1]))
