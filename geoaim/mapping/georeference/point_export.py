"""Write control points as CSV, or as the lists of OpenDroneMap and QGIS.

Only the CSV keeps everything: names, the frame, points of which the pixel or the place is not
picked yet (empty fields), and a local plane. QGIS knows no names, OpenDroneMap no local plane.
"""

import csv
import io
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from geoaim.base.errors import GeoreferenceError, warn
from geoaim.base.files import atomic_write
from geoaim.base.world import LONLAT, transform_crs
from geoaim.mapping.georeference.control_points import ControlPoints, select_points
from geoaim.mapping.georeference.point_files import ODM_PIXEL_SHIFT, SHARED_COVARIANCE


def write_control_points(points: ControlPoints, path: str | Path) -> None:
    """Write control points to a file, whole or not at all; the format follows from its name.

    Args:
        points: the points; NaN where a pixel or a place is not picked yet, which .csv alone keeps.
        path: `.csv` with the columns name, u, v, and lon, lat or x, y; `.txt` is OpenDroneMap's
            list (`gcp_list.txt`), `.points` that of QGIS.

    Raises:
        GeoreferenceError: the format cannot state the points' CRS, or no point is complete.
        ValueError: the name has another ending.
    """
    if Path(path).suffix not in FORMATS:
        raise ValueError(f"{path}: the name must end in {', '.join(FORMATS)}")
    text = format_points(points, Path(path).suffix)
    with atomic_write(path, shared=True) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def format_points(points: ControlPoints, suffix: str) -> str:
    """Format control points as the text of a file; `suffix` is ".csv", ".txt" or ".points".

    Raises:
        GeoreferenceError: see `write_control_points`.
    """
    return FORMATS[suffix](points)


def clean_text(text: str) -> str:
    """Make a name one line without control characters, which every format can hold."""
    printable = "".join(c if c.isprintable() else " " for c in text)
    return " ".join(printable.split())[:200]


def _format_csv(points: ControlPoints) -> str:
    file = io.StringIO()
    lonlat, framed = points.crs == LONLAT, any(frame is not None for frame in points.frames)
    if not lonlat:
        file.write(f"# crs: {_format_crs(points.crs)}\n")
    if points.accuracy:
        file.write(f"# accuracy: {points.accuracy!r}\n")
    if (shared := points.shared_covariance) is not None:
        numbers = " ".join(f"{value:.6g}" for value in (shared[0, 0], shared[0, 1], shared[1, 1]))
        file.write(f"# {SHARED_COVARIANCE}: {numbers}\n")
    file.write(f"name,u,v,{'lon,lat' if lonlat else 'x,y'}{',frame' if framed else ''}\n")
    # texts in quotes, so that a name may begin with "#" or hold a comma
    table = csv.writer(file, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    for i, numbers in enumerate(np.hstack([points.pixels, points.coordinates]).tolist()):
        fields = ["" if math.isnan(number) else number for number in numbers]
        frame = "" if points.frames[i] is None else str(points.frames[i])
        table.writerow([clean_text(points.names[i]), *fields, *[clean_text(frame)] * framed])
    return file.getvalue()


def _format_odm(points: ControlPoints) -> str:
    if points.crs is None:
        raise GeoreferenceError(
            "OpenDroneMap's list needs a CRS, and these control points lie in a local plane. Save"
            " them as .csv"
        )
    crs, points = points.crs, _select_complete(points)
    coordinates = points.coordinates
    if not re.fullmatch(r"EPSG:\d+", crs):
        crs, coordinates = LONLAT, transform_crs(crs, LONLAT, coordinates)
    lines = [crs]
    for i, (x, y) in enumerate(coordinates.tolist()):
        u, v = (points.pixels[i] - ODM_PIXEL_SHIFT).tolist()
        image = "_".join(clean_text(str(points.frames[i] or 0)).split())
        lines.append(f"{x!r} {y!r} NaN {u!r} {v!r} {image} {clean_text(points.names[i])}")
    return "\n".join(lines) + "\n"


def _format_qgis(points: ControlPoints) -> str:
    points = _select_complete(points)
    rows = np.hstack([points.coordinates, points.pixels * [1.0, -1.0]]).tolist()
    header = "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"
    lines = [f"#CRS: {_format_crs(points.crs)}", header]
    lines += [",".join(map(repr, row)) + ",1,0,0,0" for row in rows]
    return "\n".join(lines) + "\n"


def _format_crs(crs: str | None) -> str:
    return "local" if crs is None else " ".join(crs.split())


def _select_complete(points: ControlPoints) -> ControlPoints:
    complete = np.isfinite(np.hstack([points.pixels, points.coordinates])).all(axis=1)
    if not complete.any():
        raise GeoreferenceError("No control point has both a pixel and a place yet")
    if not complete.all():
        names = ", ".join(points.names[i] for i in np.flatnonzero(~complete))
        warn(f"this format holds complete control points only; left out: {names}")
    return select_points(points, np.flatnonzero(complete).tolist())


FORMATS: dict[str, Callable[[ControlPoints], str]] = {
    ".csv": _format_csv,
    ".txt": _format_odm,
    ".points": _format_qgis,
}
