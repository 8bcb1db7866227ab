"""The known file formats of tracks, and `read_tracks`, which detects a file's format."""

import gzip
import os
import zlib
from pathlib import Path
from typing import Any

from geoaim.base.errors import TracksError, name_option
from geoaim.base.limits import check_regular, name_file
from geoaim.base.world import World
from geoaim.tracks.files import read_plain_tracks
from geoaim.tracks.formats.argoverse import ARGOVERSE
from geoaim.tracks.formats.geopackage import GEOPACKAGE
from geoaim.tracks.formats.geotrax import GEOTRAX
from geoaim.tracks.formats.geotrax_pixels import GEOTRAX_PIXELS
from geoaim.tracks.formats.interaction import INTERACTION, SIND
from geoaim.tracks.formats.levelx import HIGHD, IND
from geoaim.tracks.formats.pixels import PIXELS
from geoaim.tracks.formats.plausibility import check_plausibility
from geoaim.tracks.formats.scenarionet import SCENARIONET
from geoaim.tracks.formats.shared import TrackFormat, check_resolution, has_columns
from geoaim.tracks.formats.stanford import SDD, TRAJNET
from geoaim.tracks.formats.waymo import WAYMO
from geoaim.tracks.tracks import Tracks

MAX_LINE_CHARS = 100_000
BINARY = (".parquet", ".pkl", ".gpkg")  # suffixes of files that have no first line
_has_plain_columns = has_columns("id", "type", "time", "heading")


def _is_plain(path: Path, line: str) -> bool:
    is_parquet = path.suffix.lower() == ".parquet"
    return is_parquet or line.startswith(("#", '"#')) or _has_plain_columns(path, line)


PLAIN = TrackFormat("plain", _is_plain, read_plain_tracks, options=("world",))
# the first format that matches a file is used
FORMATS = (
    ARGOVERSE,
    WAYMO,
    SCENARIONET,
    GEOPACKAGE,
    PLAIN,
    SDD,
    SIND,
    INTERACTION,
    IND,
    HIGHD,
    GEOTRAX,
    GEOTRAX_PIXELS,
    TRAJNET,
    PIXELS,
)


def read_tracks(
    path: str | os.PathLike[str],
    *,
    world: World | None = None,
    resolution: float | None = None,
    frame_rate: float | None = None,
    scenario: str | None = None,
) -> Tracks:
    """Read tracks from a file in any format of `FORMATS`, and warn of implausible ones.

    The readers of `geoaim.tracks.formats`, one for each format, do not check plausibility.

    Args:
        path: a file in the plain format of `write_tracks` or in that of a public dataset, or the
            folder of a SinD recording or of one ScenarioNet scenario.
        world: the CRS and origin of x and y, for formats in metres that do not state them, those
            with "world" in their `TrackFormat.options` (geo-trax takes the CRS only). None: the
            plane of a `meta_data.csv` beside a file of the INTERACTION format, or a local plane.
        resolution: metres per pixel, for formats in pixels, those with "resolution" in their
            options; without it SDD raises, and TrajNet needs a `scenes.csv` that has it.
        frame_rate: frames per second, for tables that have frames and no times; geo-trax in
            pixels has 29.97 without it.
        scenario: id of a scenario, for formats with several in a file (Waymo); None where the file
            has one only.

    Returns:
        The tracks.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file has none of the formats, is broken, or nearly all of its agents or
            states are implausible.
        ValueError: a required option is missing, the format does not take a given option, or
            the resolution is not positive.
    """
    track_format = detect_format(path)
    options = {
        "world": world,
        "resolution": resolution,
        "frame_rate": frame_rate,
        "scenario": scenario,
    }
    given: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
    for name in given:
        if name not in track_format.options:
            words = name.replace("_", " ")
            prefix = "" if name == "scenario" else "tracks-"
            option = name_option(f"--{prefix}{name.replace('_', '-')}", f"{name}=")
            raise ValueError(
                f"{path} is in the {track_format.name} format, which takes no {words}; omit "
                f"{option}"
            )
    if resolution is not None:
        check_resolution(resolution)
    if "resolution" in track_format.required and resolution is None:
        raise ValueError(
            f"{path} is in the {track_format.name} format, which needs a resolution: give "
            f"{name_option('--tracks-resolution', 'resolution=')}, metres per pixel, such as 0.04"
        )
    with name_file(path):
        tracks = track_format.read(path, **given)
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
    binary = path.is_dir() or path.suffix.lower() in BINARY or ".tfrecord" in path.name
    line = "" if binary else _read_first_line(path)
    for track_format in FORMATS:
        if track_format.matches(path, line):
            return track_format
    raise TracksError(
        f"{path} is not a table of tracks in a known format: its first line is {line[:120]!r}. "
        f"Known formats: {', '.join(known.name for known in FORMATS)}; rename the columns to "
        "those of one of them, and separate them with commas"
    )


def _read_first_line(path: Path) -> str:
    check_regular(path, TracksError)
    try:
        opened = gzip.open if path.suffix.lower() == ".gz" else open
        with opened(path, "rt", encoding="utf-8-sig") as file:
            return str(file.readline(MAX_LINE_CHARS)).strip()
    except UnicodeDecodeError as error:
        raise TracksError(
            f"{path} is not a table of tracks in UTF-8 ({error}); save it as UTF-8"
        ) from error
    except (OSError, EOFError, zlib.error) as error:
        raise TracksError(f"{path} is not a table of tracks: {error}") from error
