"""Ground control points: pixels with known coordinates.

docs/formats/control_points.md lists all formats, their pixel origins and how they state a CRS.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS

from geoaim.base.errors import GeoreferenceError, name_option, warn
from geoaim.base.limits import name_file
from geoaim.base.world import LONLAT, parse_crs
from geoaim.mapping.georeference import point_files

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class ControlPoints:
    """Ground control points."""

    pixels: Float[Array, "m 2"]  # u right, v down, origin at the image's corner
    coordinates: Float[Array, "m 2"]  # x, y (or longitude, latitude) in `crs`
    crs: str | None  # CRS of the coordinates; None for a local metric plane
    names: tuple[str, ...]  # (M,) names of the points, for messages
    # (M,) image name or frame index that each was picked on; None is the video's first
    frames: tuple[str | int | None, ...]
    # one sigma of the coordinates, metres; it counts where it is more than picking is off (2 px)
    accuracy: float = 0.0
    # covariance of an error that all points share, square metres east and north: that of the
    # imagery they were picked on; None where they state none
    shared_covariance: Float[Array, "2 2"] | None = None
    # inverse covariances of the points up to one factor, east and north; None: all count alike
    information: Float[Array, "m 2 2"] | None = None
    redundancy: float = 1.0  # points that tell as much as one, since their errors are alike
    common_error: float = 0.0  # one sigma by which all points err together, metres


# What `read_control_points` reads: a file, points of Python, or `dataset.gcps` of rasterio.
ControlPointSource = (
    str
    | Path
    | ControlPoints
    | Iterable[GroundControlPoint | Mapping[str, Any] | Sequence[Sequence[float]]]
    | tuple[Sequence[GroundControlPoint], CRS | None]
)


def read_control_points(
    source: ControlPointSource, *, crs: str | None = None, keep_incomplete: bool = False
) -> ControlPoints:
    """Read control points from a file or from Python objects; the format follows from the content.

    Args:
        source: a path, ControlPoints, a sequence of rasterio GroundControlPoint (or the pair with
            its CRS that `dataset.gcps` gives), of `((u, v), (lon, lat))`, or of mappings with the
            columns of a file as keys (u, v, x, y, name, frame, crs); a DataFrame with these
            columns, or a GeoDataFrame with u, v and points.
        crs: CRS of the coordinates where the source does not state it; "local" for a local
            plane. Where both state it, they must agree.
        keep_incomplete: keep points whose pixel or place is empty, as NaN; else they are left out
            with a warning.

    Returns:
        The points; those without a name are called "point 1", ...

    Raises:
        GeoreferenceError: there is no such file, a line cannot be read, is not finite, or the CRS
            is missing or mixed.
        TypeError: an item is no control point.

    >>> read_control_points([((10, 20), (27.5, 53.9))]).crs
    'EPSG:4326'
    """
    if isinstance(source, ControlPoints):
        return source if crs is None else replace(source, crs=_merge_crs([source.crs, crs]))
    if isinstance(source, str | Path):
        rows = point_files.read_point_file(Path(source))
        with name_file(source):
            rows = rows if keep_incomplete else _leave_out_incomplete(rows, str(source))
            return _collect_points(rows, crs, str(source))
    if hasattr(source, "iloc"):  # a table of pandas, which is not imported for this question
        table: Any = source
        source, crs = _read_table(table, crs)
    if isinstance(source, tuple) and len(source) == 2 and isinstance(source[1], CRS | None):
        source, dataset_crs = source
        crs = crs or (dataset_crs.to_string() if dataset_crs else None)
    return _collect_points(_read_objects(source, crs), crs, "control points")


def _read_table(
    table: "pd.DataFrame", crs: str | None
) -> tuple[list[Mapping[str, Any]], str | None]:
    """Rows of a table of pandas; of geopandas with the coordinates and the CRS of its points."""
    geometry: Any = getattr(table, "geometry", None)
    if geometry is None:
        return _list_rows(table), crs
    own = None if geometry.crs is None else geometry.crs.to_string()
    columns = table.drop(columns=geometry.name).assign(x=geometry.x, y=geometry.y)
    return _list_rows(columns), crs or own


def _list_rows(table: "pd.DataFrame") -> list[Mapping[str, Any]]:
    rows = table.to_dict("records")
    return [{str(name): value for name, value in row.items()} for row in rows]


def _read_objects(items: Iterable[Any], crs: str | None) -> list[point_files.PointRow]:
    rows = []
    for index, item in enumerate(items):
        source = f"control point {index}"
        if hasattr(item, "row") and hasattr(item, "col"):
            name = getattr(item, "id", None) or ""
            name = "" if re.fullmatch(r"[0-9a-f-]{36}", name) else name  # rasterio's random one
            values = {"u": item.col, "v": item.row, "x": item.x, "y": item.y, "name": name}
            rows.append(point_files.make_row(values, source))
        elif isinstance(item, Mapping):
            keys, listed = [str(key).lower() for key in item], list(item.values())
            values = {key: listed[at] for key, at in point_files.find_columns(keys, source).items()}
            lonlat = LONLAT if point_files.DEGREE_COLUMNS & set(keys) else None
            rows.append(point_files.make_row({"crs": lonlat, **values}, source))
        else:
            try:
                (u, v), (x, y) = item
            except (TypeError, ValueError):
                raise TypeError(f"{source}: {item!r} is not a ((u, v), (lon, lat)) pair") from None
            values = {"u": u, "v": v, "x": x, "y": y, "crs": crs or LONLAT}
            rows.append(point_files.make_row(values, source))
    return rows


def _collect_points(
    rows: list[point_files.PointRow], crs: str | None, source: str
) -> ControlPoints:
    if not rows:
        raise GeoreferenceError(f"{source}: holds no control points.")
    stated = [row.crs or crs for row in rows]
    if None in stated:
        raise GeoreferenceError(
            f"{rows[stated.index(None)].source}: no coordinate reference system. Write the line "
            "'# crs: EPSG:n' into the file, or '# crs: local' for a local plane"
            f"{name_option('', ' (or give crs=)')}."
        )
    frames = [row.frame.strip() for row in rows]
    return ControlPoints(
        pixels=np.array([row.pixel for row in rows]),
        coordinates=np.array([row.coordinates for row in rows]),
        crs=_merge_crs(stated if crs is None else [*stated, crs]),
        names=tuple(row.name or f"point {number}" for number, row in enumerate(rows, 1)),
        frames=tuple(map(_parse_frame, frames)),
        accuracy=max(row.accuracy for row in rows),
        shared_covariance=rows[0].shared_covariance,
    )


def _parse_frame(text: str) -> str | int | None:
    """The number of a frame, or the name of an image; Python makes no number of 5000 digits."""
    # a number of 64 bits has 19 digits
    return int(text) if text.isdecimal() and len(text) < 19 else text or None


def _leave_out_incomplete(
    rows: list[point_files.PointRow], source: str
) -> list[point_files.PointRow]:
    """The rows that state both a pixel and a place; a warning names the others."""
    is_complete = [math.isfinite(sum((*row.pixel, *row.coordinates))) for row in rows]
    complete = [row for row, whole in zip(rows, is_complete, strict=True) if whole]
    left_out = [r.name or r.source for r, whole in zip(rows, is_complete, strict=True) if not whole]
    if left_out and not complete:
        raise GeoreferenceError(
            f"{source}: no control point has both a pixel and a place: {', '.join(left_out)}"
        )
    if left_out:
        warn(f"{source}: without a pixel or a place, and left out: {', '.join(left_out)}")
    return complete


def _merge_crs(stated: Sequence[Any]) -> str | None:
    """The one CRS that all of them name, as "EPSG:n" where it has such a code; None for local."""
    texts = {str(crs) if not str(crs).isdecimal() else f"EPSG:{crs}" for crs in stated}
    local = {text for text in texts if text.lower() in ("local", "none")}
    parsed = [parse_crs(text) for text in sorted(texts - local)]
    if (local and parsed) or any(not crs.equals(parsed[0], True) for crs in parsed):
        raise GeoreferenceError(
            f"The control points are in different CRSs: {', '.join(sorted(texts))}. Transform them"
            " to one, for example with pyproj or QGIS."
        )
    if local:
        return None
    epsg = parsed[0].to_epsg()
    return f"EPSG:{epsg}" if epsg else sorted(texts)[0]


def merge_observations(points: ControlPoints) -> ControlPoints:
    """Merge points of equal coordinates that were picked on several frames, at the median pixel."""
    _, group, counts = np.unique(
        points.coordinates, axis=0, return_inverse=True, return_counts=True
    )
    pixels, keep = points.pixels.copy(), []
    for same in np.split(np.argsort(group.ravel(), kind="stable"), np.cumsum(counts)[:-1]):
        if len({points.frames[i] for i in same}) < len(same):  # repeated, which checks refuse
            keep += same.tolist()
        else:
            keep.append(int(same[0]))
            pixels[same[0]] = np.median(points.pixels[same], axis=0)
    return select_points(replace(points, pixels=pixels), sorted(keep))


def select_points(points: ControlPoints, indices: Sequence[int]) -> ControlPoints:
    """Keep the control points with these indices."""
    return replace(
        points,
        pixels=points.pixels[indices],
        coordinates=points.coordinates[indices],
        names=tuple(points.names[i] for i in indices),
        frames=tuple(points.frames[i] for i in indices),
        information=None if points.information is None else points.information[list(indices)],
    )
