"""Telemetry in the .SRT subtitles of DJI drones; docs/formats/telemetry.md lists the dialects."""

import math
import re
import warnings
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.base.geometry import wrap_angle
from geoaim.base.limits import refuse_damaged
from geoaim.base.world import METRES_PER_DEGREE
from geoaim.mapping.video.telemetry import Telemetry, make_telemetry

TIME_LINE = re.compile(r"^[ \t]*(\d{1,3}):(\d\d):(\d\d)[,.](\d{1,3})[ \t]*-->", re.MULTILINE)
DATE = re.compile(r"\b(\d{4})[-.](\d\d?)[-.](\d\d?) (\d\d):(\d\d):(\d\d)\b")
NUMBER = re.compile(r"[-+]?\d{1,9}(\.\d{1,15})?")
VALUE = r"\s*:\s*([^\s\]]*)"
PATTERNS = {
    "latitude": rf"\blatitude{VALUE}",
    "longitude": rf"\blongt?itude{VALUE}",  # some models misspell it
    "height": rf"\brel_alt{VALUE}|\bBAROMETER{VALUE}|\bH\s+(\S*)",
    "only altitude": rf"\baltitude{VALUE}",
    "altitude": rf"\babs_alt{VALUE}",
    "yaw": rf"\bgb_yaw{VALUE}",
    "pitch": rf"\bgb_pitch{VALUE}",
    "focal_length": rf"\bfocal_len{VALUE}",
    "place": r"\b(?:GPS|RTK)\s*\(([^)]*)\)",
    "attitude": r"\bG\.PRY\s*\(([^)]*)\)",
    "roll": rf"\bgb_roll{VALUE}",
}
ZOOM = re.compile(rf"\b(\w*zoom\w*){VALUE}", re.IGNORECASE)
DIGITAL_ZOOMS = ("dzoom", "dzoom_ratio", "digital_zoom")
ZOOM_UNIT = 10_000  # some models write 10000 for no zoom
UNKNOWN = ("", "n/a", "na", "nan", "null", "none", "-", "--")  # what stands for no value
ALTITUDE_ALONE = (
    "its `altitude` counts from the take-off in some models and from the sea in others, and the "
    "file does not tell which"
)
MAX_LEFT_OUT = 0.05  # share of the entries that may jump
# The most that a value changes: per second, and at once because of rounding and rare updates.
CHANGES = {
    "position": (60.0, 30.0, "m"),  # some models round to 1e-4 degrees and update each second
    "height": (30.0, 10.0, "m"),
    "altitude": (30.0, 10.0, "m"),
    "yaw": (360.0, 20.0, "degrees"),
    "pitch": (360.0, 20.0, "degrees"),
    "focal_length": (200.0, 50.0, "%"),
}


def read_srt(path: str | Path) -> Telemetry:
    """Read telemetry from a DJI .SRT file.

    Raises:
        FileNotFoundError: there is no such file.
        GeoreferenceError: the file has no time lines or no position, a value is not a number with
            a decimal point, a value is not possible, or more than a few change faster than a drone
            can move; these few are left out with a warning.
    """
    with refuse_damaged(path, GeoreferenceError, "an .SRT file", reads_once=True):
        text = Path(path).read_bytes().decode("utf-8", errors="replace")
    return parse_srt(text, str(path))


def parse_srt(text: str, path: str) -> Telemetry:
    """Parse the text of a DJI .SRT file; `read_srt` says what is raised."""
    lines = list(TIME_LINE.finditer(text))
    if not lines:
        raise GeoreferenceError(f"{path}: no line '00:00:00,000 --> ...' found: not an .SRT file")
    if text.count("-->") != len(lines):
        raise GeoreferenceError(
            f"{path}: {text.count('-->')} lines with '-->', but {len(lines)} that begin with a "
            "time such as 00:00:00,000: the file is damaged"
        )
    ends = [line.start() for line in lines[1:]] + [len(text)]
    rows, remarks = [], dict[str, str]()
    for number, (line, end) in enumerate(zip(lines, ends, strict=True), start=1):
        try:
            rows.append(_parse_entry(text[line.end() : end], remarks))
        except ValueError as error:
            raise GeoreferenceError(f"{path}: entry {number}: {error}") from None
    times = [_parse_seconds(line) for line in lines]
    telemetry = make_telemetry(times, rows, path, remarks)
    _check_changes(telemetry, path)
    return replace(telemetry, recorded=_measure_dates(text))


def _measure_dates(text: str) -> float:
    """Measure the seconds from the first to the last date, such as 2026-05-14 10:21:00.040."""
    dates = DATE.findall(text)
    try:
        first, last = (
            datetime(int(y), int(month), int(day), int(hour), int(minute), int(second))
            for y, month, day, hour, minute, second in (dates[0], dates[-1])
        )
    except (IndexError, ValueError):
        return math.nan
    return (last - first).total_seconds()


def _parse_seconds(line: re.Match[str]) -> float:
    hours, minutes, seconds, fraction = line.groups()
    return 3600 * int(hours) + 60 * int(minutes) + int(seconds) + float(f"0.{fraction}")


def _parse_entry(text: str, remarks: dict[str, str]) -> dict[str, float]:
    """Parse the fields of an entry, in degrees, metres and millimetres."""
    stated = {}
    for name, pattern in PATTERNS.items():
        found = [match[match.lastindex or 0] for match in re.finditer(pattern, text)]
        if len(found) > 1:
            raise ValueError(f"{name} is stated {len(found)} times")
        if found and found[0].rstrip(",").lower() not in UNKNOWN:
            stated[name] = found[0].rstrip(",")
    row = _parse_place(stated.pop("place")) if "place" in stated else {}
    if "attitude" in stated:
        parts = [part.strip().rstrip("°\ufffd") for part in stated.pop("attitude").split(",")]
        if len(parts) != 3:
            raise ValueError(f"G.PRY has {len(parts)} parts; pitch, roll and yaw are needed")
        stated |= dict(zip(("pitch", "roll", "yaw"), parts, strict=True))
    for name, value in stated.items():
        row[name] = _parse_number(name, re.sub("[mM]$", "", value) if name == "height" else value)
    if row.pop("only altitude", None) is not None and "height" not in row:
        remarks["height"] = ALTITUDE_ALONE
    if "." not in stated.get("focal_length", "."):
        row["focal_length"] /= 10.0  # older models write tenths: "focal_len : 240" is 24 mm
    zoom, problem = _parse_zoom(text)
    if problem and row.pop("focal_length", None) is not None:
        remarks["focal_length"] = problem
    return row | {"zoom": zoom}


def _parse_zoom(text: str) -> tuple[float, str]:
    """Parse the digital zoom; with the problem, where fields contradict or are unknown."""
    zooms = {}
    for name, value in ZOOM.findall(text):
        written = value.rstrip(",")
        if written.lower() not in UNKNOWN:
            number = _parse_number(name, written)
            is_share = "." not in written and number >= ZOOM_UNIT / 100
            zooms[name.lower()] = number / ZOOM_UNIT if is_share else number or 1.0
    digital = {zoom for name, zoom in zooms.items() if name in DIGITAL_ZOOMS}
    others = {name: zoom for name, zoom in zooms.items() if name not in DIGITAL_ZOOMS}
    if len(digital) > 1 or any(zoom != 1.0 for zoom in others.values()):
        listed = ", ".join(f"{name} {zoom:g}" for name, zoom in zooms.items())
        return 1.0, f"its zooms do not tell which one the focal length has: {listed}"
    return next(iter(digital), 1.0), ""


def _parse_place(text: str) -> dict[str, float]:
    """Position as GPS (longitude, latitude, satellites) or GPS(latitude, longitude, 0.0M)."""
    parts = [part.strip() for part in text.split(",")]
    if all(part.lower() in UNKNOWN for part in parts[:2]):  # no fix
        return {}
    latitude_first = parts[-1].endswith("M")
    if len(parts) != 3 or not (latitude_first or parts[-1].isdecimal()):
        found = " ".join(text.split())
        raise ValueError(
            f"GPS({found}) is neither (longitude, latitude, satellites) nor (latitude, longitude, "
            "altitude with M), in numbers with a decimal point"
        )
    names = ("latitude", "longitude") if latitude_first else ("longitude", "latitude")
    _parse_number("altitude", parts[-1].rstrip("M"))
    return {name: _parse_number(name, part) for name, part in zip(names, parts[:2], strict=True)}


def _parse_number(name: str, text: str) -> float:
    if not NUMBER.fullmatch(text):
        raise ValueError(f"{name} is {text!r}; a number with a decimal point is needed")
    return float(text)


def _check_changes(telemetry: Telemetry, path: str | Path) -> None:
    """Refuse times that go back; leave out the few values that no drone reaches so fast."""
    if (np.diff(telemetry.time) < 0).any():
        entry = int(np.argmax(np.diff(telemetry.time) < 0)) + 2
        raise GeoreferenceError(f"{path}: entry {entry} is earlier than the one before it")
    for name, (_, _, unit) in CHANGES.items():
        values = telemetry.latitude if name == "position" else getattr(telemetry, name)
        stated = np.flatnonzero(np.isfinite(values))
        change, wrong = _find_jumps(telemetry, name, stated)
        if not wrong.any():
            continue
        first = int(np.argmax(wrong))
        entry, dt = stated[first + 1] + 1, float(np.diff(telemetry.time[stated])[first])
        message = f"{path}: entry {entry}: {name} changes by {change[first]:.0f} {unit} in {dt:.3g}"
        runs = np.split(stated, np.flatnonzero(wrong) + 1)  # entries between jumps
        few = MAX_LEFT_OUT * len(stated)
        left_out = np.concatenate([stated[:0], *(run for run in runs if len(run) <= few)])
        others = np.setdiff1d(stated, left_out)
        if len(left_out) > few or _find_jumps(telemetry, name, others)[1].any():
            raise GeoreferenceError(
                f"{message} s ({wrong.sum()} such entries), which is too fast; correct or remove "
                "the file"
            )
        warnings.warn(
            f"{message} s, which is too fast; the {name} of {len(left_out)} of {len(stated)} "
            f"entries, from {left_out[0] + 1} on, is left out",
            GeoaimWarning,
            stacklevel=3,
        )
        values[left_out] = np.nan
        if name == "position":
            telemetry.longitude[left_out] = np.nan


def _find_jumps(
    telemetry: Telemetry, name: str, stated: Int[Array, " S"]
) -> tuple[Float[Array, " _"], Bool[Array, " _"]]:
    """Changes from each entry that states a value to the next, and which are too fast."""
    rate, jump, _ = CHANGES[name]
    change = _measure_change(telemetry, name, stated)
    return change, change > rate * np.diff(telemetry.time[stated]) + jump


def _measure_change(telemetry: Telemetry, name: str, stated: Array) -> Float[Array, " S"]:
    """Change of a value from one entry that states it to the next, in the unit of `CHANGES`."""
    if name == "position":
        latitude, longitude = telemetry.latitude[stated], np.radians(telemetry.longitude[stated])
        east = np.degrees(wrap_angle(np.diff(longitude))) * np.cos(np.radians(latitude[1:]))
        return METRES_PER_DEGREE * np.hypot(east, np.diff(latitude))
    values = getattr(telemetry, name)[stated]
    change = np.diff(values)
    if name == "focal_length":
        change = 100.0 * change / np.minimum(values[1:], values[:-1])
    elif name in ("yaw", "pitch"):
        change = np.degrees(wrap_angle(change))
    return np.abs(change)
