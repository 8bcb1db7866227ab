"""HD maps: lanelet2 files (OpenStreetMap XML) read without the lanelet2 package.

The format is that of Poggenhans et al. 2018 (github.com/fzi-forschungszentrum-informatik/Lanelet2).
INTERACTION's and SinD's files count metres from a corner of their own, written as degrees about
(0, 0); they are read into a plane without a place on the Earth.
"""

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import LineString, union_all
from shapely.geometry.base import BaseGeometry
from shapely.ops import polygonize

from geoaim.errors import MapError
from geoaim.lights import StopLine
from geoaim.world import LONLAT, World, choose_world, transform_crs, world_from_lonlat

NOWHERE = 0.1  # degrees about (0, 0) within which a map is not on the Earth but in metres
NOWHERE_CRS = "EPSG:32631"  # in which lanelet2's projector puts such degrees
SECTION = (b"<!DOCTYPE", b"<!ENTITY")  # what no map needs, and attacks on parsers do


@dataclass(frozen=True, eq=False)
class MapLine:
    """A line of the map: kind and subtype as lanelet2 names them, points in metres."""

    kind: str
    subtype: str
    points: Float[Array, "n 2"]


@dataclass(frozen=True, eq=False)
class Lanelet:
    """A piece of lane between two lines that run along with it.

    Attributes:
        subtype: "road", "crosswalk", "walkway", "bicycle_lane", ...; "road" if the file is silent.
        one_way: whether it may be driven one way only.
        left: points of its left line, metres in the world.
        right: points of its right line.
    """

    subtype: str
    one_way: bool
    left: Float[Array, "n 2"]
    right: Float[Array, "m 2"]


@dataclass(frozen=True, eq=False)
class Area:
    """An area of the map, "parking" for instance, without its holes; metres in the world."""

    subtype: str
    shape: BaseGeometry


@dataclass(frozen=True, eq=False)
class HDMap:
    """An HD map.

    Attributes:
        lines: all that is drawn: boundaries, markings, stop lines.
        lanelets: lanes, walkways and crossings.
        areas: car parks, for instance.
        stop_lines: where traffic lights stop traffic.
        world: the plane that the metres lie in.
    """

    lines: tuple[MapLine, ...]
    lanelets: tuple[Lanelet, ...]
    areas: tuple[Area, ...]
    stop_lines: tuple[StopLine, ...]
    world: World


def read_hdmap(path: str | os.PathLike[str], world: World | None = None) -> HDMap:
    """Read a lanelet2 file.

    Args:
        path: the .osm file.
        world: the plane to bring it into; if left out, the UTM zone in which it lies, or a plane
            of its own when its degrees are metres in disguise.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: it is no lanelet2 map, or it does not lie in that world.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    root = _parse(path)
    places, world = _places(path, root, world)
    ways = {}
    for way in root.iter("way"):
        refs = [node.get("ref") for node in way.iter("nd")]
        missing = [ref for ref in refs if ref not in places]
        if missing:
            raise MapError(f"{path}: way {way.get('id')} goes through node {missing[0]}, not there")
        points = np.array([places[ref] for ref in refs], np.float64).reshape(-1, 2)
        ways[way.get("id")] = MapLine(_tag(way, "type"), _tag(way, "subtype"), points)
    relations = list(root.iter("relation"))
    lanelets = tuple(
        _lanelet(path, relation, ways)
        for relation in relations
        if _tag(relation, "type") == "lanelet"
    )
    if not lanelets:
        raise MapError(
            f"{path} has {len(ways)} ways and no lanelets; a lanelet2 map is needed (a road map of "
            "OpenStreetMap has no lanes' outlines)"
        )
    lines = tuple(line for line in ways.values() if len(line.points) > 1)
    areas = tuple(
        _area(path, relation, ways)
        for relation in relations
        if _tag(relation, "type") == "multipolygon"
    )
    return HDMap(lines, lanelets, areas, tuple(_stop_lines(relations, ways)), world)


def _parse(path: Path) -> ET.Element:
    content = path.read_bytes()
    if b"\0" in content or any(section in content for section in SECTION):
        raise MapError(f"{path} defines XML entities, or is no UTF-8; no map needs that")
    try:
        root = ET.fromstring(content)
    except ET.ParseError as error:
        raise MapError(f"{path} is no XML: {error}") from error
    if root.tag != "osm":
        raise MapError(f"{path} is XML of {root.tag!r}; OpenStreetMap's, 'osm', is needed")
    for deleted in root.findall("*[@action='delete']"):  # editors keep what they have deleted
        root.remove(deleted)
    return root


def _tag(element: ET.Element, name: str) -> str:
    return next((tag.get("v", "") for tag in element.iter("tag") if tag.get("k") == name), "")


def _places(
    path: Path, root: ET.Element, world: World | None
) -> tuple[dict[str | None, Float[Array, "2"]], World]:
    """Every node's place in the world."""
    nodes = list(root.iter("node"))
    try:
        lonlat = np.array([[node.get("lon"), node.get("lat")] for node in nodes], np.float64)
    except (TypeError, ValueError) as error:
        raise MapError(f"{path}: a node has no longitude and latitude: {error}") from error
    if len(nodes) == 0 or not np.isfinite(lonlat).all():
        raise MapError(f"{path} has {len(nodes)} nodes; each needs a longitude and a latitude")
    nowhere = bool((np.abs(lonlat) < NOWHERE).all())
    if world is None:
        world = World(None) if nowhere else choose_world(lonlat)
    if nowhere == (world.crs is not None):
        what = "metres from a corner of its own" if nowhere else "a place on the Earth"
        raise MapError(
            f"{path} counts {what}, and the world is {world.crs or 'a plane of its own'}; give a "
            "world of the same kind"
        )
    if nowhere:
        corner = transform_crs(LONLAT, NOWHERE_CRS, np.zeros((1, 2)))
        points = transform_crs(LONLAT, NOWHERE_CRS, lonlat) - corner - world.origin
    else:
        points = world_from_lonlat(world, lonlat)
    return dict(zip([node.get("id") for node in nodes], points, strict=True)), world


def _lanelet(path: Path, relation: ET.Element, ways: Mapping[str | None, MapLine]) -> Lanelet:
    """A lanelet, both of whose lines run along with it, whichever way the file has them."""
    sides = {}
    for role in ("left", "right"):
        refs = [ref for ref in _members(relation, role) if ref in ways]
        if len(refs) != 1 or len(ways[refs[0]].points) < 2:
            raise MapError(
                f"{path}: lanelet {relation.get('id')} has {len(refs)} {role} lines of two points "
                "or more; one is needed"
            )
        sides[role] = ways[refs[0]].points
    left, right = sides["left"], sides["right"]
    as_is, turned = (
        np.linalg.norm(left[[0, -1]] - line[[0, -1]], axis=1).sum() for line in (right, right[::-1])
    )
    if turned < as_is:
        right = right[::-1]
    x, y = np.concatenate([left, right[::-1]]).T
    if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0:  # the left line lies on the right
        left, right = left[::-1], right[::-1]
    one_way = _tag(relation, "one_way") != "no"
    return Lanelet(_tag(relation, "subtype") or "road", one_way, left, right)


def _members(relation: ET.Element, role: str) -> list[str | None]:
    return [m.get("ref") for m in relation.iter("member") if m.get("role") == role]


def _area(path: Path, relation: ET.Element, ways: Mapping[str | None, MapLine]) -> Area:
    outer, inner = (_within(path, relation, role, ways) for role in ("outer", "inner"))
    return Area(_tag(relation, "subtype"), outer - inner)


def _within(
    path: Path, relation: ET.Element, role: str, ways: Mapping[str | None, MapLine]
) -> BaseGeometry:
    """What the lines of a role enclose."""
    refs, area = _members(relation, role), f"{path}: area {relation.get('id')}"
    missing = [ref for ref in refs if ref not in ways]
    if missing:
        raise MapError(f"{area} goes along way {missing[0]}, not there")
    sides = [ways[ref].points for ref in refs]
    if len(sides) == 1:  # whether or not the file repeats the first point
        sides = [np.concatenate([sides[0], sides[0][:1]])]
    found = union_all(list(polygonize([LineString(side) for side in sides if len(side) > 1])))
    if found.is_empty and (refs or role == "outer"):
        raise MapError(
            f"{area} has {len(refs)} {role} lines that close no ring, or cross themselves; draw one"
        )
    return found


def _stop_lines(
    relations: list[ET.Element], ways: Mapping[str | None, MapLine]
) -> Iterator[StopLine]:
    """The traffic lights' lines; one without a name has its number for it."""
    for relation in relations:
        if _tag(relation, "subtype") == "traffic_light":
            signal = _tag(relation, "name") or str(relation.get("id"))
            for ref in _members(relation, "ref_line"):
                if ref in ways and len(ways[ref].points) > 1:
                    yield StopLine(signal, ways[ref].points[[0, -1]])
