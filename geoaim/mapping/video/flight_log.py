"""Telemetry in the flight logs of DJI drones, as AirData writes them: a .CSV of a whole flight."""

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from geoaim.base.errors import GeoreferenceError
from geoaim.base.limits import refuse_damaged
from geoaim.mapping.video.telemetry import SLOW_MOTION, Telemetry, make_telemetry

METRES = {"meters": 1.0, "metres": 1.0, "m": 1.0, "feet": 0.3048, "ft": 0.3048}
TIME = "time(millisecond)"
# `altitude` counts from the take-off or the sea, by the setting of the export: it is not read
HEIGHTS = {"height_above_takeoff": "height", "altitude_above_sealevel": "altitude"}
ANGLES = {
    "gimbal_heading(degrees)": "yaw",
    "gimbal_pitch(degrees)": "pitch",
    "gimbal_roll(degrees)": "roll",
}


def is_flight_log(path: Path) -> bool:
    """Whether a .csv file has a flight log's columns; boxes and tracks have others."""
    with path.open("rb") as opened:
        header = opened.read(4096).decode("utf-8-sig", errors="replace").split("\n")[0].lower()
    return TIME in header and "latitude" in header


def read_flight_log(path: Path, duration: float) -> Telemetry:
    """Read the telemetry of one recording from the flight log of a whole flight.

    Args:
        path: the .csv file, with a column `isVideo`.
        duration: of the recording's frames, s; it tells which one of several it is.

    Raises:
        GeoreferenceError: no recording of the log, or more than one, lasts as long as the video; or
            a value is not a number, or not possible.
    """
    with refuse_damaged(path, GeoreferenceError, "a flight log", reads_once=True):
        lines = path.read_bytes().decode("utf-8-sig").splitlines()
        table = [[cell.strip() for cell in row] for row in csv.reader(lines)]
    header = [name.lower() for name in table[0]]
    rows = [_parse_row(dict(zip(header, row, strict=False)), path) for row in table[1:] if any(row)]
    if "isvideo" not in header:
        raise GeoreferenceError(f"{path}: no column isVideo, which says when the camera records")
    times = np.array([row.pop("time") for row in rows])
    films = np.array([row.pop("film") == 1 for row in rows], bool)
    first, end = _find_recording(times, films, duration, path)
    since = times[first:end] - times[first]
    length = float(since[-1])
    is_slowed = 0 < SLOW_MOTION * length < duration
    telemetry = make_telemetry(
        (since * (duration / length if is_slowed else 1.0)).tolist(), rows[first:end], str(path)
    )
    remarks = {"focal_length": "a flight log states none"}
    return replace(telemetry, remarks=remarks, recorded=length)


def _parse_row(cells: dict[str, str], path: Path) -> dict[str, float]:
    """Parse the values of a row: s, degrees and metres."""
    row = {"time": _parse_number(cells, TIME, path) / 1000.0}
    row["film"] = _parse_number(cells, "isvideo", path)
    for name in ("latitude", "longitude"):
        row[name] = _parse_number(cells, name, path)
    for name, key in ANGLES.items():
        row[key] = _parse_number(cells, name, path)
    for name in cells:
        kind, _, unit = name.rstrip(")").partition("(")
        if kind in HEIGHTS and unit in METRES:
            row[HEIGHTS[kind]] = _parse_number(cells, name, path) * METRES[unit]
    return row


def _parse_number(cells: dict[str, str], name: str, path: Path) -> float:
    text = cells.get(name, "")
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise GeoreferenceError(f"{path}: {name} is {text!r}; a number is needed") from None


def _find_recording(
    times: Array, films: Bool[Array, " T"], duration: float, path: Path
) -> tuple[int, int]:
    """Find the first entry of the recording that lasts as long as the video, and its end."""
    edges = np.flatnonzero(np.diff(films.astype(np.int8), prepend=0, append=0))
    runs = [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]
    lengths = [times[end - 1] - times[first] for first, end in runs]
    # the flag follows the camera by up to a second, at its start and at its end
    is_fitting = [abs(length - duration) < 2.0 for length in lengths]
    if sum(is_fitting) == 1:
        return runs[is_fitting.index(True)]
    if len(runs) == 1 and not lengths[0] > duration:  # one that is longer is of a cut video
        return runs[0]
    listed = ", ".join(f"{times[first]:.1f} to {times[end - 1]:.1f} s" for first, end in runs[:8])
    raise GeoreferenceError(
        f"{path}: which of its recordings is the video of {duration:.1f} s is not clear, by "
        f"isVideo at {listed or 'no time'}; leave only the rows of the video in it"
    )
