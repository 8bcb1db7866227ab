"""HD maps in lanelet2 files (OpenStreetMap XML), read without the lanelet2 package.

The format is that of Poggenhans et al. 2018 (github.com/fzi-forschungszentrum-informatik/Lanelet2).
INTERACTION and SinD write local metres as degrees about (0, 0); such files are read into a world
without a CRS.
"""

import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from xml.parsers import expat

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import LineString, union_all
from shapely.geometry.base import BaseGeometry
from shapely.ops import polygonize

from geoaim.base.displays import Display
from geoaim.base.errors import MapError
from geoaim.base.limits import name_file, refuse_damaged
from geoaim.base.world import (
    LONLAT,
    World,
    choose_world,
    describe_world,
    find_utm_crs,
    is_in_area,
    transform_crs,
    world_from_lonlat,
)
from geoaim.tracks.lights import STOP_LINE_COLOUR, StopLine

if TYPE_CHECKING:
    from matplotlib.axes import Axes


WALKING = ("crosswalk", "walkway", "stairs")  # lanelets of pedestrians
# tags by which a lanelet is one way for vehicles, the most specific first
ONE_WAY_TAGS = ("one_way:vehicle:car", "one_way:vehicle", "one_way")
TRUTHS = {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False}
LOCAL_TAGS = ("local_x", "local_y")

Ways = Mapping[str | None, "MapLine"]  # keys: the ids in the file


@dataclass(frozen=True, eq=False)
class MapLine:
    """A line of the map."""

    kind: str  # lanelet2's type: "line_thin", "curbstone", "stop_line", ...
    subtype: str  # lanelet2's subtype: "solid", "dashed", ...
    points: Float[Array, "n 2"]  # metres in the world


@dataclass(frozen=True, eq=False)
class Lanelet:
    """A section of a lane between two borders, whose points follow the direction of travel."""

    subtype: str  # "road", "crosswalk", "walkway", "bicycle_lane", ...; "road" if the file has none
    one_way: bool  # whether traffic may go in one direction only
    left: Float[Array, "n 2"]  # points of its left border, metres in the world
    right: Float[Array, "m 2"]  # points of its right border


@dataclass(frozen=True, eq=False)
class Area:
    """An area of the map."""

    subtype: str  # "parking", for instance
    shape: BaseGeometry  # polygons without their holes, metres in the world


@dataclass(frozen=True, eq=False, repr=False)
class HDMap(Display):
    """An HD map.

    Attributes:
        lines: borders, markings and stop lines.
        lanelets: lanes, walkways and crossings.
        areas: car parks, for instance.
        stop_lines: the stop lines of traffic lights.
        world: plane of the metres.
    """

    lines: tuple[MapLine, ...]
    lanelets: tuple[Lanelet, ...]
    areas: tuple[Area, ...]
    stop_lines: tuple[StopLine, ...]
    world: World

    def summarize(self) -> dict[str, str]:
        """Summarize the lanelets by subtype, the lights, the extent and the world."""
        kinds = Counter(lanelet.subtype for lanelet in self.lanelets).most_common()
        points = np.concatenate([lanelet.left for lanelet in self.lanelets])
        return {
            "lanelets": ", ".join(f"{count} {kind}" for kind, count in kinds),
            "stop lines of lights": str(len(self.stop_lines)),
            "extent": "{:.0f} x {:.0f} m".format(*np.ptp(points, axis=0)),
            "world": describe_world(self.world),
        }

    def _draw(self, axes: "Axes") -> None:
        from geoaim.base.map_axes import draw_lines, move_to_axes

        groups = {
            "lanes": [x for x in self.lanelets if x.subtype not in WALKING],
            "crossings and footpaths": [x for x in self.lanelets if x.subtype in WALKING],
        }
        lines = {
            name: [side for lanelet in found for side in (lanelet.left, lanelet.right)]
            for name, found in groups.items()
        }
        lines["stop lines of lights"] = [line.ends for line in self.stop_lines]
        colours = ("0.35", "#e69f00", STOP_LINE_COLOUR)
        for (name, found), colour in zip(lines.items(), colours, strict=True):
            moved = [move_to_axes(axes, points, self.world) for points in found]
            width = 2.5 if colour == STOP_LINE_COLOUR else 0.8
            if moved:
                draw_lines(axes, moved, colour, width=width, label=name)


def read_hdmap(path: str | os.PathLike[str], world: World | None = None) -> HDMap:
    """Read a lanelet2 file (.osm).

    When `world` is None, the map gets the UTM zone in which it lies, or a plane without a CRS when
    its degrees stand for local metres.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: it is not a lanelet2 map, or does not lie in that world.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    file = _parse(path)
    with name_file(path):
        points, world = locate_nodes(path, list(file.nodes), file.lonlat, file.local, world)
    ways = _read_ways(path, file, points)
    lanelets = tuple(_make_lanelet(path, x, ways) for x in _list_relations(file, "lanelet"))
    if not lanelets:
        raise MapError(
            f"{path} has {len(ways)} ways and no lanelets; a lanelet2 map is needed (a road map of "
            "OpenStreetMap has no lanes' outlines)"
        )
    lines = tuple(line for line in ways.values() if len(line.points) > 1)
    areas = tuple(_make_area(path, x, ways) for x in _list_relations(file, "multipolygon"))
    return HDMap(lines, lanelets, areas, tuple(_list_stop_lines(file, ways)), world)


@dataclass(frozen=True, eq=False)
class _Element:
    """A way or a relation of a file."""

    id: str | None
    tags: dict[str | None, str] = field(default_factory=dict)
    nodes: list[str | None] = field(default_factory=list)  # a way's nodes
    members: list[tuple[str | None, str | None]] = field(default_factory=list)  # role, reference


@dataclass(frozen=True, eq=False)
class _File:
    """The elements of a file."""

    nodes: dict[str | None, int] = field(default_factory=dict)  # number of each id
    # longitude and latitude of each node in turn
    lonlat: list[str | None] = field(default_factory=list)
    local: list[str | None] = field(default_factory=list)  # tags local_x and local_y of each
    ways: list[_Element] = field(default_factory=list)
    relations: list[_Element] = field(default_factory=list)


def _parse(path: Path) -> _File:
    file, parser = _File(), expat.ParserCreate()

    def check_root(name: str, _: Mapping[str, str]) -> None:
        if name != "osm":
            raise MapError(f"{path} is XML of {name!r}; OpenStreetMap's, 'osm', is needed")
        parser.StartElementHandler = _make_handler(file)

    parser.StartElementHandler = check_root
    with refuse_damaged(path, MapError, "a lanelet2 map in XML", reads_once=True):
        content = path.read_bytes()
        if b"\0" in content or b"<!DOCTYPE" in content or b"<!ENTITY" in content:
            raise MapError(f"{path} defines XML entities, or is not UTF-8; no map needs that")
        parser.Parse(content, True)
    return file


def _make_handler(file: _File) -> Callable[[str, Mapping[str, str]], None]:
    """Make the function that adds what an XML element states to a file."""
    nodes, lonlat, local = file.nodes, file.lonlat, file.local
    last = of_node = _Element(None)

    def add(name: str, values: Mapping[str, str]) -> None:
        nonlocal last
        # editors keep deleted elements
        is_deleted = values.get("action") == "delete" or values.get("visible") == "false"
        if name == "nd":
            last.nodes.append(values.get("ref"))
        elif name == "node":
            last = _Element(None) if is_deleted else of_node
            if not is_deleted:
                nodes[values.get("id")] = len(lonlat) // 2
                lonlat.extend((values.get("lon"), values.get("lat")))
                local.extend((None, None))
        elif name == "member":
            last.members.append((values.get("role"), values.get("ref")))
        elif name == "tag" and last is of_node:
            if values.get("k") in LOCAL_TAGS:
                local[len(local) - 2 + LOCAL_TAGS.index(values["k"])] = values.get("v")
        elif name == "tag":
            last.tags.setdefault(values.get("k"), values.get("v", ""))
        elif name in ("way", "relation"):
            last = _Element(values.get("id"))
            if not is_deleted:
                (file.ways if name == "way" else file.relations).append(last)

    return add


def _list_relations(file: _File, kind: str) -> Iterator[_Element]:
    return (item for item in file.relations if item.tags.get("type") == kind)


def _read_ways(path: Path, file: _File, points: Float[Array, "n 2"]) -> Ways:
    ways = {}
    for way in file.ways:
        missing = [node for node in way.nodes if node not in file.nodes]
        if missing:
            raise MapError(f"{path}: way {way.id} has node {missing[0]}, which is missing")
        rows = np.array([file.nodes[node] for node in way.nodes], int)
        kind, subtype = way.tags.get("type", ""), way.tags.get("subtype", "")
        ways[way.id] = MapLine(kind, subtype, points[rows])
    return ways


def _make_lanelet(path: Path, relation: _Element, ways: Ways) -> Lanelet:
    """A lanelet whose borders both follow its direction, however the file orders their points."""
    sides = {}
    for role in ("left", "right"):
        refs = [ref for ref in _list_members(relation, role) if ref in ways]
        if len(refs) != 1 or len(ways[refs[0]].points) < 2:
            raise MapError(
                f"{path}: lanelet {relation.id} has {len(refs)} {role} lines of two points "
                "or more; one is needed"
            )
        sides[role] = ways[refs[0]].points
    left, right = sides["left"], sides["right"]
    same, opposite = (
        np.linalg.norm(left[[0, -1]] - line[[0, -1]], axis=1).sum() for line in (right, right[::-1])
    )
    if opposite < same:
        right = right[::-1]
    x, y = np.concatenate([left, right[::-1]]).T
    if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0:  # the left border lies on the right
        left, right = left[::-1], right[::-1]
    return Lanelet(relation.tags.get("subtype") or "road", _is_one_way(path, relation), left, right)


def _is_one_way(path: Path, relation: _Element) -> bool:
    """Whether vehicles may drive a lanelet in one direction only."""
    name = next((name for name in ONE_WAY_TAGS if relation.tags.get(name)), None)
    if name is None:
        return relation.tags.get("subtype") not in (*WALKING, "shared_walkway")
    value = relation.tags[name]
    if value.lower() not in TRUTHS:
        raise MapError(
            f"{path}: lanelet {relation.id} has {name}={value!r}; {', '.join(TRUTHS)} are known"
        )
    return TRUTHS[value.lower()]


def _list_members(relation: _Element, role: str) -> list[str | None]:
    return [ref for member, ref in relation.members if member == role]


def _make_area(path: Path, relation: _Element, ways: Ways) -> Area:
    outer, inner = (_enclose(path, relation, role, ways) for role in ("outer", "inner"))
    return Area(relation.tags.get("subtype", ""), outer - inner)


def _enclose(path: Path, relation: _Element, role: str, ways: Ways) -> BaseGeometry:
    """The polygons that the lines of a role enclose."""
    refs, area = _list_members(relation, role), f"{path}: area {relation.id}"
    missing = [ref for ref in refs if ref not in ways]
    if missing:
        raise MapError(f"{area} has way {missing[0]}, which is missing")
    sides = [ways[ref].points for ref in refs]
    if len(sides) == 1:  # closed, whether or not the file repeats the first point
        sides = [np.concatenate([sides[0], sides[0][:1]])]
    polygons = union_all(list(polygonize([LineString(side) for side in sides if len(side) > 1])))
    if polygons.is_empty and (refs or role == "outer"):
        raise MapError(
            f"{area} has {len(refs)} {role} lines that close no ring, or cross themselves; draw one"
        )
    return polygons


def _list_stop_lines(file: _File, ways: Ways) -> Iterator[StopLine]:
    """The stop lines of traffic lights; a light without a name is named by its id."""
    for relation in file.relations:
        if relation.tags.get("subtype") == "traffic_light":
            signal = relation.tags.get("name") or str(relation.id)
            for ref in _list_members(relation, "ref_line"):
                if ref in ways and len(ways[ref].points) > 1:
                    yield StopLine(signal, ways[ref].points[[0, -1]])


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
        _check_area(path, world, degrees)
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


def _check_area(path: Path, world: World, degrees: Float[Array, "n 2"]) -> None:
    """Refuse a map that lies elsewhere than the CRS of the world is used."""
    assert world.crs is not None
    if is_in_area(world.crs, degrees):
        return
    swapped = is_in_area(world.crs, degrees[:, ::-1])
    advice = "lat and lon are swapped" if swapped else "is it the map of another place?"
    raise MapError(
        f"{path} lies about longitude {degrees[0, 0]:g}, latitude {degrees[0, 1]:g}, outside the "
        f"area where {world.crs} is used, in which the map is needed; {advice}"
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
