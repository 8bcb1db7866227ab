"""Which form a file of tracks has, told from its first line."""

import gzip
import os
import re
from pathlib import Path

from geoaim.errors import TracksError
from geoaim.track_formats.geotrax import read_geotrax
from geoaim.track_formats.interaction import read_interaction
from geoaim.track_formats.levelx import read_highd, read_ind
from geoaim.track_formats.sind import read_sind
from geoaim.track_formats.stanford import read_sdd, read_trajnet
from geoaim.tracks import Tracks, read_tracks
from geoaim.world import World

# columns that tell a form; the first form all of whose columns are there is it
FORMS: dict[str, set[str]] = {
    "plain": {"id", "type", "time", "heading"},
    "SinD": {"track_id", "timestamp_ms", "x", "yaw_rad"},
    "SinD's pedestrians": {"track_id", "timestamp_ms", "x", "ax", "ay"},
    "INTERACTION": {"track_id", "timestamp_ms", "x", "vx"},
    "inD": {"trackId", "frame", "xCenter", "yCenter"},
    "highD": {"id", "frame", "x", "y", "width", "height", "xVelocity"},
    "geo-trax": {"Vehicle_ID", "Local_X", "Local_Y"},
    "TrajNet": {"frame", "track", "u_px", "v_px"},
}
SDD_LINE = re.compile(r'\d+( -?\d+){5}( [01]){3} "?\w+"?')


def read_any(
    path: str | os.PathLike[str],
    *,
    world: World | None = None,
    resolution: float | None = None,
) -> Tracks:
    """Read tracks in any form that this package knows, told from the file's columns.

    The forms are the plain one (`read_tracks`), those of INTERACTION, SinD (a file or a recording's
    folder), inD and its kin, highD, geo-trax, the Stanford Drone Dataset and its TrajNet windows.

    Args:
        path: a file, or the folder of a recording of SinD.
        world: where x and y lie, for the forms that do not say it, INTERACTION's and SinD's; of
            geo-trax's, which has the full coordinates, only the CRS counts.
        resolution: of the image, for the forms in its pixels.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file is of none of the forms, or broken.
        ValueError: what the form needs is not given, or what is given it does not need.
    """
    form = form_of(path)
    pixels, placeless = form in ("SDD", "TrajNet"), form in ("INTERACTION", "SinD", "geo-trax")
    if world is not None and not placeless:
        raise ValueError(f"{path} is of {form}'s form, which has its own plane; give no world")
    if resolution is not None and not pixels:
        raise ValueError(f"{path} is of {form}'s form, in metres; give no resolution")
    match form:
        case "SDD":
            if resolution is None:
                raise ValueError(f"{path} is in pixels; pass resolution, such as 0.04")
            return read_sdd(path, resolution=resolution)
        case "TrajNet":
            return read_trajnet(path, resolution=resolution)
        case "INTERACTION":
            return read_interaction(path, world=world)
        case "SinD":
            return read_sind(path, world=world)
        case "geo-trax":
            return read_geotrax(path, crs=None if world is None else world.crs)
        case "inD":
            return read_ind(path)
        case "highD":
            return read_highd(path)
    return read_tracks(path)


def form_of(path: str | os.PathLike[str]) -> str:
    """The name of the form that a file of tracks has.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: it is none of the known ones.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if path.is_dir():
        return "SinD"
    if path.suffix.lower() == ".parquet":
        return "plain"
    line = _first_line(path)
    if line.startswith("#"):
        return "plain"
    if SDD_LINE.fullmatch(line):
        return "SDD"
    columns = {name.strip().strip('"') for name in line.split(",")}
    for form, needed in FORMS.items():
        if needed <= columns:
            return form.removesuffix("'s pedestrians")
    raise TracksError(
        f"{path} is no table of tracks of a known form: its first line is {line[:120]!r}. "
        f"Known are SDD and {', '.join(FORMS)}; name the columns as one does"
    )


def _first_line(path: Path) -> str:
    try:
        opened = gzip.open if path.suffix.lower() == ".gz" else open
        with opened(path, "rt", encoding="utf-8-sig") as file:
            return str(file.readline(100_000)).strip()
    except (UnicodeDecodeError, OSError) as error:
        raise TracksError(f"{path} is no table of tracks: {error}") from error
