"""Read rows of control points from CSV, OpenDroneMap and QGIS files."""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.csv_rows import decode_text, trim_comment
from geoaim.base.errors import GeoreferenceError
from geoaim.base.limits import refuse_damaged
from geoaim.base.world import LONLAT

COLUMN_NAMES = {
    "u": ("u", "pixel_x", "pixelx", "col", "column", "px", "im_x"),
    "v": ("v", "pixel_y", "pixely", "row", "line", "py", "im_y"),
    "x": ("x", "easting", "east", "lon", "longitude", "lng", "mapx", "geo_x"),
    "y": ("y", "northing", "north", "lat", "latitude", "mapy", "geo_y"),
    "name": ("name", "id", "label", "point", "gcp"),
    "frame": ("frame", "image", "image_name", "img"),
    "crs": ("crs", "epsg", "srs"),
    "accuracy": ("accuracy", "accuracy_m", "accuracy_(m)", "sigma", "horz_accuracy"),
    "enable": ("enable", "enabled", "use"),
}
COMMENT = re.compile(r'\s*(#|"#\s*(crs|accuracy):)', re.IGNORECASE)  # a name may begin with "#
OFF = ("0", "false", "no")  # values of the column enable
DEGREE_COLUMNS = {"lon", "longitude", "lng", "lat", "latitude"}
QGIS_COLUMNS = ("mapx", "mapy", "pixelx", "pixely")
# "WGS84 UTM 35N" as OpenDroneMap writes it, or as PROJ names the CRS: "WGS 84 / UTM zone 35N";
# N and S are the hemispheres, other letters bands of latitude (C to X)
UTM_HEADER = re.compile(
    r"WGS\s*_?(?:19)?84\s*[/_]?\s*UTM\s*_?(?:zone)?\s*_?(\d{1,2})\s*([C-HJ-NP-X])", re.IGNORECASE
)
ODM_PIXEL_SHIFT = 0.5  # px from OpenDroneMap's origin, the first pixel's centre, to its corner

MAX_NUMBER = 1e12  # no pixel and no coordinate in metres, feet or degrees is as far away
SHARED_COVARIANCE = "shared covariance"  # comment of a file: three numbers, square metres
MAX_ROWS = 10_000  # a georeference of as many takes seconds
Lines = list[tuple[int, str]]  # lines and their numbers in the file


@dataclass(frozen=True)
class PointRow:
    """One control point as a file states it."""

    # u, v with the origin at the image's corner; NaN where both fields are empty
    pixel: tuple[float, float]
    coordinates: tuple[float, float]  # x, y in `crs`; NaN where both fields are empty
    source: str  # file and line, for messages
    crs: str | None = None  # None where the file does not state it
    name: str = ""
    frame: str = ""  # image name or frame index
    accuracy: float = 0.0  # one sigma of the coordinates by themselves, metres
    # covariance of an error that all points share, square metres; None where it is not stated
    shared_covariance: Float[Array, "2 2"] | None = None


def read_point_file(path: Path) -> list[PointRow]:
    """Read a file of control points: CSV, OpenDroneMap or QGIS, recognised by its content.

    Raises:
        GeoreferenceError: there is no such file, or it or one of its lines cannot be read.
    """
    try:
        with refuse_damaged(path, GeoreferenceError, "a table of control points", reads_once=True):
            return _parse_points(path.read_bytes(), path)
    except OSError as error:
        raise GeoreferenceError(f"{path}: cannot be read ({error}).") from error


def _parse_points(content: bytes, path: Path) -> list[PointRow]:
    """Parse a file of control points in any of the formats."""
    if content.startswith(b"PK"):
        raise GeoreferenceError(f"{path}: is an Excel workbook; save the sheet as CSV.")
    numbered = [
        (number, trim_comment(line) if re.match(COMMENT, line) else line.strip(" "))
        for number, line in enumerate(decode_text(content).splitlines(), 1)
        if line.strip(' \t,;"') and not re.match(r'\s*"?sep=', line, re.I)
    ]
    rows_of_points = [(number, line) for number, line in numbered if not line.startswith("#")]
    if not rows_of_points:
        raise GeoreferenceError(f"{path}: holds no control points.")
    if len(rows_of_points) > MAX_ROWS:
        raise GeoreferenceError(
            f"{path}: has {len(rows_of_points)} rows; up to {MAX_ROWS} control points are read."
            " Give those of one video."
        )
    crs = _find_comment(numbered, "crs")[1]
    number, text = _find_comment(numbered, "accuracy")
    accuracy = 0.0 if text is None else _parse_accuracy(text, f"{path}, line {number}")
    header = rows_of_points[0][1]
    if re.match(r"mapx\W", header, re.I):
        return _read_qgis(rows_of_points, crs, path)
    if odm_crs := _parse_odm_crs(header):
        return _read_odm(rows_of_points, odm_crs, path)
    number, text = _find_comment(numbered, SHARED_COVARIANCE)
    shared = None if text is None else _parse_covariance(text, f"{path}, line {number}")
    rows = _read_csv(rows_of_points, crs, path)
    return [
        replace(row, accuracy=max(row.accuracy, accuracy), shared_covariance=shared) for row in rows
    ]


def _find_comment(numbered: Lines, key: str) -> tuple[int, str | None]:
    """The first line "# key: text" and its number; None where there is none."""
    for number, line in numbered:
        if match := re.match(rf"#\s*{key}:\s*(.+)", line, re.I):
            return number, match[1]
    return 0, None


def _parse_accuracy(text: str, source: str) -> float:
    """Parse metres, with or without the unit."""
    if (accuracy := _parse_number(text.removesuffix("m").replace(",", "."), source)) < 0.0:
        raise GeoreferenceError(f"{source}: accuracy {text!r}; metres, 0 or more, are needed.")
    return accuracy


def _parse_covariance(text: str, source: str) -> Float[Array, "2 2"]:
    """Parse the variance east, the covariance and the variance north, square metres."""
    numbers = [_parse_number(word, source) for word in text.replace(",", " ").split()]
    if len(numbers) == 3:
        east, both, north = numbers
        if east >= 0 and north >= 0 and east * north >= both**2:
            return np.array([[east, both], [both, north]])
    raise GeoreferenceError(
        f"{source}: {SHARED_COVARIANCE} {text!r}; the variance east, the covariance and the"
        " variance north are needed, square metres."
    )


def _parse_odm_crs(header: str) -> str | None:
    """The CRS of an OpenDroneMap header, or None when the line is no such header."""
    header = trim_comment(header).strip("'")
    if (utm := UTM_HEADER.fullmatch(header)) and 1 <= int(utm[1]) <= 60:
        is_north = utm[2].upper() >= "N" and utm[2].upper() != "S"
        return f"EPSG:{(32600 if is_north else 32700) + int(utm[1])}"
    if epsg := re.fullmatch(r"EPSG\s*[:\s]\s*(\d+)", header, re.I):
        return f"EPSG:{epsg[1]}"
    if re.fullmatch(r"WGS\s*_?84|LAT\s*/?\s*LON(G)?", header, re.I):
        return LONLAT
    starts = ("+proj", "+init", "PROJCS", "PROJCRS", "GEOGCS", "GEOGCRS", "COMPD_CS", "COMPOUNDCRS")
    return header if header.upper().startswith(tuple(map(str.upper, starts))) else None


def _read_odm(content: Lines, crs: str, path: Path) -> list[PointRow]:
    rows = []
    for number, line in content[1:]:
        words, source = line.split(), f"{path}, line {number}"
        if len(words) < 6:
            words = line.replace(",", " ").split()
        if len(words) < 6:
            raise GeoreferenceError(
                f"{source}: {line!r} has {len(words)} fields; an OpenDroneMap line needs x, y, z,"
                " pixel x, pixel y and the image. Pick the point in an image first."
            )
        x, y, u, v = (_parse_number(words[i], source) for i in (0, 1, 3, 4))
        pixel = (u + ODM_PIXEL_SHIFT, v + ODM_PIXEL_SHIFT)
        rows.append(PointRow(pixel, (x, y), source, crs, " ".join(words[6:]), words[5]))
    return rows


def _read_qgis(content: Lines, crs: str | None, path: Path) -> list[PointRow]:
    # a column CRS, which QGIS 3.18 to 3.24 write, is quoted WKT with commas
    separator = "," if "," in content[0][1] else "\t"
    header = [name.strip().lower() for name in content[0][1].split(separator)]
    header = [name.replace("source", "pixel") for name in header]
    rows = []
    for number, line in content[1:]:
        source = f"{path}, line {number}"
        words = next(csv.reader([line], delimiter=separator))
        fields = dict(zip(header, (word.strip() for word in words), strict=False))
        if not set(QGIS_COLUMNS) <= set(fields):
            raise GeoreferenceError(f"{source}: {line!r} lacks one of the columns {header[:4]}.")
        if fields.get("enable", "1").lower() in ("0", "false"):
            continue
        x, y, u, up = (_parse_number(fields[key], source) for key in QGIS_COLUMNS)
        if up > 0:
            raise GeoreferenceError(
                f"{source}: {line!r} has a positive image y; QGIS counts pixels downwards as"
                " negative. Was the image georeferenced before? Pick on the plain image."
            )
        rows.append(PointRow((u, -up), (x, y), source, fields.get("crs") or crs))
    return rows


def _read_csv(content: Lines, crs: str | None, path: Path) -> list[PointRow]:
    separator = max(",;\t", key=content[0][1].count)
    try:
        table = list(csv.reader((line for _, line in content), delimiter=separator))
    except csv.Error as error:
        raise GeoreferenceError(
            f"{path}: not a table of control points ({error}). Give the file of points, or close"
            " the quotation mark that is open."
        ) from error
    if len(table) != len(content):
        raise GeoreferenceError(f"{path}: a quotation mark is not closed. Close or remove it.")
    header = [name.strip().lower() for name in table[0]]
    columns = find_columns(header, f"{path}, line {content[0][0]}")
    if crs is None and any(header[columns[key]] in DEGREE_COLUMNS for key in "xy"):
        crs = LONLAT
    rows = []
    for (number, line), fields in zip(content[1:], table[1:], strict=True):
        source = f"{path}, line {number}"
        if len(fields) <= max(columns[key] for key in "uvxy"):
            raise GeoreferenceError(f"{source}: {line!r} has too few fields.")
        values = {key: fields[at].strip() for key, at in columns.items() if at < len(fields)}
        if separator != ",":
            numbers = {key for key in ("u", "v", "x", "y", "accuracy") if key in values}
            commas = {key for key in numbers if re.fullmatch(r"[-+]?\d+,\d+", values[key])}
            values |= {key: values[key].replace(",", ".") for key in commas}
        if values.get("enable", "1").lower() not in OFF:
            rows.append(make_row({**values, "crs": values.get("crs") or crs}, source))
    return rows


def make_row(values: Mapping[str, Any], source: str) -> PointRow:
    """Make a row of the values u, v, x, y and, where stated, name, frame, crs and accuracy (m)."""
    u, v = _parse_pair(values["u"], values["v"], source)
    x, y = _parse_pair(values["x"], values["y"], source)
    name, frame = str(values.get("name") or ""), values.get("frame")
    frame = "" if frame is None else str(frame)
    accuracy = values.get("accuracy")
    sigma = 0.0 if accuracy in (None, "") else _parse_accuracy(str(accuracy), source)
    return PointRow((u, v), (x, y), source, values.get("crs"), name, frame, sigma)


def find_columns(header: Sequence[str], source: str) -> dict[str, int]:
    """Find the index of the columns u, v, x, y and, where present, name, frame and crs."""
    columns = {
        key: header.index(name)
        for key, names in COLUMN_NAMES.items()
        for name in names[::-1]
        if name in header
    }
    missing = [key for key in "uvxy" if key not in columns]
    if missing:
        named = [name for name in header if name]
        raise GeoreferenceError(
            f"{source}: no column for {', '.join(missing)} among {named}. Control points"
            " need u, v (or pixel_x, pixel_y; col, row) and x, y (or easting, northing; lon, lat)."
            " OpenDroneMap lists start with their CRS, such as EPSG:32635 or WGS84 UTM 35N, QGIS"
            " files with mapX."
        )
    return columns


def _parse_pair(first: Any, second: Any, source: str) -> tuple[float, float]:
    if first == second == "":
        return math.nan, math.nan
    return _parse_number(first, source), _parse_number(second, source)


def _parse_number(value: Any, source: str) -> float:
    """Parse a finite number, or raise GeoreferenceError."""
    with suppress(TypeError, ValueError):
        if abs(number := float(value)) < MAX_NUMBER:
            return number
    shown = str(value)[:40]
    raise GeoreferenceError(f"{source}: {shown!r} is not a usable number. Correct or remove it.")
