"""Road markings as polygons, manholes, and landmarks among them."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.synthetic.roads.approaches import (
    GUTTER_M,
    Approach,
    classify_turn,
    locate_inbound_lane,
    outline_strip,
    plan_from_road,
)
from benchmarks.synthetic.roads.car_park import (
    AISLE_WIDTH_M,
    BAY_SIZE_M,
    BAYS,
    FIRST_BAY_M,
    CarPark,
    outline_car_park_part,
)
from benchmarks.synthetic.roads.curves import Polyline
from benchmarks.synthetic.roads.lanes import LANE_END_M
from benchmarks.synthetic.roads.layouts import CROSSING_WIDTH_M, STREET_KINDS, Layout
from benchmarks.synthetic.roads.paving import Crossing
from benchmarks.synthetic.roads.plan import Roads

LINE_WIDTH_M = 0.12
STOP_LINE_WIDTH_M = 0.45
DASH_M, DASH_GAP_M = 3.0, 4.5
SOLID_LINE_M = 18.0  # length before a stop line on which changing lanes is forbidden
STRIPE_WIDTH_M = 0.5  # width of a crossing's stripes and of the gaps between them
GIVE_WAY_DASH_M = 0.6
RING_LINE_OFFSET_M = 2.9  # distance of a roundabout's give-way line from the ring lane's centreline
RING_LINE_ANGLES = (0.05, 0.5)  # radians from an approach, between which that line lies


def make_markings(roads: Roads) -> list[Polyline]:
    """Make the white markings of all roads, as polygons in plan metres."""
    layout = roads.layout
    polygons: list[Polyline] = []
    for approach in layout.approaches:
        polygons += _make_edge_lines(approach) + _make_divider(approach)
        polygons += _make_lane_lines(approach)
        polygons += _make_stop_line(approach, layout) + _make_arrows(approach, layout)
    for crossing in roads.crossings:
        if crossing.marked:
            polygons += _make_stripes(crossing)
    if layout.ring_radius:
        polygons += _make_ring_dashes(layout)
    if roads.car_park is not None:
        polygons += _make_bay_lines(roads.car_park)
    return polygons


def list_landmarks(roads: Roads) -> tuple[tuple[str, ...], Float[Array, "M 2"]]:
    """List names and places (plan metres) of points that a surveyor would take.

    These are ends of stop lines, corners of crossings, and manholes.
    """
    names, points = [], []
    for approach in roads.layout.approaches:
        if np.isfinite(approach.stop) and not roads.layout.ring_radius:
            corner = [approach.stop + STOP_LINE_WIDTH_M, _span_inbound_lanes(approach)[1]]
            names.append(f"stop line {approach.name}")
            points.append(plan_from_road(approach, np.array([corner]))[0])
    for crossing in roads.crossings:
        if crossing.marked:
            names.append(f"crossing {crossing.name}")
            points.append(_make_stripes(crossing)[0][0])
    for number, point in enumerate(locate_manholes(roads)):
        names.append(f"manhole {number}")
        points.append(point)
    return tuple(names), np.array(points)


def locate_manholes(roads: Roads) -> Float[Array, "M 2"]:
    """Locate the centres of manhole covers, in plan metres: two on each approach."""
    points = []
    for k, approach in enumerate(roads.layout.approaches):
        for min_s, share in ((22.0 + 3 * k, 0.4), (41.0 + 2 * k, -0.6)):
            s = max(min_s, approach.mouth + 6 + min_s / 5)
            point = np.array([[s, share * approach.half_width]])
            points.append(plan_from_road(approach, point)[0])
    return np.array(points)


def locate_give_way_line(layout: Layout, approach: Approach) -> Polyline:
    """Compute the centreline of a roundabout's give-way line at an approach.

    Returns:
        (8, 2) points in plan metres. Only layouts with a `ring_radius` have such lines.
    """
    angle = approach.angle + np.linspace(*RING_LINE_ANGLES, 8)
    radius = layout.ring_radius + RING_LINE_OFFSET_M + 0.2
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _locate_line_start(approach: Approach) -> float:
    """The s where an approach's lines begin, behind its stop line and crossing."""
    ends = [approach.mouth, approach.stop, approach.crossing + CROSSING_WIDTH_M + 0.4]
    return float(np.nanmax(ends))


def _make_edge_lines(approach: Approach) -> list[Polyline]:
    t, start = approach.half_width - GUTTER_M + 0.06, _locate_line_start(approach)
    spans = ((t, t + LINE_WIDTH_M), (-t - LINE_WIDTH_M, -t))
    return [outline_strip(approach, (start, LANE_END_M), span) for span in spans]


def _make_divider(approach: Approach) -> list[Polyline]:
    """Between the directions: solid at a median or with several lanes, else dashed at its end."""
    t, start = approach.divider, _locate_line_start(approach)
    if approach.median:
        island_end = approach.crossing + CROSSING_WIDTH_M + 15.0
        side = approach.median / 2 - 0.12
        return [_make_line(approach, (island_end, LANE_END_M), t + x) for x in (-side, side)]
    if len(approach.turns) + approach.outbound_lanes > 2:
        return [_make_line(approach, (start, LANE_END_M), t + x) for x in (-0.12, 0.12)]
    solid = _make_line(approach, (start, start + SOLID_LINE_M), t)
    return [solid, *_make_dashes(approach, start + SOLID_LINE_M + DASH_GAP_M, t)]


def _make_lane_lines(approach: Approach) -> list[Polyline]:
    """Between lanes of one direction: solid before the stop line, dashed elsewhere."""
    start, lines = _locate_line_start(approach), []
    for index in range(1, len(approach.turns)):
        t = locate_inbound_lane(approach, index) - approach.lane_width / 2
        lines.append(_make_line(approach, (start, start + SOLID_LINE_M), t))
        lines += _make_dashes(approach, start + SOLID_LINE_M + DASH_GAP_M, t)
    for index in range(1, approach.outbound_lanes):
        t = approach.divider - approach.median / 2 - index * approach.lane_width
        lines += _make_dashes(approach, start + DASH_GAP_M, t)
    return lines


def _make_line(approach: Approach, s: tuple[float, float], t: float) -> Polyline:
    half = LINE_WIDTH_M / 2
    return outline_strip(approach, s, (t - half, t + half))


def _make_dashes(approach: Approach, start: float, t: float) -> list[Polyline]:
    starts = np.arange(start, LANE_END_M, DASH_M + DASH_GAP_M).tolist()
    return [_make_line(approach, (s, s + DASH_M), t) for s in starts]


def _span_inbound_lanes(approach: Approach) -> tuple[float, float]:
    """The t of the inner and the outer end of a stop line."""
    inner = locate_inbound_lane(approach, 0) - approach.lane_width / 2 + 0.15
    outer = locate_inbound_lane(approach, len(approach.turns) - 1) + approach.lane_width / 2
    return inner, outer - LINE_WIDTH_M


def _make_stop_line(approach: Approach, layout: Layout) -> list[Polyline]:
    """A solid stop line at traffic lights, a dashed give-way line elsewhere."""
    if not np.isfinite(approach.stop) or layout.ring_radius:
        return []
    inner, outer = _span_inbound_lanes(approach)
    s = approach.stop, approach.stop + STOP_LINE_WIDTH_M
    if layout.signalised:
        return [outline_strip(approach, s, (inner, outer))]
    starts = np.arange(inner, outer, 2 * GIVE_WAY_DASH_M).tolist()
    return [outline_strip(approach, s, (t, min(t + GIVE_WAY_DASH_M, outer))) for t in starts]


def _make_ring_dashes(layout: Layout) -> list[Polyline]:
    """The give-way lines of a roundabout: dashes along the ring where approaches join it."""
    radius, dashes = layout.ring_radius + RING_LINE_OFFSET_M, []
    length = GIVE_WAY_DASH_M / radius
    for approach in layout.approaches:
        for start in np.arange(*RING_LINE_ANGLES, 2 * GIVE_WAY_DASH_M / radius):
            angle = approach.angle + np.linspace(start, start + length, 3)
            circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            dashes.append(np.concatenate([radius * circle, (radius + 0.4) * circle[::-1]]))
    return dashes


def _measure_crossing(crossing: Crossing) -> tuple[Array, Array, float]:
    """Its unit direction, a vector to its left edge, and its length in metres."""
    first, last = crossing.ends
    length = float(np.hypot(*(last - first)))
    direction = (last - first) / length
    return direction, np.array([-direction[1], direction[0]]) * crossing.width / 2, length


def _make_stripes(crossing: Crossing) -> list[Polyline]:
    """Stripes parallel to the traffic, side by side from kerb to kerb."""
    direction, left, length = _measure_crossing(crossing)
    count = int((length - 0.6) / (2 * STRIPE_WIDTH_M))
    start = (length - (2 * count - 1) * STRIPE_WIDTH_M) / 2
    stripes = []
    for k in range(count):
        near = crossing.ends[0] + direction * (start + 2 * k * STRIPE_WIDTH_M)
        far = near + direction * STRIPE_WIDTH_M
        stripes.append(np.array([near - left, far - left, far + left, near + left]))
    return stripes


def _make_arrows(approach: Approach, layout: Layout) -> list[Polyline]:
    """Arrows for the turns that each inbound lane serves, at junctions with a stop line."""
    if layout.ring_radius or not np.isfinite(approach.stop) or layout.kind in STREET_KINDS:
        return []
    others = [other for other in layout.approaches if other is not approach]
    possible = {classify_turn(approach, other) for other in others}
    arrows = []
    for index, turns in enumerate(approach.turns):
        served = sorted(set(turns) & possible)
        for distance in (6.0, 27.0):
            s, t = _locate_line_start(approach) + distance, locate_inbound_lane(approach, index)
            for turn in served:
                shift = 1.3 if len(served) > 1 and turn != "S" else 0.0
                outline = _outline_arrow(turn) + np.array([s, t]) + [shift, 0.0]
                arrows.append(plan_from_road(approach, outline))
    return arrows


def _outline_arrow(turn: str) -> Polyline:
    """An arrow in road coordinates that points to the centre, or turns to one side."""
    if turn == "S":
        half = [(3.6, 0.08), (1.4, 0.08), (1.4, 0.42), (0.0, 0.0)]
        return np.array([*half, *[(s, -t) for s, t in half[-2::-1]]])
    bent = [(3.6, 0.08), (0.5, 0.08), (0.5, -0.5), (0.9, -0.5), (0.3, -1.15), (-0.3, -0.5)]
    bent += [(0.2, -0.5), (0.2, -0.08), (3.6, -0.08)]
    return np.array(bent) * [1.0, 1.0 if turn == "L" else -1.0]


def _make_bay_lines(car_park: CarPark) -> list[Polyline]:
    lines = []
    for bay in range(BAYS + 1):
        deep = FIRST_BAY_M + bay * BAY_SIZE_M[0]
        for side in (1, -1):
            along = (side * AISLE_WIDTH_M / 2, side * (AISLE_WIDTH_M / 2 + BAY_SIZE_M[1]))
            lines.append(outline_car_park_part(car_park, along, (deep - 0.06, deep + 0.06)))
    return lines
