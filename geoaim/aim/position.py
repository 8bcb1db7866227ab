"""How well the position of a map is known, as its report states it and for as long as it holds.

The entry "position" of a report goes through every step: from control points to the map, from a map
to what is aligned to it, to textures and to points that are picked on it. It holds only where the
map lay when it was stated, which the entry "place" keeps: a map that was moved since says so, and
what its report stated before is kept as history under "before_moving".
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.special import chdtri

from geoaim.base.errors import AimError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.grid import Grid
from geoaim.base.world import World, parse_crs

CHI2_1D, CHI2_2D = float(chdtri(1, 0.05)), float(chdtri(2, 0.05))  # 95 % quantiles: 3.84, 5.99
CLAIMS = ("position", "georeference", "alignment")  # entries that hold only for one place
MOVED = "moved since its position was stated"
MAX_MOVE_PX = 0.01  # a map that lies farther from its stated place was moved
MAX_CROP_PX = 1.0  # a map that was resampled may reach so far beyond the former one
ELONGATED = 1.5  # a region whose axes differ by a greater factor is described by both
Report = Mapping[str, Any]


def state_position(
    source: str,
    covariance: Float[Array, "2 2"] | None,
    *,
    relative_to: str | None = None,
    relative: Float[Array, "2 2"] | None = None,
) -> dict[str, Any]:
    """Make the entry "position" of a report: what placed the map, and how surely.

    Covariances are of a point of the map (square metres east and north): in the world, and relative
    to the reference that the map was aligned to; None where they are unknown.
    """
    entry = {"source": source, "covariance_m2": _to_list(covariance)}
    if relative_to is not None:
        entry |= {"relative_to": relative_to, "relative_covariance_m2": _to_list(relative)}
    return entry


def read_position_covariance(report: Report) -> Float[Array, "2 2"] | None:
    """Read the covariance of a point of a map in the world from its report, square metres.

    Returns:
        (2, 2) east and north; None where the report does not state it, or the map was moved since.

    >>> read_position_covariance({"source": "ortho.tif"}) is None
    True
    """
    stated = report.get("position", {}).get("covariance_m2")
    return None if stated is None else _read_covariance(stated)


def _read_covariance(value: Any) -> Float[Array, "2 2"]:
    covariance = np.array(value, float)
    if covariance.shape != (2, 2) or not np.isfinite(covariance).all():
        raise AimError(f"a covariance is {value!r}; two rows of two numbers are needed")
    return covariance


def bind_report(report: Report, grid: Grid) -> dict[str, Any]:
    """Bind what a report claims to the place of its map, or note that the map was moved since.

    Raises:
        AimError: the place that the report states is none.
    """
    if "place" in report:
        _check_place(report["place"])
    claims = {name: report[name] for name in CLAIMS if name in report}
    if not claims:
        return dict(report)
    if "place" not in report or not _has_moved(report["place"], grid):
        return {**report, "place": _describe_place(grid)}
    others = {name: value for name, value in report.items() if name not in CLAIMS}
    if report.get("position", {}).get("source") == MOVED:
        return {**report, "place": _describe_place(grid)}
    return {
        **others,
        "position": state_position(MOVED, None),
        "place": _describe_place(grid),
        "before_moving": {**claims, "place": report["place"]},
    }


def keep_place(report: Report, grid: Grid) -> dict[str, Any]:
    """Bind a report to a new grid of the same map, such as one that was rectified."""
    return {**report, "place": _describe_place(grid)} if "place" in report else dict(report)


def describe_covariance(covariance: Float[Array, "2 2"] | None) -> str:
    """Describe in words the region that holds a point of a map in 95 % of cases.

    >>> describe_covariance(np.diag([0.04, 0.04]))
    '±0.49 m'
    >>> describe_covariance(np.diag([0.04, 36.0]))
    '±0.49 m at azimuth 90°, ±15 m at 0°'
    """
    if covariance is None:
        return "unknown"
    variances, axes = np.linalg.eigh(np.asarray(covariance))
    least, most = np.sqrt(CHI2_2D * variances.clip(0.0))
    if most <= ELONGATED * max(least, 1e-9):
        return f"±{_round(float(most))} m"
    across, along = (f"{measure_azimuth(axis):.0f}°" for axis in axes.T)
    return f"±{_round(float(least))} m at azimuth {across}, ±{_round(float(most))} m at {along}"


def measure_azimuth(direction: Float[Array, "2"]) -> float:
    """Measure the azimuth of a line, degrees clockwise from north, from 0 to below 180."""
    azimuth = float(np.degrees(np.arctan2(direction[0], direction[1]))) % 180
    return 0.0 if round(azimuth) == 180 else azimuth


def _round(metres: float) -> str:
    return f"{metres:.2f}" if metres < 9.995 else f"{metres:.0f}"


def _to_list(covariance: Float[Array, "2 2"] | None) -> list[list[float]] | None:
    return None if covariance is None else np.asarray(covariance, float).tolist()


def _describe_place(grid: Grid) -> dict[str, Any]:
    """The size of a grid, and its transform from pixels to coordinates of its CRS."""
    world = grid.world or World(None)
    size = {"height": grid.height, "width": grid.width}
    return {"crs": world.crs, "crs_from_image": grid.crs_from_grid.tolist(), **size}


def _check_place(place: Any) -> None:
    """Refuse what `_describe_place` did not write."""
    try:
        matrix = np.array(place["crs_from_image"], float)
        sides = place["height"], place["width"]
        is_place = matrix.shape == (3, 3) and bool(np.isfinite(matrix).all())
        is_place = is_place and abs(np.linalg.det(matrix)) > 0
        is_place &= all(isinstance(side, int) and side > 0 for side in sides)
        is_place &= place["crs"] is None or isinstance(place["crs"], str)
    except (KeyError, TypeError, ValueError):
        is_place = False
    if not is_place:
        raise AimError(
            f"place is {place!r}; crs, crs_from_image (3 rows of 3 numbers), height and width "
            "(pixels) are needed; without the key the map counts as unmoved"
        )


def _has_moved(place: Report, grid: Grid) -> bool:
    """Whether a grid is neither the place that was described, nor a crop or a resampling of it."""
    now = _describe_place(grid)
    if place["crs"] != now["crs"] and not _equal_crs(place["crs"], now["crs"]):
        return True
    old_from_new = np.linalg.inv(place["crs_from_image"]) @ np.array(now["crs_from_image"])
    corners = transform_points(old_from_new, image_corners(*grid.shape))
    size = np.array([place["width"], place["height"]])
    if grid.shape == (place["height"], place["width"]):
        return bool(np.abs(corners - image_corners(*grid.shape)).max() > MAX_MOVE_PX)
    steps = corners - image_corners(*grid.shape)
    is_shifted = np.abs(steps - steps[0]).max() < MAX_MOVE_PX
    if is_shifted and np.abs(steps[0] - np.rint(steps[0])).max() < MAX_MOVE_PX:
        return False  # cropped or padded by whole pixels
    return bool((corners < -MAX_CROP_PX).any() or (corners > size + MAX_CROP_PX).any())


def _equal_crs(one: str | None, other: str | None) -> bool:
    return None not in (one, other) and parse_crs(str(one)).equals(parse_crs(str(other)), True)
