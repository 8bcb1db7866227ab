"""The HD map of a synthetic place, as a lanelet2 file (OpenStreetMap XML).

Lanelets between the bounds of lanes; stop lines, traffic lights and rights of way as regulatory
elements. Like many real maps, it leaves out footpaths, car park and private roads unless it is to
be complete. Format: Poggenhans et al. 2018 (github.com/fzi-forschungszentrum-informatik/Lanelet2).
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import LineString, Polygon

from benchmarks.synthetic.roads.approaches import (
    Approach,
    locate_inbound_lane,
    locate_outbound_lane,
    plan_from_road,
)
from benchmarks.synthetic.roads.curves import Polyline, offset_polyline
from benchmarks.synthetic.roads.lanes import LANE_END_M, Lane, compute_lane_bounds
from benchmarks.synthetic.roads.markings import locate_give_way_line
from benchmarks.synthetic.roads.paving import Crossing
from benchmarks.synthetic.roads.plan import Roads, find_approach, find_signal
from geoaim.base.geometry import transform_points
from geoaim.base.world import World, lonlat_from_world

BOUND_SPACING_M = 3.0  # distance between the points of an approach's bounds
BOUND_TOLERANCE_M = 0.005  # error by which other bounds may be simplified
MIN_AREA_WIDTH_M = 0.2  # narrower parts of an area are removed
NODE_TOLERANCE_M = 0.03  # two points within this distance are one node
WALKWAY_HALF_WIDTH_M = 1.2
LONLAT_DECIMALS = 11
FIRST_ELEMENT_ID = 1_000_001  # first id of ways and relations; nodes are numbered from 1
SOLID, DASHED = ("line_thin", "solid"), ("line_thin", "dashed")
KERB, VIRTUAL = ("curbstone", "low"), ("virtual", "")
TURN_DIRECTIONS = {"L": "left", "S": "straight", "R": "right"}
LineType = tuple[str, str]  # lanelet2's type and subtype


@dataclass
class _Draft:
    """The map while it is written: points, and ways and relations as XML."""

    points: list[Float[Array, "2"]] = field(default_factory=list)
    ways: dict[tuple[int, ...], int] = field(default_factory=dict)
    elements: list[ET.Element] = field(default_factory=list)


def make_lanelet_map(
    roads: Roads, world_from_plan: Float[Array, "3 3"], world: World, *, complete: bool = False
) -> bytes:
    """Write the HD map of a place in the Lanelet2 format.

    Args:
        roads: the plan.
        world_from_plan: (3, 3) plan metres to world metres.
        world: CRS and origin of these world metres, for longitudes and latitudes.
        complete: whether to add walkways, crossings, car park and private roads to the lanes.

    Returns:
        The content of an .osm file.
    """
    draft = _Draft()
    private = () if complete else roads.layout.private
    mapped = [lane for lane in roads.lanes if not {*lane.name.split()} & {*private}]
    lanelets = {lane.name: _add_lane(draft, roads, lane) for lane in mapped}
    for approach in roads.layout.approaches:
        if np.isfinite(approach.stop) and approach.name not in private:
            _add_rules(draft, roads, approach, lanelets)
    if complete:
        _add_walkways(draft, roads)
    if complete and roads.car_park is not None:
        ground = shapely.union_all([roads.paving.parking_lot, roads.paving.driveway])
        _add_area(draft, ground, {"type": "multipolygon", "subtype": "parking"})
    root = ET.Element("osm", version="0.6", generator="geoaim")
    lonlat = lonlat_from_world(world, transform_points(world_from_plan, np.array(draft.points)))
    for number, (lon, lat) in enumerate(lonlat.tolist(), 1):
        position = {"lat": f"{lat:.{LONLAT_DECIMALS}f}", "lon": f"{lon:.{LONLAT_DECIMALS}f}"}
        ET.SubElement(root, "node", {"id": str(number), "version": "1"} | position)
    root.extend(sorted(draft.elements, key=lambda element: element.tag == "relation"))
    ET.indent(root, " ")
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)


def _add_lane(draft: _Draft, roads: Roads, lane: Lane) -> ET.Element:
    """Add a lanelet between the bounds of a lane."""
    tags = {"type": "lanelet", "subtype": "road", "location": "urban", "one_way": "yes"}
    tags |= {"name": lane.name, "speed_limit": f"{round(3.6 * lane.speed_limit)} km/h"}
    tags |= {"turn_direction": TURN_DIRECTIONS[lane.turn]} if lane.turn else {}
    bounds, types = _make_bounds(roads, lane), _choose_bound_types(roads, lane)
    left, right = (_add_way(draft, *bound) for bound in zip(bounds, types, strict=True))
    return _add_relation(draft, [("way", left, "left"), ("way", right, "right")], tags)


def _make_bounds(roads: Roads, lane: Lane) -> tuple[Polyline, Polyline]:
    """The left and right bound; neighbouring lanes of an approach share theirs exactly."""
    words = lane.name.split()
    if words[1] not in ("in", "out"):
        left, right = compute_lane_bounds(lane)
        return _simplify(left), _simplify(right)
    approach, index = find_approach(roads.layout, words[0]), int(words[2])
    locate_lane = locate_inbound_lane if words[1] == "in" else locate_outbound_lane
    t = locate_lane(approach, index)
    length = LANE_END_M - approach.mouth
    s = np.linspace(approach.mouth, LANE_END_M, round(length / BOUND_SPACING_M) + 1)
    low, high = (
        plan_from_road(approach, np.stack([s, np.full_like(s, round(t + side, 6))], axis=1))
        for side in (-approach.lane_width / 2, approach.lane_width / 2)
    )
    return (low[::-1], high[::-1]) if words[1] == "in" else (high, low)


def _choose_bound_types(roads: Roads, lane: Lane) -> tuple[LineType, LineType]:
    if " in " in lane.name or " out " in lane.name:
        name, direction, index = lane.name.split()
        approach = find_approach(roads.layout, name)
        count = len(approach.turns) if direction == "in" else approach.outbound_lanes
        return SOLID if index == "0" else DASHED, SOLID if int(index) == count - 1 else DASHED
    if lane.name.startswith("ring"):
        return KERB, VIRTUAL if "past" in lane.name else KERB
    return VIRTUAL, KERB if " ring" in lane.name else VIRTUAL


def _add_rules(
    draft: _Draft, roads: Roads, approach: Approach, lanelets: dict[str, ET.Element]
) -> None:
    """Add the traffic lights, or the right of way, at an approach's stop line."""
    lanes_of: dict[str, list[int]] = {}
    for index, turns in enumerate(approach.turns):
        signal = find_signal(roads, f"{approach.name} in {index}", turns[0])
        lanes_of.setdefault(signal, []).append(index)
    for signal, indices in lanes_of.items():
        inner = locate_inbound_lane(approach, min(indices)) - approach.lane_width / 2
        outer = locate_inbound_lane(approach, max(indices)) + approach.lane_width / 2
        line = plan_from_road(approach, np.array([[approach.stop, t] for t in (inner, outer)]))
        if roads.layout.ring_radius:
            line = locate_give_way_line(roads.layout, approach)
        members = [("way", _add_way(draft, line, ("stop_line", "")), "ref_line")]
        tags = {"type": "regulatory_element", "subtype": "right_of_way"}
        names = [f"{approach.name} in {index}" for index in indices]
        if signal:
            s = approach.stop - 0.6
            bar = plan_from_road(approach, np.array([[s, inner + 0.8], [s, inner + 1.6]]))
            light = _add_way(draft, bar, ("traffic_light", "red_yellow_green"))
            members.append(("way", light, "refers"))
            tags |= {"subtype": "traffic_light", "name": signal}
        else:
            names, others = _list_right_of_way(roads, approach, names)
            members += [_refer_to(lanelets[n], "yield") for n in names]
            members += [_refer_to(lanelets[n], "right_of_way") for n in others if n in lanelets]
        rule = _add_relation(draft, members, tags)
        for name in names:
            _attach_rule(lanelets[name], rule)


def _list_right_of_way(
    roads: Roads, approach: Approach, names: list[str]
) -> tuple[list[str], list[str]]:
    """The lanes that give way at an approach, and those with the right of way."""
    approaches = roads.layout.approaches
    if roads.layout.ring_radius:
        before = approaches[approaches.index(approach) - 1].name
        ring = [f"ring after {before}", f"ring past {approach.name}"]
        return [f"{approach.name} onto ring"], ring
    main = [other for other in approaches if not np.isfinite(other.stop)]
    return names, [f"{other.name} in {k}" for other in main for k in range(len(other.turns))]


def _add_walkways(draft: _Draft, roads: Roads) -> None:
    """Add crosswalks, and walkways along pavements and footpaths."""
    for edge in roads.footpaths.edges:
        crossing = roads.crossings[edge.crossing] if edge.crossing >= 0 else None
        marked = crossing if crossing is not None and crossing.marked else None
        half = marked.width / 2 if marked else WALKWAY_HALF_WIDTH_M
        line_type: LineType = ("pedestrian_marking", "") if marked else VIRTUAL
        bounds = [_simplify(offset_polyline(edge.line, side * half)) for side in (1, -1)]
        left, right = (_add_way(draft, bound, line_type) for bound in bounds)
        tags = {"type": "lanelet", "subtype": "crosswalk" if marked else "walkway"}
        tags |= {"location": "urban", "one_way": "no", "participant:pedestrian": "yes"}
        lanelet = _add_relation(draft, [("way", left, "left"), ("way", right, "right")], tags)
        if marked and marked.signalised:
            _add_pedestrian_light(draft, marked, lanelet)


def _add_pedestrian_light(draft: _Draft, crossing: Crossing, lanelet: ET.Element) -> None:
    """Add the pedestrians' traffic light at the crossing's first end."""
    bar = crossing.ends[0] + np.array([[0.0, 0.0], [0.3, 0.0]])
    light = _add_way(draft, bar, ("traffic_light", "red_green"))
    tags = {"type": "regulatory_element", "subtype": "traffic_light"}
    tags["name"] = f"walk {crossing.name}"
    _attach_rule(lanelet, _add_relation(draft, [("way", light, "refers")], tags))


def _add_area(draft: _Draft, ground: shapely.Geometry, tags: dict[str, str]) -> None:
    """Add an area without the slivers that differences of curves leave."""
    width = MIN_AREA_WIDTH_M
    opened = ground.buffer(width, join_style="mitre").buffer(-2 * width, join_style="mitre")
    for part in shapely.get_parts(opened.buffer(width, join_style="mitre")):
        if isinstance(part, Polygon):
            ring = np.array(part.exterior.simplify(width / 2).coords)
            _add_relation(draft, [("way", _add_way(draft, ring, KERB), "outer")], tags)


def _simplify(line: Polyline) -> Polyline:
    return np.array(LineString(line).simplify(BOUND_TOLERANCE_M).coords)


def _add_way(draft: _Draft, line: Polyline, line_type: LineType) -> int:
    """The id of a way; an existing way through the same nodes, in either order, is reused."""
    every = [_add_node(draft, point) for point in line]
    nodes = tuple(node for node, before in zip(every, [0, *every], strict=False) if node != before)
    existing = draft.ways.get(nodes) or draft.ways.get(nodes[::-1])
    if existing:
        return existing
    number = FIRST_ELEMENT_ID + len(draft.elements)
    draft.ways[nodes] = number
    element = ET.Element("way", id=str(number), version="1")
    for node in nodes:
        ET.SubElement(element, "nd", ref=str(node))
    kind, subtype = line_type
    _add_tags(element, {"type": kind} | ({"subtype": subtype} if subtype else {}))
    draft.elements.append(element)
    return number


def _add_node(draft: _Draft, point: Float[Array, "2"]) -> int:
    """The id of a node; an existing node within the tolerance is reused."""
    if draft.points:
        distances = np.abs(np.array(draft.points) - point).max(axis=1)
        nearest = int(np.argmin(distances))
        if distances[nearest] < NODE_TOLERANCE_M:
            return nearest + 1
    draft.points.append(point)
    return len(draft.points)


def _add_relation(
    draft: _Draft, members: list[tuple[str, int, str]], tags: dict[str, str]
) -> ET.Element:
    """Add a relation with members (element, id, role)."""
    number = FIRST_ELEMENT_ID + len(draft.elements)
    element = ET.Element("relation", id=str(number), version="1")
    for kind, ref, role in members:
        ET.SubElement(element, "member", type=kind, ref=str(ref), role=role)
    _add_tags(element, tags)
    draft.elements.append(element)
    return element


def _refer_to(lanelet: ET.Element, role: str) -> tuple[str, int, str]:
    """A lanelet as a member of another relation."""
    return "relation", int(lanelet.attrib["id"]), role


def _attach_rule(lanelet: ET.Element, rule: ET.Element) -> None:
    """Make a regulatory element a member of a lanelet, after its two bounds."""
    member = {"type": "relation", "ref": rule.attrib["id"], "role": "regulatory_element"}
    lanelet.insert(2, ET.Element("member", member))


def _add_tags(element: ET.Element, tags: dict[str, str]) -> None:
    for key, value in tags.items():
        ET.SubElement(element, "tag", k=key, v=value)
