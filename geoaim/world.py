"""World: the local metric plane in which tracks live, a projected CRS and an origin."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError, ProjError

from geoaim.errors import GeoreferenceError

LONLAT = "EPSG:4326"
ROUND = 100.0  # origins are multiples of this, metres
SCALE_LIMIT = 0.01  # a "metre" of the CRS may differ by this share from a metre on the ground


@dataclass(frozen=True)
class World:
    """A metric plane, x east and y north, in metres from an origin.

    Attributes:
        crs: anything that pyproj takes for a projected CRS in metres, or None for a plane
            whose place on the Earth is not known.
        origin: easting and northing of the world's (0, 0) in that CRS, metres.

    Raises:
        GeoreferenceError: the CRS is unknown, geographic, not in metres, or not x east y north.
    """

    crs: str | None
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not np.isfinite(self.origin).all():
            raise GeoreferenceError(f"The world's origin {self.origin} is not a pair of numbers.")
        if self.crs is not None:
            refusal = describe_crs_problem(self.crs, self.origin)
            if refusal:
                raise GeoreferenceError(refusal)


@lru_cache(maxsize=64)
def parse_crs(crs: str) -> CRS:
    """The CRS that a text names: "EPSG:n", a PROJ string or WKT.

    Raises:
        GeoreferenceError: pyproj does not know it.
    """
    try:
        return CRS.from_user_input(crs)
    except CRSError as error:
        raise GeoreferenceError(
            f"{crs!r} names no coordinate reference system. Write for example 'EPSG:32635'."
        ) from error


@lru_cache(maxsize=64)
def _transformer(source: str, destination: str) -> Transformer:
    return Transformer.from_crs(parse_crs(source), parse_crs(destination), always_xy=True)


def utm_crs(longitude: float, latitude: float) -> str:
    """EPSG code of the UTM zone (WGS 84) of a place given in degrees.

    Raises:
        GeoreferenceError: no zone there: a pole, or latitude and longitude swapped.

    >>> utm_crs(27.56, 53.9)
    'EPSG:32635'
    """
    if not (-80.0 <= latitude <= 84.0 and -180.0 <= longitude <= 360.0):
        swap = abs(longitude) <= 84.0 and abs(latitude) <= 180.0
        advice = " Are longitude and latitude swapped?" if swap else " Name a world CRS yourself."
        raise GeoreferenceError(
            f"Longitude {longitude:g}, latitude {latitude:g} lies in no UTM zone"
            f" (latitude -80 to 84, longitude -180 to 180).{advice}"
        )
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    return f"EPSG:{(32600 if latitude >= 0.0 else 32700) + zone}"


def describe_crs_problem(crs: str, origin: tuple[float, float] = (0.0, 0.0)) -> str:
    """What keeps a CRS from being a world, and what to use; empty when nothing does."""
    parsed = parse_crs(crs)
    name = f"{crs if len(crs) < 40 else parsed.name!r}"
    units = {axis.unit_name for axis in parsed.axis_info[:2]}
    directions = {axis.direction for axis in parsed.axis_info[:2]}
    if not parsed.is_projected:
        found = f"{name} is not projected (its units: {', '.join(sorted(units))})"
    elif any(axis.unit_conversion_factor != 1.0 for axis in parsed.axis_info[:2]):
        found = f"{name} counts in {', '.join(sorted(units))}, not in metres"
    elif directions != {"east", "north"}:
        found = f"{name} has its axes towards {', '.join(sorted(directions))}, not east and north"
    elif abs(_scale(parsed, origin) - 1.0) > SCALE_LIMIT:
        found = f"a metre of {name} is {_scale(parsed, origin):.3g} times a metre on the ground"
    else:
        return ""
    return f"{found}; a world needs metres, x east and y north. Use {_suggestion(parsed)}."


def _scale(crs: CRS, origin: tuple[float, float]) -> float:
    """Length in the CRS per length on the ground at the origin; at (0, 0), amid the CRS's area."""
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


def _suggestion(crs: CRS) -> str:
    area = crs.area_of_use
    if area is None or area.east - area.west > 12.0 or area.east < area.west:
        return "the UTM zone of the scene (geoaim.world.choose_world finds it)"
    return utm_crs((area.west + area.east) / 2.0, (area.south + area.north) / 2.0)


def choose_world(lonlat: Float[Array, "m 2"], *, crs: str | None = None) -> World:
    """A world for some places: their UTM zone, and an origin at a round coordinate amid them.

    Args:
        lonlat: longitude and latitude, degrees.
        crs: a projected CRS in metres to use in place of UTM.

    Raises:
        GeoreferenceError: the places lie in no UTM zone, or the CRS cannot be a world.

    >>> choose_world(np.array([[27.56, 53.9]]))
    World(crs='EPSG:32635', origin=(536800.0, 5972500.0))
    """
    lonlat = np.asarray(lonlat, np.float64)
    first = lonlat[0, 0]
    longitude = first + np.mean((lonlat[:, 0] - first + 180.0) % 360.0 - 180.0)  # over 180 degrees
    latitude = float(lonlat[:, 1].mean())
    crs = crs or utm_crs(float(longitude), latitude)
    middle = transform_crs(LONLAT, crs, np.array([[longitude, latitude]]))[0]
    east, north = (np.round(middle / ROUND) * ROUND).tolist()
    return World(crs, (east, north))


def transform_crs(
    source: str, destination: str, points: Float[Array, "m 2"]
) -> Float[Array, "m 2"]:
    """Points from one CRS to another, x (or longitude) first whatever the CRS's own order.

    Raises:
        GeoreferenceError: a point cannot be expressed in the destination.
    """
    points = np.asarray(points, np.float64)
    if source == destination:
        return points.copy()
    try:
        x, y = _transformer(source, destination).transform(points[:, 0], points[:, 1])
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


def _crs_of(world: World) -> str:
    if world.crs is None:
        raise GeoreferenceError(
            "This world is a plane of its own, without a place on the Earth. Georeference it with"
            " control points or telemetry first."
        )
    return world.crs


def world_from_crs(
    world: World, points: Float[Array, "m 2"], crs: str | None = None
) -> Float[Array, "m 2"]:
    """Coordinates in a CRS (x, y or longitude, latitude) to world metres.

    Args:
        world: where to.
        points: (M, 2), x first whatever the CRS's own axis order.
        crs: where from; None means the world's own CRS.

    Raises:
        GeoreferenceError: a point cannot be expressed there, or the world has no CRS.

    >>> world_from_crs(World("EPSG:32635", (500000.0, 5970000.0)), np.array([[500003.0, 5970004]]))
    array([[3., 4.]])
    """
    points = np.asarray(points, np.float64)
    if crs is not None:
        points = transform_crs(crs, _crs_of(world), points)
    return points - world.origin


def crs_from_world(
    world: World, points: Float[Array, "m 2"], crs: str | None = None
) -> Float[Array, "m 2"]:
    """Undo `world_from_crs`: world metres to coordinates in a CRS, x first."""
    points = np.asarray(points, np.float64) + world.origin
    return points if crs is None else transform_crs(_crs_of(world), crs, points)


def world_from_lonlat(world: World, lonlat: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
    """Longitude and latitude (WGS 84, degrees) to world metres."""
    return world_from_crs(world, lonlat, LONLAT)


def lonlat_from_world(world: World, points: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
    """World metres to longitude and latitude (WGS 84, degrees)."""
    return crs_from_world(world, points, LONLAT)
