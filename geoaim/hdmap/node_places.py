"""Places of a lanelet2 map's nodes: degrees, degrees that stand for metres, or local metres."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import MapError
from geoaim.base.world import (
    LONLAT,
    World,
    choose_world,
    find_utm_crs,
    transform_crs,
    world_from_lonlat,
)

MAX_LOCAL_DEGREES = 0.1  # about (0, 0), within which degrees stand for local metres
LOCAL_CRS = "EPSG:32631"  # the CRS in which lanelet2's projector places such degrees
MAX_SPAN_DEGREES = 5.0  # of a map; what spans more is written in metres
MIN_EXTENT_M = 0.1  # of a map; nodes that are nearer lie at one place
MAX_SCALE_DIFFERENCE = 0.01  # between degrees and the local metres beside them

Texts = Sequence[str | None]  # two for each node


def locate_nodes(
    path: Path, ids: Sequence[str | None], lonlat: Texts, local: Texts, world: World | None
) -> tuple[Float[Array, "n 2"], World]:
    """Locate the nodes of a map."""
    if not ids:
        raise MapError(f"{path} has no nodes, the points of a map")
    degrees, metres = _parse_pairs(lonlat), _parse_pairs(local)
    has_degrees = np.isfinite(degrees).all() and bool((np.ptp(degrees, axis=0) > 0).any())
    if np.isfinite(metres).all() and not has_degrees:
        return _place_local(path, metres, world)
    wrong = ~np.isfinite(degrees).all(axis=1)
    if wrong.any():
        first = int(wrong.argmax())
        raise MapError(
            f"{path}: node {ids[first]} has lon {lonlat[2 * first]!r} and lat "
            f"{lonlat[2 * first + 1]!r}; two numbers of degrees are needed, or the tags local_x "
            "and local_y of every node"
        )
    _check_degrees(path, ids, degrees)
    is_local = bool((np.abs(degrees) < MAX_LOCAL_DEGREES).all())
    _check_kind(path, world, is_local=is_local)
    if is_local:
        world = world or World(None)
        corner = transform_crs(LONLAT, LOCAL_CRS, np.zeros((1, 2)))
        points = transform_crs(LONLAT, LOCAL_CRS, degrees) - corner - world.origin
    else:
        world = world or choose_world(degrees)
        points = world_from_lonlat(world, degrees)
    _check_extent(path, points)
    if np.isfinite(metres).all() and not is_local:
        _compare_scales(path, degrees, metres)
    return points, world


def _parse_pairs(texts: Texts) -> Float[Array, "n 2"]:
    return np.fromiter(map(_parse_number, texts), np.float64, len(texts)).reshape(-1, 2)


def _parse_number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return np.nan


def _place_local(
    path: Path, metres: Float[Array, "n 2"], world: World | None
) -> tuple[Float[Array, "n 2"], World]:
    """Place nodes by local_x and local_y, where latitude and longitude say nothing."""
    _check_kind(path, world, is_local=True)
    world = world or World(None)
    points = metres - world.origin
    _check_extent(path, points)
    return points, world


def _check_kind(path: Path, world: World | None, *, is_local: bool) -> None:
    if world is not None and is_local == (world.crs is not None):
        kind = "local metres" if is_local else "longitudes and latitudes"
        raise MapError(
            f"{path} has {kind}, and the world is {world.crs or 'a plane without a CRS'}; give a "
            "world of the same kind"
        )


def _check_degrees(path: Path, ids: Sequence[str | None], degrees: Float[Array, "n 2"]) -> None:
    """Refuse metres that were written as latitude and longitude."""
    wrong = (np.abs(degrees) > [180.0, 90.0]).any(axis=1)
    first, span = int(wrong.argmax()), float(np.ptp(degrees, axis=0).max())
    if wrong.any() or span > MAX_SPAN_DEGREES:
        lon, lat = degrees[first].tolist()
        raise MapError(
            f"{path}: node {ids[first]} has lon {lon:g} and lat {lat:g}, and all span {span:g}: "
            "these are no degrees. Write metres as the tags local_x and local_y, or degrees as lon "
            "and lat"
        )


def _check_extent(path: Path, points: Float[Array, "n 2"]) -> None:
    if len(points) > 1 and not np.ptp(points, axis=0).max() > MIN_EXTENT_M:
        raise MapError(
            f"{path} has all of its {len(points)} nodes at one place; their lat and lon are needed,"
            " or the tags local_x and local_y of every node"
        )


def _compare_scales(path: Path, degrees: Float[Array, "n 2"], metres: Float[Array, "n 2"]) -> None:
    """Refuse degrees and local metres that are not of the same map."""
    zone = find_utm_crs(float(degrees[0, 0]), float(degrees[0, 1]))
    sizes = [
        float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())
        for points in (transform_crs(LONLAT, zone, degrees), metres)
    ]
    if abs(sizes[0] - sizes[1]) > MAX_SCALE_DIFFERENCE * max(sizes):
        raise MapError(
            f"{path}: its nodes lie {sizes[0]:.4g} m from their middle on average by lat and lon, "
            f"and {sizes[1]:.4g} m by local_x and local_y; remove those that are wrong"
        )
