"""The HD map of a made place, as a lanelet2 file (OpenStreetMap XML).

Lanelets of lanes with their boundaries, stop lines, and lights and rights of way as regulatory
elements. Like many real maps it leaves out where people walk, the car park and private roads,
unless asked for.
The format is that of Poggenhans et al. 2018 (github.com/fzi-forschungszentrum-informatik/Lanelet2).
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import LineString, Polygon

from geoaim.geometry import transform_points
from geoaim.synthetic.roads.arms import Arm, lane_in, lane_out, on_arm
from geoaim.synthetic.roads.curves import Line, parallel
from geoaim.synthetic.roads.lanes import FAR, Lane, sides
from geoaim.synthetic.roads.markings import give_way_line
from geoaim.synthetic.roads.paving import Crossing
from geoaim.synthetic.roads.plan import Roads, arm_named, signal_of
from geoaim.world import World, lonlat_from_world

STATION = 3.0  # m between the points of an arm's boundaries
TOLERANCE = 0.005  # m by which a boundary may be simplified
SLIVER = 0.2  # m, width of what is no part of an area
SAME = 0.03  # m within which two ends are one node
WALK = 1.2  # m, half the width of a walkway
DECIMALS = 11  # of degrees
SOLID, DASHED = ("line_thin", "solid"), ("line_thin", "dashed")
KERB, VIRTUAL = ("curbstone", "low"), ("virtual", "")
TURNS = {"L": "left", "S": "straight", "R": "right", "": ""}
Kind = tuple[str, str]


@dataclass
class _Draft:
    """The map being written: points, and ways and relations as XML."""

    points: list[Float[Array, "2"]] = field(default_factory=list)
    ways: dict[tuple[int, ...], int] = field(default_factory=dict)
    elements: list[ET.Element] = field(default_factory=list)
    last: int = 0


def lanelet_map(
    roads: Roads,
    world_from_plan: Float[Array, "3 3"],
    world: World,
    *,
    whole: bool = False,
) -> bytes:
    """The map as a file's content; with walkways, crossings, car park, private roads if whole."""
    draft = _Draft()
    private = () if whole else roads.layout.private
    mapped = [lane for lane in roads.lanes if not {*lane.name.split()} & {*private}]
    lanes = {lane.name: _add_lane(draft, roads, lane) for lane in mapped}
    for arm in roads.layout.arms:
        if np.isfinite(arm.stop) and arm.name not in private:
            _add_rule(draft, roads, arm, lanes)
    if whole:
        _add_walkways(draft, roads)
    if whole and roads.car_park is not None:
        ground = shapely.union_all([roads.paving.lot, roads.paving.drive])
        _add_area(draft, ground, {"type": "multipolygon", "subtype": "parking"})
    root = ET.Element("osm", version="0.6", generator="geoaim")
    places = lonlat_from_world(world, transform_points(world_from_plan, np.array(draft.points)))
    for number, (lon, lat) in enumerate(places.tolist(), 1):
        where = {"lat": f"{lat:.{DECIMALS}f}", "lon": f"{lon:.{DECIMALS}f}"}
        ET.SubElement(root, "node", {"id": str(number), "version": "1"} | where)
    root.extend(sorted(draft.elements, key=lambda element: element.tag == "relation"))
    ET.indent(root, " ")
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)


def _add_lane(draft: _Draft, roads: Roads, lane: Lane) -> ET.Element:
    """A lanelet between the boundaries of a lane."""
    tags = {"type": "lanelet", "subtype": "road", "location": "urban", "one_way": "yes"}
    tags |= {"name": lane.name, "speed_limit": f"{round(3.6 * lane.speed)} km/h"}
    tags |= {"turn_direction": TURNS[lane.turn]} if lane.turn else {}
    lines, kinds = _boundaries(roads, lane), _kinds(roads, lane)
    left, right = (_way(draft, line, kind) for line, kind in zip(lines, kinds, strict=True))
    return _relation(draft, [("way", left, "left"), ("way", right, "right")], tags)


def _boundaries(roads: Roads, lane: Lane) -> tuple[Line, Line]:
    """Left and right of a lane; neighbours on an arm share theirs to the letter."""
    words = lane.name.split()
    if words[1] not in ("in", "out"):
        left, right = sides(lane)
        return _simple(left), _simple(right)
    arm, rank = arm_named(roads.layout, words[0]), int(words[2])
    across = lane_in(arm, rank) if words[1] == "in" else lane_out(arm, rank)
    along = np.linspace(arm.mouth, FAR, round((FAR - arm.mouth) / STATION) + 1)
    low, high = (
        on_arm(arm, np.stack([along, np.full_like(along, round(across + side, 6))], axis=1))
        for side in (-arm.lane / 2, arm.lane / 2)
    )
    return (low[::-1], high[::-1]) if words[1] == "in" else (high, low)


def _kinds(roads: Roads, lane: Lane) -> tuple[Kind, Kind]:
    """What the left and the right boundary of a lane are."""
    if " in " in lane.name or " out " in lane.name:
        name, way, rank = lane.name.split()
        arm = arm_named(roads.layout, name)
        count = len(arm.turns) if way == "in" else arm.lanes_out
        return SOLID if rank == "0" else DASHED, SOLID if int(rank) == count - 1 else DASHED
    if lane.name.startswith("ring"):
        return KERB, VIRTUAL if "past" in lane.name else KERB
    return VIRTUAL, KERB if " ring" in lane.name else VIRTUAL


def _add_rule(draft: _Draft, roads: Roads, arm: Arm, lanes: dict[str, ET.Element]) -> None:
    """The lights at an arm's stop line, or the duty to give way there."""
    held: dict[str, list[str]] = {}
    for rank, turns in enumerate(arm.turns):
        name = f"{arm.name} in {rank}"
        held.setdefault(signal_of(roads, name, turns[0]), []).append(name)
    for signal, names in held.items():
        ranks = [int(name.split()[-1]) for name in names]
        inner, outer = (
            lane_in(arm, min(ranks)) - arm.lane / 2,
            lane_in(arm, max(ranks)) + arm.lane / 2,
        )
        bar = on_arm(arm, np.array([[arm.stop, inner], [arm.stop, outer]]))
        bar = give_way_line(roads.layout, arm) if roads.layout.ring else bar
        stop = _way(draft, bar, ("stop_line", ""))
        members = [("way", stop, "ref_line")]
        tags = {"type": "regulatory_element", "subtype": "right_of_way"}
        if signal:
            lamp = on_arm(
                arm, np.array([[arm.stop - 0.6, inner + 0.8], [arm.stop - 0.6, inner + 1.6]])
            )
            light = _way(draft, lamp, ("traffic_light", "red_yellow_green"))
            members.append(("way", light, "refers"))
            tags |= {"subtype": "traffic_light", "name": signal}
        else:
            names, others = _right_of_way(roads, arm, names)
            others = [name for name in others if name in lanes]
            members += [("relation", int(lanes[n].attrib["id"]), "yield") for n in names]
            members += [("relation", int(lanes[n].attrib["id"]), "right_of_way") for n in others]
        rule = _relation(draft, members, tags)
        for name in names:
            member = {"type": "relation", "ref": rule.attrib["id"], "role": "regulatory_element"}
            lanes[name].insert(2, ET.Element("member", member))


def _right_of_way(roads: Roads, arm: Arm, names: list[str]) -> tuple[list[str], list[str]]:
    """The lanelets that give way at an arm, and those that they give way to."""
    arms = roads.layout.arms
    if roads.layout.ring:
        before = arms[arms.index(arm) - 1].name
        return [f"{arm.name} onto ring"], [f"ring after {before}", f"ring past {arm.name}"]
    main = [other for other in arms if not np.isfinite(other.stop)]
    return names, [f"{other.name} in {rank}" for other in main for rank in range(len(other.turns))]


def _add_walkways(draft: _Draft, roads: Roads) -> None:
    """Crossings that are marked, and the lines of pavements and paths."""
    for leg in roads.walks.legs:
        crossing = roads.crossings[leg.crossing] if leg.crossing >= 0 else None
        marked = crossing is not None and crossing.marked
        half = crossing.width / 2 if crossing is not None and marked else WALK
        kind: Kind = ("pedestrian_marking", "") if marked else VIRTUAL
        edges = [_way(draft, _simple(parallel(leg.line, side * half)), kind) for side in (1, -1)]
        tags = {"type": "lanelet", "subtype": "crosswalk" if marked else "walkway"}
        tags |= {"location": "urban", "one_way": "no", "participant:pedestrian": "yes"}
        lanelet = _relation(draft, [("way", edges[0], "left"), ("way", edges[1], "right")], tags)
        if crossing is not None and crossing.marked and crossing.signalised:
            _add_walk_light(draft, crossing, lanelet)


def _add_walk_light(draft: _Draft, crossing: Crossing, lanelet: ET.Element) -> None:
    """The light of those on foot, at the crossing's first end."""
    lamp = crossing.ends[0] + np.array([[0.0, 0.0], [0.3, 0.0]])
    light = _way(draft, lamp, ("traffic_light", "red_green"))
    tags = {"type": "regulatory_element", "subtype": "traffic_light"}
    tags["name"] = f"walk {crossing.name}"
    rule = _relation(draft, [("way", light, "refers")], tags)
    member = {"type": "relation", "ref": rule.attrib["id"], "role": "regulatory_element"}
    lanelet.insert(2, ET.Element("member", member))


def _add_area(draft: _Draft, ground: shapely.Geometry, tags: dict[str, str]) -> None:
    """An area without the slivers that differences of curves leave."""
    whole = ground.buffer(SLIVER, join_style="mitre").buffer(-2 * SLIVER, join_style="mitre")
    for part in shapely.get_parts(whole.buffer(SLIVER, join_style="mitre")):
        if isinstance(part, Polygon):
            ring = np.array(part.exterior.simplify(SLIVER / 2).coords)
            _relation(draft, [("way", _way(draft, ring, KERB), "outer")], tags)


def _simple(line: Line) -> Line:
    return np.array(LineString(line).simplify(TOLERANCE).coords)


def _way(draft: _Draft, line: Line, kind: Kind) -> int:
    """The number of a way; a line that is there already, either way round, serves."""
    every = [_node(draft, point) for point in line]
    nodes = tuple(node for node, before in zip(every, [0, *every], strict=False) if node != before)
    found = draft.ways.get(nodes) or draft.ways.get(nodes[::-1])
    if found:
        return found
    number = _number(draft)
    draft.ways[nodes] = number
    element = ET.Element("way", id=str(number), version="1")
    for node in nodes:
        ET.SubElement(element, "nd", ref=str(node))
    _tag(element, {"type": kind[0]} | ({"subtype": kind[1]} if kind[1] else {}))
    draft.elements.append(element)
    return number


def _node(draft: _Draft, point: Float[Array, "2"]) -> int:
    """The number of a node; one that is almost there serves."""
    if draft.points:
        apart = np.abs(np.array(draft.points) - point).max(axis=1)
        nearest = int(np.argmin(apart))
        if apart[nearest] < SAME:
            return nearest + 1
    draft.points.append(point)
    return len(draft.points)


def _relation(
    draft: _Draft, members: list[tuple[str, int, str]], tags: dict[str, str]
) -> ET.Element:
    element = ET.Element("relation", id=str(_number(draft)), version="1")
    for kind, ref, role in members:
        ET.SubElement(element, "member", type=kind, ref=str(ref), role=role)
    _tag(element, tags)
    draft.elements.append(element)
    return element


def _number(draft: _Draft) -> int:
    """Numbers of ways and relations; nodes count on their own from 1."""
    draft.last += 1
    return 1_000_000 + draft.last


def _tag(element: ET.Element, tags: dict[str, str]) -> None:
    for key, value in tags.items():
        ET.SubElement(element, "tag", k=key, v=value)
