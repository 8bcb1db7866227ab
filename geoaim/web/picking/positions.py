"""Check and convert the positions (pixels and places) that a page's action states."""

from collections.abc import Mapping
from typing import Any, TypedDict

import numpy as np

from geoaim.aim.aim import AIM
from geoaim.base.geometry import transform_points
from geoaim.base.world import LONLAT, crs_from_world, transform_crs
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.point_checks import check_coordinates
from geoaim.mapping.georeference.point_files import MAX_NUMBER
from geoaim.web.picking.session import Vector
from geoaim.web.picking.task import PickingTask


class Position(TypedDict, total=False):
    """A pixel of the frame, a place in the task's CRS, or both."""

    pixel: Vector
    place: Vector


def read_position(task: PickingTask, action: Mapping[str, Any]) -> Position:
    """Read the pixel and the place that an action states; either may be missing.

    Raises:
        ValueError: there is neither, or one is not finite, outside its image, or not in the CRS.
        GeoreferenceError: a place cannot be expressed in the task's CRS, or lies outside its area.
    """
    position: Position = {}
    if "u" in action and action.get("side") == "imagery":
        imagery = require_imagery(task)
        pixel = _check_inside(read_pair(action, "u", "v"), imagery.image.shape[:2])
        metres = transform_points(imagery.world_from_image, np.array([pixel]))
        position["place"] = _first(crs_from_world(imagery.world, metres, task.crs))
    elif "u" in action:
        position["pixel"] = _check_inside(read_pair(action, "u", "v"), task.frame.shape[:2])
    if "x" in action:
        position["place"] = read_pair(action, "x", "y")
    elif "lon" in action:
        if task.crs is None:
            raise ValueError("these control points lie in a local plane: give x and y, in metres")
        lonlat = np.array([read_pair(action, "lon", "lat")])
        position["place"] = _first(transform_crs(LONLAT, task.crs, lonlat))
    if not position:
        raise ValueError("no position: u and v, x and y, or lon and lat are needed")
    if "place" in position:
        place = np.array([position["place"]])
        check_coordinates(ControlPoints(np.zeros((1, 2)), place, task.crs, ("not saved",), (None,)))
    return position


def read_pair(action: Mapping[str, Any], first: str, second: str) -> Vector:
    """Read two finite numbers of an action.

    Args:
        action: plain JSON.
        first: key of the first number.
        second: key of the second one.

    Returns:
        Both.

    Raises:
        ValueError: one is missing, no number, or not finite.
    """
    for key in (first, second):
        number: Any = action.get(key)
        if type(number) not in (int, float) or not abs(number) < MAX_NUMBER:
            raise ValueError(f"{key} is {str(number)[:40]!r}; a finite number is needed")
    return float(action[first]), float(action[second])


def require_imagery(task: PickingTask) -> AIM:
    """Return the imagery of a task.

    Raises:
        ValueError: it has none.
    """
    if task.imagery is None:
        raise ValueError("no imagery was given: type coordinates, or name imagery at the start")
    return task.imagery


def _check_inside(pixel: Vector, size: tuple[int, ...]) -> Vector:
    height, width = size
    if not (0 <= pixel[0] <= width and 0 <= pixel[1] <= height):
        raise ValueError(f"({pixel[0]:g}, {pixel[1]:g}) lies outside {width} x {height} pixels")
    return pixel


def _first(points: np.ndarray) -> Vector:
    x, y = points[0].tolist()
    return x, y
