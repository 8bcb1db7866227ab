"""Telemetry in EXIF and DJI's XMP of photos."""

import re
from collections.abc import Sequence
from pathlib import Path

from geoaim.base.raster_files import open_raster_file
from geoaim.mapping.video.telemetry import Telemetry, make_telemetry

NUMBER = r"([-+]?\d+(?:\.\d+)?)"


def read_exif(paths: Sequence[str | Path], *, rate: float = 1.0) -> Telemetry | None:
    """Read telemetry from the EXIF and DJI's XMP of photos; None when no photo has a position.

    Time is the index of a photo over `rate` (frames per second), as in `open_video`.

    Raises:
        GeoreferenceError: a position or another value is not possible.
    """
    rows = [_read_exif_entry(Path(path)) for path in paths]
    if not any("latitude" in row and "longitude" in row for row in rows):
        return None
    times = [index / rate for index in range(len(rows))]
    return make_telemetry(times, rows, f"{paths[0]} and the images with it")


def _read_exif_entry(path: Path) -> dict[str, float]:
    try:
        with open_raster_file(path) as image:
            tags, xmp = image.tags(), "".join(image.tags(ns="xml:XMP").values())
    except (OSError, UnicodeDecodeError):
        return {}
    row = {}
    for name in ("Latitude", "Longitude"):
        parts = _parse_numbers(tags.get(f"EXIF_GPS{name}", ""))[:3]  # degrees, minutes, seconds
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
