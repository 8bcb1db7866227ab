"""Where the shared real data lie; none of them is part of the project."""

import os
from pathlib import Path

from geoaim.errors import TracksError


def data_folder() -> Path | None:
    """The folder of real data: $GEOAIM_DATA, else ../shared/data beside the repository.

    None where there is none, so that a test can skip and a benchmark can say what it misses.

    Raises:
        FileNotFoundError: GEOAIM_DATA is set and is not a folder.
    """
    named = os.environ.get("GEOAIM_DATA")
    if named and not Path(named).is_dir():
        raise FileNotFoundError(f"GEOAIM_DATA={named} is not a folder; unset it or correct it")
    folder = Path(named) if named else Path(__file__).parents[2].parent / "shared" / "data"
    return folder if folder.is_dir() else None


def needed(name: str) -> Path:
    """A folder of real data that work cannot do without.

    Raises:
        TracksError: it is not here.
    """
    data = data_folder()
    if data is None or not (data / name).is_dir():
        raise TracksError(f"{name} is not here; name the folder of real data by GEOAIM_DATA")
    return data / name
