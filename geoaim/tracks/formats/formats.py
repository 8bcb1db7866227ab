"""The known file formats of tracks, and `read_tracks`, which detects a file's format."""

import gzip
import os
import zlib
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import pandas as pd

from geoaim.base.errors import TracksError, name_option
from geoaim.base.files import TRACKS_FILE, find_in_folder
from geoaim.base.limits import check_regular, name_file
from geoaim.base.world import World
from geoaim.tracks import formats as package
from geoaim.tracks.files import read_plain_tracks
from geoaim.tracks.formats.plausibility import (
    check_place,
    check_plausibility,
    derive_contradicted_motion,
)
from geoaim.tracks.formats.shared import TrackFormat, check_resolution, has_columns
from geoaim.tracks.tracks import Tracks

_has_plain_columns = has_columns("id", "type", "time", "heading")


def _is_plain(path: Path, line: str) -> bool:
    is_parquet = path.suffix.lower() == ".parquet"
    return is_parquet or line.startswith(("#", '"#')) or _has_plain_columns(path, line)


PLAIN = TrackFormat("plain", _is_plain, read_plain_tracks, options=("world",), rank=1)


@cache
def list_formats() -> tuple[TrackFormat, ...]:
    """List the formats of all modules of this package, by rank."""
    found: dict[str, TrackFormat] = {}
    for module in iter_modules(package.__path__):
        values = vars(import_module(f"{package.__name__}.{module.name}")).values()
        found |= {one.name: one for one in values if isinstance(one, TrackFormat)}
    return tuple(sorted(found.values(), key=lambda one: one.rank))


def read_tracks(
    path: str | os.PathLike[str] | pd.DataFrame,
    *,
    world: World | None = None,
    resolution: float | None = None,
    frame_rate: float | None = None,
) -> Tracks:
    """Read tracks from a file in any format of `list_formats`, and warn of implausible ones.

    Where headings or speeds of most agents contradict their positions and times, they are taken
    from the positions, and a warning says so. The readers of `geoaim.tracks.formats`, one for each
    format, keep what the file has, and do not check plausibility.

    Args:
        path: a file in the plain format of `write_tracks` or in that of a public dataset, or the
            folder of a SinD recording, of one ScenarioNet scenario or of `geoaim place`. A
            DataFrame is read by `Tracks.from_dataframe`.
        world: the CRS and origin of x and y, for formats in metres that do not state them, those
            with "world" in their `TrackFormat.options` (geo-trax takes the CRS only). None: the
            plane of a `meta_data.csv` beside a file of the INTERACTION format, or a local plane.
        resolution: metres per pixel, for formats in pixels, those with "resolution" in their
            options, which need it.
        frame_rate: frames per second, for tables that have frames and no times.

    Returns:
        The tracks.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file has none of the formats, is broken, or nearly all of its agents or
            states are implausible.
        ValueError: a required option is missing, the format does not take a given option, or
            the resolution is not positive.
    """
    if isinstance(path, pd.DataFrame):
        if resolution is not None:
            raise ValueError("a DataFrame is in metres; omit resolution=, and scale its x and y")
        return Tracks.from_dataframe(path, world=world, frame_rate=frame_rate)
    path = find_in_folder(path, TRACKS_FILE)
    track_format = detect_format(path)
    options = {"world": world, "resolution": resolution, "frame_rate": frame_rate}
    given: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
    for name in given:
        if name not in track_format.options:
            words = name.replace("_", " ")
            option = name_option(f"--tracks-{name.replace('_', '-')}", f"{name}=")
            raise ValueError(
                f"{path} is in the {track_format.name} format, which takes no {words}; omit "
                f"{option}"
            )
    if resolution is not None:
        check_resolution(resolution)
    if "resolution" in track_format.required and resolution is None:
        raise ValueError(
            f"{path} is in the {track_format.name} format, which needs a resolution: give "
            f"{name_option('--tracks-resolution', 'resolution=')}, metres per pixel, such as 0.04. "
            "If x and y are metres, write '# crs: EPSG:n' (or local) as the first line of a table "
            "with id, type, time, x, y, length and width"
        )
    with name_file(path):
        tracks = track_format.read(path, **given)
    check_place(path, tracks)
    tracks = derive_contradicted_motion(path, tracks)
    check_plausibility(path, tracks)
    return tracks


def detect_format(path: str | os.PathLike[str]) -> TrackFormat:
    """Detect a file's format from its name and first line.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: it has no known format.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    line = "" if path.is_dir() else _read_first_line(path)
    for track_format in list_formats():
        if track_format.matches(path, line):
            return track_format
    raise TracksError(
        f"{path} is not a table of tracks in a known format: its first line is {line[:120]!r}. "
        f"Known formats: {', '.join(known.name for known in list_formats())}; rename the columns "
        "to those of one of them, separate them with commas, and save it as UTF-8"
    )


def _read_first_line(path: Path) -> str:
    check_regular(path, TracksError)
    try:
        opened = gzip.open if path.suffix.lower() == ".gz" else open
        with opened(path, "rt", encoding="utf-8-sig", errors="replace") as file:
            return str(file.readline(100_000)).strip()
    except (OSError, EOFError, zlib.error) as error:
        raise TracksError(f"{path} is not a table of tracks: {error}") from error
