"""Ground control points: where a pixel lies on the ground. Readers of the usual files.

| source | pixels in it | coordinates |
|---|---|---|
| CSV with a header: `u,v` or `pixel_x,pixel_y` or `col,row`; `x,y` or `easting,northing` or `lon,lat`; optional `name`, `frame`, `crs`, or a line `# crs: EPSG:n` | corner origin | `lon,lat` need no CRS |
| OpenDroneMap `gcp_list.txt`: CRS, then `x y z u v image [name]` | origin at the first pixel's centre, as OpenSfM reads them: half a pixel is added | first line |
| QGIS `.points` | corner origin, y up: its sign is turned | `#CRS:` line, or the argument |
| rasterio or GDAL GroundControlPoint | corner origin (GDAL's pixel and line) | the argument |
| pairs `((u, v), (lon, lat))`, mappings with the CSV's names | corner origin | lon, lat unless the argument says otherwise |

`crs="local"` means a metric plane of its own, without a place on the Earth.
"""  # noqa: E501

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoreferenceError
from geoaim.world import LONLAT, parse_crs

NAMES = {
    "u": ("u", "pixel_x", "pixelx", "col", "column", "px", "im_x"),
    "v": ("v", "pixel_y", "pixely", "row", "line", "py", "im_y"),
    "x": ("x", "easting", "east", "lon", "longitude", "lng", "mapx", "geo_x"),
    "y": ("y", "northing", "north", "lat", "latitude", "mapy", "geo_y"),
    "name": ("name", "id", "label", "point", "gcp"),
    "frame": ("frame", "image", "image_name", "img"),
    "crs": ("crs", "epsg", "srs"),
}
DEGREES = {"lon", "longitude", "lng", "lat", "latitude"}
HALF = 0.5


@dataclass(frozen=True)
class ControlPoints:
    """Ground control points.

    Attributes:
        pixels: (M, 2) u right, v down, origin at the image's corner.
        coordinates: (M, 2) x, y (or longitude, latitude) in `crs`.
        crs: what the coordinates are in; None for a metric plane of its own.
        names: (M,) what messages call the points.
        frames: (M,) image name or frame index that each was picked on; None is the video's
            first.
    """

    pixels: Float[Array, "m 2"]
    coordinates: Float[Array, "m 2"]
    crs: str | None
    names: tuple[str, ...]
    frames: tuple[str | int | None, ...]


Row = dict[str, Any]  # u, v, x, y, where; and name, frame, crs where known


def read_control_points(source: Any, *, crs: str | None = None) -> ControlPoints:
    """Control points from a file or from Python objects; the kind is told by the content.

    Args:
        source: a path, ControlPoints, a sequence of rasterio GroundControlPoint (or the pair with
            its CRS that `dataset.gcps` gives), of `((u, v), (lon, lat))`, or of mappings.
        crs: CRS of the coordinates where the source does not say it; "local" for a plane of its
            own. It must agree with the source when both say it.

    Raises:
        GeoreferenceError: a line cannot be read, is not finite, or the CRS is missing or mixed.

    >>> read_control_points([((10, 20), (27.5, 53.9))]).crs
    'EPSG:4326'
    """
    if isinstance(source, ControlPoints):
        return source if crs is None else replace(source, crs=_one_crs([source.crs, crs]))
    if isinstance(source, str | Path):
        return _from_rows(_read_file(Path(source)), crs, str(source))
    if isinstance(source, tuple) and len(source) == 2 and _is_gcps(source[0]):
        stated = source[1].to_string() if source[1] else None
        return _from_rows(_object_rows(source[0]), crs or stated, "control points")
    return _from_rows(_object_rows(source), crs, "control points")


def _is_gcps(items: Any) -> bool:
    return isinstance(items, Sequence) and len(items) > 0 and hasattr(items[0], "row")


def _read_file(path: Path) -> list[Row]:
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise GeoreferenceError(f"{path}: cannot be read as text ({error}).") from error
    numbered = [(number, line.strip()) for number, line in enumerate(lines, 1) if line.strip()]
    content = [(number, line) for number, line in numbered if not line.startswith("#")]
    if not content:
        raise GeoreferenceError(f"{path}: holds no control points.")
    stated = next((m[1] for _, line in numbered if (m := re.match(r"#\s*crs:\s*(.+)", line, re.I))),
                  None)  # fmt: skip
    first = content[0][1]
    if re.match(r"mapx\W", first, re.I):
        return _qgis_rows(content, stated, path)
    if _odm_crs(first):
        return _odm_rows(content, path)
    return _csv_rows(content, stated, path)


def _odm_crs(line: str) -> str | None:
    """The CRS that an OpenDroneMap header names, or None when the line is no such header."""
    if utm := re.fullmatch(r"WGS84\s+UTM\s+(\d{1,2})\s*([NS])", line, re.I):
        return f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}"
    if re.fullmatch(r"EPSG:\d+", line, re.I) or line.startswith(("+proj", "+init", "PROJCS")):
        return line
    return None


def _odm_rows(content: list[tuple[int, str]], path: Path) -> list[Row]:
    rows = []
    for number, line in content[1:]:
        words = line.split()
        if len(words) < 6:
            raise GeoreferenceError(
                f"{path}, line {number}: {line!r} has {len(words)} fields; an OpenDroneMap line"
                " needs x, y, z, pixel x, pixel y and the image. Pick the point in an image first."
            )
        x, y, _, u, v, image, *rest = words
        where = f"{path}, line {number}"
        row: Row = {"x": x, "y": y, "u": u, "v": v, "frame": image, "shift": HALF, "where": where}
        rows.append({**row, "name": " ".join(rest), "crs": _odm_crs(content[0][1])})
    return rows


def _qgis_rows(content: list[tuple[int, str]], crs: str | None, path: Path) -> list[Row]:
    separator = "," if "," in content[0][1] else "\t"
    header = [name.strip().lower() for name in content[0][1].split(separator)]
    header = [name.replace("source", "pixel") for name in header]
    rows = []
    for number, line in content[1:]:
        where = f"{path}, line {number}"
        fields = dict(zip(header, (f.strip() for f in line.split(separator)), strict=False))
        if not {"mapx", "mapy", "pixelx", "pixely"} <= set(fields):
            raise GeoreferenceError(f"{where}: {line!r} lacks one of the columns {header[:4]}.")
        if fields.get("enable", "1").lower() in ("0", "false"):
            continue
        down = -_number(fields["pixely"], where)
        if down < 0:
            raise GeoreferenceError(
                f"{where}: {line!r} has a positive image y; QGIS counts pixels downwards as"
                " negative. Was the picture georeferenced before? Pick on the plain picture."
            )
        row: Row = {"x": fields["mapx"], "y": fields["mapy"], "u": fields["pixelx"], "v": down}
        rows.append({**row, "crs": crs, "where": where})
    return rows


def _csv_rows(content: list[tuple[int, str]], crs: str | None, path: Path) -> list[Row]:
    first = content[0][1]
    separator = max(",;\t", key=first.count)
    table = list(csv.reader((line for _, line in content), delimiter=separator))
    columns = _columns([name.strip().lower() for name in table[0]], f"{path}, line {content[0][0]}")
    degrees = any(table[0][columns[key]].strip().lower() in DEGREES for key in "xy")
    rows = []
    for (number, line), fields in zip(content[1:], table[1:], strict=True):
        if len(fields) <= max(columns[key] for key in "uvxy"):
            raise GeoreferenceError(f"{path}, line {number}: {line!r} has too few fields.")
        row: Row = {key: fields[at].strip() for key, at in columns.items() if at < len(fields)}
        row["crs"] = row.get("crs") or crs or (LONLAT if degrees else None)
        rows.append({**row, "where": f"{path}, line {number}"})
    return rows


def _columns(header: Sequence[str], where: str) -> dict[str, int]:
    columns = {
        key: header.index(name)
        for key, names in NAMES.items()
        for name in names[::-1]
        if name in header
    }
    missing = [key for key in "uvxy" if key not in columns]
    if missing:
        raise GeoreferenceError(
            f"{where}: no column for {', '.join(missing)} among {list(header)}. Control points need"
            " u, v (or pixel_x, pixel_y; col, row) and x, y (or easting, northing; lon, lat)."
            " OpenDroneMap lists start with their CRS, QGIS files with mapX."
        )
    return columns


def _object_rows(items: Iterable[Any]) -> list[Row]:
    rows: list[Row] = []
    for index, item in enumerate(items):
        where = f"control point {index}"
        if hasattr(item, "row") and hasattr(item, "col"):
            row: Row = {"u": item.col, "v": item.row, "x": item.x, "y": item.y, "crs": None}
            name = getattr(item, "id", None) or ""
            rows.append({**row, "name": "" if re.fullmatch(r"[0-9a-f-]{36}", name) else name})
        elif isinstance(item, Mapping):
            keys = [str(key).lower() for key in item]
            values = list(item.values())
            rows.append({key: values[at] for key, at in _columns(keys, where).items()})
            if DEGREES & set(keys):
                rows[-1].setdefault("crs", LONLAT)
        else:
            try:
                (u, v), (x, y) = item
            except (TypeError, ValueError):
                raise TypeError(f"{where}: {item!r} is no ((u, v), (lon, lat)) pair.") from None
            rows.append({"u": u, "v": v, "x": x, "y": y, "pair": True})
        rows[-1]["where"] = where
    return rows


def _from_rows(rows: list[Row], crs: str | None, source: str) -> ControlPoints:
    if not rows:
        raise GeoreferenceError(f"{source}: holds no control points.")
    stated = [row.get("crs") or crs or (LONLAT if row.get("pair") else None) for row in rows]
    if crs is not None:
        stated.append(crs)
    if None in stated:
        raise GeoreferenceError(
            f"{rows[stated.index(None)]['where']}: no coordinate reference system. Pass crs="
            "'EPSG:n', write '# crs: EPSG:n' in the file, or use 'local' for a plane of its own."
        )
    numbers = np.array([[_number(row[k], row["where"]) for k in "uvxy"] for row in rows])
    shift = np.array([[row.get("shift", 0.0)] for row in rows])
    names = [str(row.get("name") or f"point {number}") for number, row in enumerate(rows, 1)]
    frames = tuple(_frame(row.get("frame")) for row in rows)
    one = _one_crs(stated)
    return ControlPoints(numbers[:, :2] + shift, numbers[:, 2:], one, tuple(names), frames)


def _number(text: Any, where: str) -> float:
    try:
        number = float(text)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        raise GeoreferenceError(f"{where}: {text!r} is not a finite number. Correct or remove it.")
    return number


def _frame(value: Any) -> str | int | None:
    text = "" if value is None else str(value).strip()
    return int(text) if text.isdecimal() else text or None


def _one_crs(stated: Sequence[Any]) -> str | None:
    """The one CRS that all of them name, as "EPSG:n" where it has such a code."""
    texts = {str(crs) if not str(crs).isdecimal() else f"EPSG:{crs}" for crs in stated}
    local = {text for text in texts if text.lower() in ("local", "none")}
    parsed = [parse_crs(text) for text in sorted(texts - local)]
    if (local and parsed) or any(not crs.equals(parsed[0], True) for crs in parsed):
        raise GeoreferenceError(
            f"The control points are in different CRSs: {', '.join(sorted(texts))}. Bring them into"
            " one, for example with pyproj or QGIS."
        )
    if local:
        return None
    epsg = parsed[0].to_epsg()
    return f"EPSG:{epsg}" if epsg else sorted(texts)[0]


def merge_observations(points: ControlPoints) -> ControlPoints:
    """One point for each place that was picked on several frames: the mean of its pixels.

    Call it when the pixels have been brought into one image. A place that appears twice on the
    same frame is left as it is, for `georeference` to refuse.
    """
    _, group = np.unique(points.coordinates, axis=0, return_inverse=True)
    keep, pixels = [], []
    for index in range(len(group)):
        same = np.flatnonzero(group == group[index])
        alone = len({points.frames[i] for i in same}) < len(same)
        if alone or index == same[0]:
            keep.append(index)
            pixels.append(points.pixels[index] if alone else points.pixels[same].mean(axis=0))
    names = tuple(points.names[i] for i in keep)
    frames = tuple(points.frames[i] for i in keep)
    return replace(points, pixels=np.array(pixels), coordinates=points.coordinates[keep],
                   names=names, frames=frames)  # fmt: skip
