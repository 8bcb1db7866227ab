"""World: the local metric plane in which tracks live, a projected CRS and an origin."""

import re
import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from pyproj import CRS, Proj, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.exceptions import CRSError, ProjError
from pyproj.transformer import TransformerGroup

from geoaim.base.errors import GeoreferenceError, warn
from geoaim.base.limits import MAX_POSITION_M

LONLAT = "EPSG:4326"
ORIGIN_STEP_M = 100.0  # origins are multiples of this
# largest difference between a metre in the CRS and one on the ground, as a share
MAX_SCALE_ERROR = 0.01
# what makes PROJ open files: grids and legacy definitions; "@null" is no grid
CRS_FILES = re.compile(r"(?i)grids\s*=\s*(?!@null\b)|init\s*=\s*(?!epsg:\d)|PARAMETERFILE")
MAX_NAME_CHARS = 40  # a longer CRS text, such as WKT, is called by its name
MAX_AREA_DEGREES = 12.0  # a CRS for a wider area does not tell its UTM zone
# degrees that places may lie outside their CRS's area of use: one zone serves a whole country
AREA_MARGIN = 5.0
FOOT_M = 0.3048
METRES_PER_DEGREE = 111_320.0  # of latitude


@dataclass(frozen=True)
class World:
    """A metric plane, x east and y north, in metres from an origin.

    Attributes:
        crs: a projected CRS in metres ("EPSG:n", PROJ string or WKT); None for a local plane.
        origin: easting and northing of the world's (0, 0) in that CRS, metres.

    Raises:
        GeoreferenceError: the CRS is unknown, geographic, not in metres, or not x east y north; or
            the origin is not two finite numbers.
    """

    crs: str | None
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if np.shape(self.origin) != (2,) or not (np.abs(self.origin) <= MAX_POSITION_M).all():
            raise GeoreferenceError(
                f"The origin of a world is {self.origin}; two finite numbers, easting and northing,"
                " are needed."
            )
        if self.crs is not None and (problem := describe_crs_problem(self.crs, self.origin)):
            raise GeoreferenceError(problem)


@lru_cache(maxsize=64)
def parse_crs(crs: str) -> CRS:
    """Parse "EPSG:n", a PROJ string or WKT.

    Raises:
        GeoreferenceError: pyproj does not know it, or it names a file such as a grid.
    """
    if CRS_FILES.search(crs):
        raise GeoreferenceError(f"{crs[:200]!r} names a file; a CRS that needs none is needed.")
    try:
        return CRS.from_user_input(crs)
    except (CRSError, UnicodeError) as error:
        raise GeoreferenceError(
            f"{crs!r} is not a known coordinate reference system. Write for example 'EPSG:32635'."
        ) from error


@lru_cache(maxsize=64)
def _make_transformer(source: str, destination: str) -> Transformer:
    return Transformer.from_crs(parse_crs(source), parse_crs(destination), always_xy=True)


def find_utm_crs(longitude: float, latitude: float) -> str:
    """Find the EPSG code of the UTM zone (WGS 84) at a longitude and latitude in degrees.

    Raises:
        GeoreferenceError: there is no zone: a pole, or swapped latitude and longitude.

    >>> find_utm_crs(27.56, 53.9)
    'EPSG:32635'
    """
    if not (-80.0 <= latitude <= 84.0 and -180.0 <= longitude <= 360.0):
        swapped = abs(longitude) <= 84.0 and abs(latitude) <= 180.0
        advice = " Are longitude and latitude swapped?" if swapped else " Give a CRS for the world."
        raise GeoreferenceError(
            f"Longitude {longitude:g}, latitude {latitude:g} lies in no UTM zone"
            f" (latitude -80 to 84, longitude -180 to 180).{advice}"
        )
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    return f"EPSG:{(32600 if latitude >= 0.0 else 32700) + zone}"


def describe_crs_problem(crs: str, origin: tuple[float, float] = (0.0, 0.0)) -> str:
    """Describe why a CRS cannot be the CRS of a `World`, and what to use; "" when it can.

    Raises:
        GeoreferenceError: it is no CRS at all.
    """
    parsed = parse_crs(crs)
    name = crs if len(crs) < MAX_NAME_CHARS else repr(parsed.name)
    units = {axis.unit_name for axis in parsed.axis_info[:2]}
    directions = {axis.direction for axis in parsed.axis_info[:2]}
    if not parsed.is_projected:
        problem = f"{name} is not projected (its units: {', '.join(sorted(units))})"
    elif any(axis.unit_conversion_factor != 1.0 for axis in parsed.axis_info[:2]):
        problem = f"{name} has the units {', '.join(sorted(units))}, not metres"
    elif directions != {"east", "north"}:
        problem = f"{name} has its axes towards {', '.join(sorted(directions))}, not east and north"
    elif abs((scale := _measure_scale(parsed, origin)) - 1.0) > MAX_SCALE_ERROR:
        problem = f"a metre of {name} is {scale:.3g} times a metre on the ground"
    else:
        return ""
    best = _suggest_crs(parsed, origin)
    return f"{problem}; a world needs metres, x east and y north. Use {best}."


def _measure_scale(crs: CRS, origin: tuple[float, float]) -> float:
    """Length in the CRS per length on the ground, at the origin or amid the CRS's area of use."""
    proj = Proj(crs)
    try:
        if origin != (0.0, 0.0):
            lon, lat = proj(*origin, inverse=True)
        elif crs.area_of_use is not None:
            area = crs.area_of_use
            lon, lat = (area.west + area.east) / 2.0, (area.south + area.north) / 2.0
        else:
            return 1.0
        factors = proj.get_factors(lon, lat)
    except ProjError:
        return np.inf
    return float(np.sqrt(factors.areal_scale))


def _suggest_crs(crs: CRS, origin: tuple[float, float]) -> str:
    area = crs.area_of_use
    if origin != (0.0, 0.0) and crs.is_projected:
        with suppress(GeoreferenceError, ProjError):
            return find_utm_crs(*Proj(crs)(*origin, inverse=True, errcheck=True))
    if area is None or area.east - area.west > MAX_AREA_DEGREES or area.east < area.west:
        return "the UTM zone of the scene, which geoaim.base.world.choose_world finds"
    return find_utm_crs((area.west + area.east) / 2.0, (area.south + area.north) / 2.0)


def choose_world(lonlat: Float[Array, "m 2"], *, crs: str | None = None) -> World:
    """Choose a world for points (longitude, latitude in degrees); without `crs` their UTM zone.

    The origin is the mean of the points, rounded to 100 m.

    Raises:
        GeoreferenceError: the points lie in no UTM zone, or the CRS cannot be a world.

    >>> choose_world(np.array([[27.56, 53.9]]))
    World(crs='EPSG:32635', origin=(536800.0, 5972500.0))
    """
    lonlat = np.asarray(lonlat, np.float64)
    first = lonlat[0, 0]
    longitude = first + np.mean((lonlat[:, 0] - first + 180.0) % 360.0 - 180.0)  # the date line
    latitude = float(lonlat[:, 1].mean())
    crs = crs or find_utm_crs(float(longitude), latitude)
    middle = transform_crs(LONLAT, crs, np.array([[longitude, latitude]]))[0]
    east, north = (np.round(middle / ORIGIN_STEP_M) * ORIGIN_STEP_M).tolist()
    return World(crs, (east, north))


def transform_crs(
    source: str, destination: str, points: Float[Array, "m 2"]
) -> Float[Array, "m 2"]:
    """Transform points between CRSs, x (or longitude) first whatever the CRS's axis order.

    Points that are not finite stay so.

    Raises:
        GeoreferenceError: a CRS is unknown, or a point cannot be expressed in the destination.
    """
    points = np.asarray(points, np.float64)
    if source == destination:
        return points.copy()
    try:
        x, y = _make_transformer(source, destination).transform(points[:, 0], points[:, 1])
    except ProjError as error:
        raise GeoreferenceError(f"{source} to {destination}: {error}") from error
    mapped = np.stack([x, y], axis=-1)
    lost = np.isfinite(points).all(axis=-1) & ~np.isfinite(mapped).all(axis=-1)
    if lost.any():
        raise GeoreferenceError(
            f"{tuple(points[lost][0].tolist())} in {source} cannot be expressed in {destination}."
            " Is the CRS the right one, and are the coordinates in the order x, y (lon, lat)?"
        )
    return mapped


def is_in_area(crs: str, lonlat: Float[Array, "m 2"]) -> bool:
    """Tell whether places (longitude, latitude in degrees) lie where a CRS is used, or near.

    >>> is_in_area("EPSG:32635", np.array([[28.3, 54.7]]))
    True
    >>> is_in_area("EPSG:32635", np.array([[54.7, 28.3]]))
    False
    """
    if not np.abs(lonlat[:, 1]).max() <= 90.0:
        return False
    area = parse_crs(crs).area_of_use
    if area is None:
        return True
    width = (area.east - area.west) % 360.0 or 360.0  # some lie across the date line
    east = (lonlat[:, 0] - area.west + AREA_MARGIN) % 360.0
    low, high = area.south - AREA_MARGIN, area.north + AREA_MARGIN
    inside = (east <= width + 2 * AREA_MARGIN) & (lonlat[:, 1] >= low) & (lonlat[:, 1] <= high)
    return bool(inside.all())


def describe_misplacement(
    crs: str, points: Float[Array, "m 2"], origin: tuple[float, float] = (0.0, 0.0)
) -> str:
    """Describe that places do not lie where their CRS is used, and what they may be; "" if they do.

    Args:
        crs: the CRS.
        points: (M, 2) coordinates in it, x (or longitude) first, less the origin.
        origin: what is added to them.

    >>> describe_misplacement("EPSG:32635", np.array([[6062185.0, 583185.0]]))
    '6062185, 583185 in EPSG:32635 lies outside the area where that is used: are x and y swapped?'
    """
    places = points + origin
    if _lie_in_area(crs, places):
        return ""
    readings = {
        "are x and y absolute? Then the origin is 0 0": points,
        "are x and y swapped?": places[:, ::-1],
        "are they feet?": places * FOOT_M,
        "are they metres?": places / FOOT_M,
    }
    likely = [text for text, read in readings.items() if _lie_in_area(crs, read)]
    advice = (*likely, "is the CRS the right one?")[0]
    x, y = places[0].tolist()
    name = crs if len(crs) < MAX_NAME_CHARS else repr(parse_crs(crs).name)
    return f"{x:.10g}, {y:.10g} in {name} lies outside the area where that is used: {advice}"


def _lie_in_area(crs: str, points: Float[Array, "m 2"]) -> bool:
    try:
        return is_in_area(crs, transform_crs(crs, LONLAT, points))
    except GeoreferenceError:  # no place on the Earth
        return False


@dataclass(frozen=True)
class Operation:
    """How PROJ transforms between two CRSs at a place."""

    name: str
    accuracy: float  # metres; 0 within one datum, NaN where PROJ does not know it
    better: str  # a more accurate operation whose grids are missing, and these; "" for none


def find_operation(source: str, destination: str, points: Float[Array, "m 2"]) -> Operation:
    """Find the best available operation by which PROJ transforms points, x (or longitude) first.

    Raises:
        GeoreferenceError: a CRS is unknown, or a point has no longitude and latitude.
    """
    lonlat = transform_crs(source, LONLAT, points)
    low, high = np.floor(lonlat.min(axis=0)), np.ceil(lonlat.max(axis=0))
    return _find_operation(source, destination, (*low.tolist(), *high.tolist()))


@lru_cache(maxsize=64)
def _find_operation(
    source: str, destination: str, area: tuple[float, float, float, float]
) -> Operation:
    """Find the operation in an area: west, south, east and north in degrees."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyproj warns of missing grids in words of its own
        group = TransformerGroup(
            parse_crs(source),
            parse_crs(destination),
            always_xy=True,
            area_of_interest=AreaOfInterest(*area),  # type: ignore[arg-type]  # stubs differ
        )
    if not group.transformers:
        return Operation("none", np.nan, "")
    chosen = group.transformers[0]
    accuracy = float(chosen.accuracy) if chosen.accuracy >= 0 else np.nan
    better = ""
    for lacking in group.unavailable_operations:
        grids = [grid.short_name for grid in lacking.grids if not grid.available]
        if grids and lacking.accuracy >= 0 and not lacking.accuracy >= accuracy:
            better = f"{lacking.name} ({lacking.accuracy:g} m) needs {', '.join(grids)}"
            break
    return Operation(chosen.description, accuracy, better)


def warn_of_operation(operation: Operation, source: str, destination: str) -> None:
    """Warn where the accuracy of an operation is unknown, or a better one lacks its grids."""
    if operation.better:
        stated = f"{operation.accuracy:g} m" if operation.accuracy >= 0 else "an unknown accuracy"
        warn(
            f"{source} to {destination}: transformed with {stated}, since {operation.better}, "
            "which is missing; install it (pyproj sync --file NAME) for less uncertainty"
        )
    elif np.isnan(operation.accuracy):
        warn(
            f"{source} to {destination}: PROJ does not know how accurate this is "
            f"({operation.name}); datums may differ by 100 m. Name the CRS by its EPSG code"
        )


def world_from_crs(
    world: World, points: Float[Array, "m 2"], crs: str | None = None
) -> Float[Array, "m 2"]:
    """Convert coordinates in a CRS (x or longitude first; None: the world's CRS) to world metres.

    Raises:
        GeoreferenceError: a point cannot be expressed there, or a CRS is given and the world has
            none.

    >>> world_from_crs(World("EPSG:32635", (500000.0, 5970000.0)), np.array([[500003.0, 5970004]]))
    array([[3., 4.]])
    """
    points = np.asarray(points, np.float64)
    if crs is not None:
        points = transform_crs(crs, _require_crs(world), points)
    return points - world.origin


def crs_from_world(
    world: World, points: Float[Array, "m 2"], crs: str | None = None
) -> Float[Array, "m 2"]:
    """Convert world metres to coordinates in a CRS: the inverse of `world_from_crs`.

    Raises:
        GeoreferenceError: a point cannot be expressed there, or a CRS is given and the world has
            none.
    """
    points = np.asarray(points, np.float64) + world.origin
    return points if crs is None else transform_crs(_require_crs(world), crs, points)


def world_from_lonlat(world: World, lonlat: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
    """Convert longitude, latitude (WGS 84, degrees) to world metres; see `world_from_crs`."""
    return world_from_crs(world, lonlat, LONLAT)


def lonlat_from_world(world: World, points: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
    """Convert world metres to longitude, latitude (WGS 84, degrees); see `crs_from_world`."""
    return crs_from_world(world, points, LONLAT)


def change_world(
    source: World, destination: World, points: Float[Array, "m 2"]
) -> Float[Array, "m 2"]:
    """Convert metres of one world to metres of another.

    Raises:
        GeoreferenceError: only one of the two has a CRS, or a point cannot be expressed there.
    """
    if source == destination:
        return points
    if (source.crs is None) != (destination.crs is None):
        there, here = (
            world.crs or "a local plane without a CRS" for world in (source, destination)
        )
        raise GeoreferenceError(
            f"Points lie in {there}, and are needed in {here}; give both a CRS."
        )
    return world_from_crs(destination, crs_from_world(source, points), source.crs)


def describe_world(world: World) -> str:
    """Describe a world in a few words, such as "EPSG:32635, origin 583000, 6062000"."""
    east, north = world.origin
    return f"{world.crs or 'local plane'}, origin {east:.0f}, {north:.0f}"


def _require_crs(world: World) -> str:
    if world.crs is None:
        raise GeoreferenceError(
            "This world is a local plane without a CRS. Georeference it with control"
            " points or telemetry first."
        )
    return world.crs
