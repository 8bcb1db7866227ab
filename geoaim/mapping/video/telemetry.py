"""Telemetry: the camera's position and attitude, from DJI .SRT files or EXIF and XMP of photos."""

import math
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from jaxtyping import Float
from numpy import ndarray as Array
from rasterio.errors import NotGeoreferencedWarning, RasterioIOError

from geoaim.errors import GeoreferenceError
from geoaim.geometry import wrap_angle

FIELDS = ("latitude", "longitude", "height", "altitude", "yaw", "pitch", "focal_length")
TIME_LINE = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{1,3})\s*-->.*")
NUMBER = r"([-+]?\d+(?:\.\d+)?)"
# DJI's formats differ between models: "latitude: 1", "longtitude : 1", "[rel_alt: 1 abs_alt: 2]",
# "GPS(lon,lat,satellites) BAROMETER:1", "GPS (lon, lat, 19), D 75m, H 60.20m".
PATTERNS = {
    "latitude": rf"latitude\s*:\s*{NUMBER}|\bGPS\s*\(\s*[-+\d.]+\s*,\s*{NUMBER}",
    "longitude": rf"long?t?itude\s*:\s*{NUMBER}|\bGPS\s*\(\s*{NUMBER}",
    "height": rf"rel_alt\s*:\s*{NUMBER}|BAROMETER\s*:\s*{NUMBER}|\bH\s+{NUMBER}\s*m",
    "altitude": rf"abs_alt\s*:\s*{NUMBER}",
    "yaw": rf"gb_yaw\s*:\s*{NUMBER}",
    "pitch": rf"gb_pitch\s*:\s*{NUMBER}",
    "focal_length": rf"focal_len\s*:\s*{NUMBER}",
}


@dataclass(frozen=True)
class Telemetry:
    """State of the camera over time; NaN where the file does not state it.

    Attributes:
        time: (T,) seconds, on the clock of the video's frames.
        latitude: (T,) degrees, WGS 84.
        longitude: (T,) degrees, WGS 84.
        height: (T,) metres above the take-off point.
        altitude: (T,) metres above sea level, as the drone measures it.
        yaw: (T,) radians counter-clockwise from east, in [-pi, pi): heading of the camera, and of
            the top of the image when the camera looks straight down.
        pitch: (T,) radians, 0 at the horizon and -pi/2 straight down.
        focal_length: (T,) millimetres, 35 mm equivalent.
    """

    time: Float[Array, " T"]
    latitude: Float[Array, " T"]
    longitude: Float[Array, " T"]
    height: Float[Array, " T"]
    altitude: Float[Array, " T"]
    yaw: Float[Array, " T"]
    pitch: Float[Array, " T"]
    focal_length: Float[Array, " T"]


def read_srt(path: str | Path) -> Telemetry:
    """Read telemetry from a DJI .SRT file, in the bracketed or the older GPS(...) style.

    Raises:
        GeoreferenceError: the file has no time lines, no position, or one that is not on the Earth.
    """
    text = Path(path).read_bytes().decode("utf-8", errors="replace")
    lines = list(TIME_LINE.finditer(text))
    if not lines:
        raise GeoreferenceError(f"{path}: no line '00:00:00,000 --> ...' found: not an .SRT file")
    ends = [line.start() for line in lines[1:]] + [len(text)]
    rows = [_parse_srt_entry(text[line.end() : end]) for line, end in zip(lines, ends, strict=True)]
    times = [_parse_seconds(line) for line in lines]
    return _make_telemetry(times, rows, str(path))


def read_exif(paths: Sequence[str | Path], *, rate: float = 1.0) -> Telemetry | None:
    """Read telemetry from the EXIF and DJI's XMP of photos; None when no photo has a position.

    Time is the index over `rate`, as in `open_video`.

    Raises:
        GeoreferenceError: a position is not on the Earth.
    """
    rows = [_read_exif_entry(Path(path)) for path in paths]
    if not any("latitude" in row and "longitude" in row for row in rows):
        return None
    times = [index / rate for index in range(len(rows))]
    return _make_telemetry(times, rows, f"{paths[0]} and the images with it")


def _make_telemetry(times: list[float], rows: list[dict[str, float]], source: str) -> Telemetry:
    """From fields as they are stated, with angles in degrees and yaw clockwise from north."""
    table = np.array([[row.get(name, math.nan) for name in FIELDS] for row in rows], np.float64)
    table[(table[:, 0] == 0) & (table[:, 1] == 0), :2] = np.nan  # DJI writes (0, 0) without a fix
    if not np.isfinite(table[:, :2]).all(axis=1).any():
        raise GeoreferenceError(f"{source}: no latitude and longitude found")
    largest_latitude, largest_longitude = np.nanmax(np.abs(table[:, :2]), axis=0)
    if largest_latitude > 90 or largest_longitude > 180:
        raise GeoreferenceError(
            f"{source}: latitude up to {largest_latitude:g} and longitude up to "
            f"{largest_longitude:g} degrees: not a place on the Earth; are they swapped?"
        )
    table[:, 4] = wrap_angle(np.radians(90.0 - table[:, 4]))
    table[:, 5] = np.radians(table[:, 5])
    return Telemetry(np.array(times, np.float64), *table.T)


def _parse_seconds(line: re.Match[str]) -> float:
    hours, minutes, seconds, fraction = line.groups()
    return 3600 * int(hours) + 60 * int(minutes) + int(seconds) + float(f"0.{fraction}")


def _parse_srt_entry(text: str) -> dict[str, float]:
    row = {}
    for name, pattern in PATTERNS.items():
        if found := re.search(pattern, text):
            stated = next(group for group in found.groups() if group is not None)
            # Older models write the focal length in tenths: "focal_len : 240" is 24 mm.
            tenths = name == "focal_length" and "." not in stated
            row[name] = float(stated) / 10 if tenths else float(stated)
    return row


def _read_exif_entry(path: Path) -> dict[str, float]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as image:
                tags, xmp = image.tags(), "".join(image.tags(ns="xml:XMP").values())
    except RasterioIOError:
        return {}
    row = {}
    for name in ("Latitude", "Longitude"):
        parts = _parse_numbers(tags.get(f"EXIF_GPS{name}", ""))
        if parts:
            degrees = sum(part / 60**power for power, part in enumerate(parts))
            south_or_west = tags.get(f"EXIF_GPS{name}Ref", "").strip() in ("S", "W")
            row[name.lower()] = -degrees if south_or_west else degrees
    stated = {"altitude": "EXIF_GPSAltitude", "focal_length": "EXIF_FocalLengthIn35mmFilm"}
    row |= {name: _parse_numbers(tags[tag])[0] for name, tag in stated.items() if tags.get(tag)}
    drone = {"height": "RelativeAltitude", "yaw": "GimbalYawDegree", "pitch": "GimbalPitchDegree"}
    for name, tag in drone.items():
        if found := re.search(rf"drone-dji:{tag}(?:=[\"']|>){NUMBER}", xmp):
            row[name] = float(found[1])
    direction = _parse_numbers(tags.get("EXIF_GPSImgDirection", ""))
    if direction and "M" not in tags.get("EXIF_GPSImgDirectionRef", "T"):  # not magnetic north
        row.setdefault("yaw", direction[0])
    return row


def _parse_numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(NUMBER, text)]
