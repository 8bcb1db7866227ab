"""Refuse files that are damaged or would need too much memory, with a one-line error."""

import gzip
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TextIO, cast

from geoaim.base.errors import GeoaimError
from geoaim.base.texts import show_text

MAX_GB_VARIABLE = "GEOAIM_MAX_GB"  # environment variable
# bytes in memory per byte of the file at most; images of one colour compress this well
MAX_RATIO = 300
MAX_POSITION_M = 1e8  # distance from the origin; the Earth's circumference is 4e7 m
MAX_TIME_S = 1e11  # a greater number is not a time in seconds
MAX_RECORDING_S = 864_000.0  # ten days; a video whose frames are further apart is damaged


class SettingError(ValueError):
    """An environment variable is not what is needed; no file is at fault."""


def read_memory_limit() -> float:
    """Read how many bytes may be allocated even for a small file: 1e9 times `GEOAIM_MAX_GB`.

    Raises:
        SettingError: that environment variable is not a number.
    """
    text = os.environ.get(MAX_GB_VARIABLE, "1.0")
    try:
        return float(text) * 1e9
    except ValueError:
        raise SettingError(f"{MAX_GB_VARIABLE} is {text!r}; a number of GB is needed") from None


def check_memory(
    path: str | os.PathLike[str],
    needed: float,
    size: float,
    error_type: type[GeoaimError],
    content: str,
) -> None:
    """Check that a file of a size (bytes) does not need far more memory (bytes) than that explains.

    `content` is what its header states, such as "60000 x 60000 pixels".

    Raises:
        GeoaimError: it needs more than both `read_memory_limit` and `MAX_RATIO` times its size.
    """
    if needed > max(read_memory_limit(), MAX_RATIO * size):
        raise error_type(
            f"{path} has {size / 1e3:.0f} KB and claims {content}, which need {needed / 1e9:.1f} "
            f"GB of memory; if that is right, set the variable {MAX_GB_VARIABLE} to more"
        )


@contextmanager
def open_text(path: str | os.PathLike[str], error_type: type[GeoaimError]) -> Iterator[TextIO]:
    """Open a table of text, unpacked if its name ends in .gz.

    Libraries that are given a path take it for an address, and unpack without a limit.

    Raises:
        GeoaimError: unpacked it is far larger than its size explains; the type is `error_type`.
    """
    if str(path).lower().endswith(".gz"):
        size, unpacked = os.path.getsize(path), 0
        with gzip.open(path) as packed:
            while part := packed.read(2**20):
                unpacked += len(part)
                needed = unpacked * 5  # bytes of memory for a character in a table
                check_memory(
                    path, needed, size, error_type, f"over {unpacked / 1e6:.0f} MB of text"
                )
        with gzip.open(path, "rt", encoding="utf-8-sig", newline="") as file:
            yield cast(TextIO, file)
    else:
        with open(path, encoding="utf-8-sig", newline="") as file:
            yield file


def check_regular(path: str | os.PathLike[str], error_type: type[GeoaimError]) -> None:
    """Raise `error_type` for pipes and devices, which can be read only once."""
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        raise error_type(f"{path} is a pipe or a device, which is read once; save it as a file")


@contextmanager
def name_file(path: str | os.PathLike[str]) -> Iterator[None]:
    """Make the message of a `GeoaimError` in the block one line that names the file."""
    try:
        yield
    except GeoaimError as error:
        line = " ".join(str(error).split())
        if show_text(os.path.basename(path)) not in line:
            line = f"{path}: {line}"
        raise type(error)(line) from error


@contextmanager
def refuse_damaged(
    path: str | os.PathLike[str],
    error_type: type[GeoaimError],
    needed: str,
    *,
    reads_once: bool = False,
) -> Iterator[None]:
    """Turn whatever a library raises on a file's content into an `error_type` that names the file.

    `needed` is what the file should be, such as "a GeoTIFF"; with `reads_once` it may be a pipe. A
    GeoaimError, a warning, and an error about a setting, another file, or a missing or forbidden
    one stay so.
    """
    if os.path.isdir(path):
        raise error_type(f"{path} is a folder; {needed} is needed")
    if not reads_once:
        check_regular(path, error_type)
    try:
        with name_file(path):
            yield
    except (GeoaimError, SettingError, Warning, FileNotFoundError, PermissionError):
        raise
    except Exception as error:  # parsers raise errors of their own, and of every kind
        named = getattr(error, "filename", None)
        if isinstance(error, OSError) and named and str(named) != str(path):
            raise  # such as a full disk for what is written meanwhile
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        raise error_type(f"{path} is not {needed}, or is damaged ({reason})") from error


def is_writable_beside(path: str | os.PathLike[str]) -> bool:
    """Whether files can be made beside a file, as SQLite does to read one of mode WAL."""
    return os.access(Path(path).absolute().parent, os.W_OK)


STEPS = 20_000_000  # of SQLite's machine: about a second; a million rows are counted within it


@contextmanager
def open_sqlite(path: str | os.PathLike[str]) -> Iterator[sqlite3.Connection]:
    """Open a file to read, with limits, so that a view in it takes no endless time or memory.

    Raises:
        sqlite3.Error: the file is damaged, or reading it takes more steps than its size explains.
        GeoaimError: changes beside it cannot be read, since its folder cannot be written to.
    """
    limit = STEPS + os.path.getsize(path)
    uri = f"{Path(path).absolute().as_uri()}?mode=ro"
    if not is_writable_beside(path):
        uri += "&immutable=1"
        for rest in (f"{path}-wal", f"{path}-journal"):
            if os.path.exists(rest) and os.path.getsize(rest):
                raise GeoaimError(
                    f"{rest} holds changes that are not in {Path(path).name} yet: copy both to a "
                    "folder that can be written to"
                )
    with closing(sqlite3.connect(uri, uri=True)) as database:
        database.execute("PRAGMA trusted_schema = OFF")
        database.execute("PRAGMA cell_size_check = ON")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 100_000_000)
        # called after that many steps of a statement; what it returns interrupts the statement
        database.set_progress_handler(lambda: 1, int(min(limit, 2**31 - 1)))  # its int
        yield database
