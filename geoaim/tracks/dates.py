"""Dates of tracks: the column by which QGIS's temporal controller plays them, in UTC."""

import sqlite3
from contextlib import suppress
from datetime import datetime
from pathlib import Path

import pandas as pd

from geoaim.base.limits import open_sqlite

DATES = "datetime"  # the column
EPOCH = "1970-01-01"  # at which `time` is 0, where nobody says when that was


def parse_start(start: str | datetime) -> pd.Timestamp:
    """Parse a date and time, in UTC if it names no zone.

    >>> str(parse_start("2026-06-01 12:00+02:00"))
    '2026-06-01 10:00:00+00:00'
    """
    try:
        return pd.Timestamp(pd.to_datetime(start, utc=True))
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"{start!r} is not a date and time, such as 2026-06-01T12:00:00Z"
        ) from error


def add_dates(rows: pd.DataFrame, start: str | datetime) -> pd.DataFrame:
    """Add the column of dates to rows of tracks, to the microsecond.

    Args:
        rows: with the column `time`, s.
        start: the date and time at which `time` is 0.
    """
    elapsed = pd.to_timedelta((rows["time"] * 1e6).round(), unit="us")
    return rows.assign(**{DATES: (parse_start(start) + elapsed).dt.as_unit("us")})


def read_start(path: Path) -> pd.Timestamp | None:
    """Read when `time` was 0, of a GeoPackage or Parquet file whose rows have dates; else None."""
    rows: list[tuple[float | str, str | datetime | None]] = []
    if path.suffix.lower() == ".gpkg":
        with open_sqlite(path) as database:
            for name in (DATES, "NULL"):
                with suppress(sqlite3.Error):  # no such column
                    rows += database.execute(f"SELECT min(time), {name} FROM states").fetchall()
    elif path.suffix.lower() == ".parquet":
        from pyarrow.parquet import ParquetFile

        file, names = ParquetFile(path), ["time", DATES]
        if set(names) <= set(file.schema_arrow.names):
            first = next(file.iter_batches(1, columns=names)).to_pylist()
            rows = [(row["time"], row[DATES]) for row in first]
    for time, date in rows:
        if isinstance(time, str):  # the column of times has dates
            return parse_start(time)
        if date is not None:
            return parse_start(date) - pd.Timedelta(seconds=time)
    return None
