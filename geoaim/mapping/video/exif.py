"""Telemetry in EXIF and DJI's XMP of photos."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from geoaim.base.errors import GeoreferenceError
from geoaim.base.raster_files import open_raster_file
from geoaim.mapping.video.telemetry import Telemetry, make_telemetry

NUMBER = r"([-+]?\d+(?:\.\d+)?)"
SIGNS = {"latitude": {"N": 1, "S": -1}, "longitude": {"E": 1, "W": -1}}
MAX_DIFFERENCE_DEGREES = 0.01  # between EXIF's position and that of XMP
MAX_ASPECT_CHANGE = 0.01  # of a picture that was resized, not cut
WGS84 = ("WGS84", "WGS1984")


def read_exif(paths: Sequence[str | Path], *, rate: float = 1.0) -> Telemetry | None:
    """Read telemetry from the EXIF and DJI's XMP of photos; None when no photo has a position."""
    remarks = dict[str, str]()
    rows = [_read_exif_entry(Path(path), remarks) for path in paths]
    source = f"{paths[0]} and the images with it"
    if not any("latitude" in row and "longitude" in row for row in rows):
        if "position" in remarks:
            raise GeoreferenceError(f"{source}: no position is read: {remarks['position']}")
        return None
    times = [index / rate for index in range(len(rows))]
    return make_telemetry(times, rows, source, remarks)


def _read_exif_entry(path: Path, remarks: dict[str, str]) -> dict[str, float]:
    """Read the fields of a photo; those whose meaning is open are left out, with a remark."""
    try:
        with open_raster_file(path) as image:
            tags, xmp = image.tags(), "".join(image.tags(ns="xml:XMP").values())
            size = image.width, image.height
    except (OSError, UnicodeDecodeError):
        return {}
    tags = {name.removeprefix("EXIF_"): value.strip() for name, value in tags.items()}
    row = _read_place(tags, xmp, remarks)
    if altitude := _parse_numbers(tags.get("GPSAltitude", "")):
        below_sea = tags.get("GPSAltitudeRef", "0").removeprefix("0x").strip("0") == "1"
        row["altitude"] = -altitude[0] if below_sea else altitude[0]
    drone = {"height": "RelativeAltitude", "pitch": "GimbalPitchDegree"}
    row |= _read_xmp(xmp, drone) | _read_heading(tags, xmp, remarks)
    return row | _read_focal_length(tags, size, remarks)


def _read_place(tags: Mapping[str, str], xmp: str, remarks: dict[str, str]) -> dict[str, float]:
    """Read latitude and longitude, with the signs of EXIF's letters or of the numbers in XMP."""
    signed = _read_xmp(xmp, {"latitude": "GpsLatitude", "longitude": "GpsLongt?itude"})
    row = {}
    for name in ("latitude", "longitude"):
        tag = f"GPS{name.capitalize()}"
        parts = _parse_numbers(tags.get(tag, ""))[:3]  # degrees, minutes, seconds
        letter = tags.get(f"{tag}Ref", "").upper()[:1]
        if parts:
            degrees = sum(part / 60**power for power, part in enumerate(parts))
            if letter in SIGNS[name]:
                degrees *= SIGNS[name][letter]
            elif name in signed:
                degrees = math.copysign(degrees, signed[name])
            else:
                remarks["position"] = f"{tag} has no letter {' or '.join(SIGNS[name])} beside it"
                return {}
            if abs(degrees - signed.get(name, degrees)) > MAX_DIFFERENCE_DEGREES:
                remarks["position"] = f"EXIF states {name} {degrees:g}, XMP {signed[name]:g}"
                return {}
            row[name] = degrees
        elif name in signed:
            row[name] = signed[name]
    datum = re.sub("[^A-Z0-9]", "", tags.get("GPSMapDatum", "").upper())
    if datum and not datum.startswith(WGS84):
        remarks["position"] = f"its GPSMapDatum is {tags['GPSMapDatum']!r}; WGS-84 is needed"
        return {}
    return row


def _read_heading(tags: Mapping[str, str], xmp: str, remarks: dict[str, str]) -> dict[str, float]:
    """Read yaw and roll of the gimbal, or the heading of the view."""
    row = _read_xmp(xmp, {"yaw": "GimbalYawDegree", "roll": "GimbalRollDegree"})
    direction = _parse_numbers(tags.get("GPSImgDirection", ""))
    if direction and "M" not in tags.get("GPSImgDirectionRef", "T"):  # not magnetic north
        row.setdefault("yaw", direction[0])
    reverse = ("GimbalReverse", "CamReverse")  # not 0: mounted upside down
    turned = {name: value for name in reverse for value in _read_xmp(xmp, {name: name}).values()}
    orientation = tags.get("Orientation", "1") or "1"
    problem = "".join(f"its {name} is {value:g}" for name, value in turned.items() if value)
    if orientation not in ("0", "1"):
        problem = (
            f"its Orientation is {orientation}, so that it is shown turned or mirrored, and the "
            "heading may be that of either picture"
        )
    if problem and "yaw" in row:
        remarks["yaw"] = problem
        return {}
    return row


def _read_focal_length(
    tags: Mapping[str, str], size: tuple[int, int], remarks: dict[str, str]
) -> dict[str, float]:
    """Read the 35 mm equivalent, and the digital zoom by which drones' focal lengths grow."""
    length = _parse_numbers(tags.get("FocalLengthIn35mmFilm", ""))
    zoom = (_parse_numbers(tags.get("DigitalZoomRatio", "")) or [0.0])[0] or 1.0  # 0: not used
    if not length:
        return {}
    # focal lengths of these leave out the digital zoom
    if zoom != 1.0 and not tags.get("Make", "").upper().startswith(("DJI", "HASSELBLAD")):
        remarks["focal_length"] = (
            f"its DigitalZoomRatio is {zoom:g}, which some cameras' FocalLengthIn35mmFilm has "
            "and others' has not"
        )
        return {}
    stated = [_parse_numbers(tags.get(f"Pixel{axis}Dimension", "")) for axis in "XY"]
    if all(stated) and not math.isclose(
        stated[0][0] * size[1], stated[1][0] * size[0], rel_tol=MAX_ASPECT_CHANGE
    ):
        remarks["focal_length"] = (
            f"it was taken with {stated[0][0]:g} x {stated[1][0]:g} pixels and has "
            f"{size[0]} x {size[1]}, so that it was cut"
        )
        return {}
    return {"focal_length": length[0], "zoom": zoom}


def _read_xmp(xmp: str, tags: Mapping[str, str]) -> dict[str, float]:
    """Read numbers of DJI's XMP: by name, the pattern of the tag; without those not stated."""
    found = {
        name: re.search(rf"drone-dji:{tag}(?:\s*=\s*[\"']|>)\s*{NUMBER}", xmp)
        for name, tag in tags.items()
    }
    return {name: float(match[1]) for name, match in found.items() if match}


def _parse_numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(NUMBER, text)]
