"""SQLite files, such as MBTiles and GeoPackages, which may hold programs: views and triggers."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

STEPS = 20_000_000  # of SQLite's machine: about a second; a million rows are counted within it
STEPS_PER_BYTE = 1.0
MAX_INT = 2**31 - 1  # of SQLite


@contextmanager
def open_sqlite(path: str | os.PathLike[str]) -> Iterator[sqlite3.Connection]:
    """Open a file to read, with limits, so that a view in it takes no endless time or memory.

    Raises:
        sqlite3.Error: the file is damaged, or reading it takes more steps than its size explains.
    """
    limit = STEPS + STEPS_PER_BYTE * os.path.getsize(path)
    uri = f"{Path(path).absolute().as_uri()}?mode=ro"
    with closing(sqlite3.connect(uri, uri=True)) as database:
        database.execute("PRAGMA trusted_schema = OFF")
        database.execute("PRAGMA cell_size_check = ON")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 100_000_000)
        # called after that many steps of a statement; what it returns interrupts the statement
        database.set_progress_handler(lambda: 1, int(min(limit, MAX_INT)))
        yield database
