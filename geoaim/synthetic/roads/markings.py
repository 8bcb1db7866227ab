"""Paint on the roads, as polygons: lines, arrows, crossings, bays."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.synthetic.roads.arms import (
    GUTTER,
    Arm,
    divider,
    half_width,
    lane_in,
    on_arm,
    strip,
    turn_between,
)
from geoaim.synthetic.roads.car_park import AISLE, BAY, NEAR, CarPark
from geoaim.synthetic.roads.curves import Line
from geoaim.synthetic.roads.lanes import FAR
from geoaim.synthetic.roads.layouts import CROSSING, CYCLES, STRETCHES, Layout
from geoaim.synthetic.roads.paving import Crossing, lot_polygon
from geoaim.synthetic.roads.plan import Roads

THIN = 0.12  # m, width of a line
STOP = 0.45  # m, width of a stop line
DASH, GAP = 3.0, 4.5  # m
SOLID = 18.0  # m before a stop line where lanes must be kept
STRIPE = 0.5  # m, width of a crossing's stripes and of the gaps between them
TEETH = 0.6  # m, length of the dashes of a give-way line
RIM, JOIN = 2.9, (0.05, 0.5)  # m from the ring lane's middle, and radians: where they are


def paint(roads: Roads) -> list[Line]:
    """White paint."""
    polygons: list[Line] = []
    for arm in roads.layout.arms:
        polygons += [*_edges(arm), *_middle(arm), *_lane_lines(arm)]
        polygons += [*_stop_line(arm, roads.layout), *_arrows(arm, roads.layout)]
    for crossing in roads.crossings:
        if crossing.marked:
            polygons += _stripes(crossing)
    if roads.layout.ring:
        polygons += _ring_teeth(roads.layout)
    if roads.car_park is not None:
        polygons += _bays(roads.car_park)
    return polygons


def cycle_strips(roads: Roads) -> list[Line]:
    """The coloured strips on which cycles cross, between the stripes and the stop lines."""
    strips = []
    if roads.layout.kind == "junction":
        for arm in roads.layout.arms:
            at = arm.crossing + CROSSING + 0.35
            half = half_width(arm) + 0.8
            strips.append(strip(arm, (at, at + CYCLES - 0.7), (-half, half)))
    return strips


def tactile_strips(roads: Roads) -> list[Line]:
    """Ribbed slabs on the pavement at both ends of the marked crossings."""
    strips = []
    for crossing in roads.crossings:
        if crossing.marked:
            first, last = crossing.ends
            ahead = (last - first) / np.hypot(*(last - first))
            left = np.array([-ahead[1], ahead[0]]) * crossing.width / 2
            for end, out in ((first, -ahead), (last, ahead)):
                near, far = end + 0.25 * out, end + 1.35 * out
                strips.append(np.array([near - left, far - left, far + left, near + left]))
    return strips


def landmarks(roads: Roads) -> tuple[tuple[str, ...], Float[Array, "M 2"]]:
    """Points that a surveyor would choose: ends of stop lines, corners of crossings, manholes."""
    names, places = [], []
    for arm in roads.layout.arms:
        if np.isfinite(arm.stop) and not roads.layout.ring:
            outer = lane_in(arm, len(arm.turns) - 1) + arm.lane / 2 - THIN
            names.append(f"stop line {arm.name}")
            places.append(on_arm(arm, np.array([[arm.stop + STOP, outer]]))[0])
    for crossing in roads.crossings:
        if crossing.marked:
            names.append(f"crossing {crossing.name}")
            places.append(_stripes(crossing)[0][0])
    for number, place in enumerate(manholes(roads)):
        names.append(f"manhole {number}")
        places.append(place)
    return tuple(names), np.array(places)


def manholes(roads: Roads) -> Line:
    """Covers on the lanes: two on each arm."""
    spots = []
    for k, arm in enumerate(roads.layout.arms):
        for along, across in ((22.0 + 3 * k, 0.4), (41.0 + 2 * k, -0.6)):
            at = max(along, arm.mouth + 6 + along / 5)
            spots.append(on_arm(arm, np.array([[at, across * half_width(arm)]]))[0])
    return np.array(spots)


def _start(arm: Arm) -> float:
    """Where an arm's lines begin, outside of its stop line and crossing."""
    ends = [arm.mouth, arm.stop, arm.crossing + CROSSING + 0.4]
    return float(np.nanmax(ends))


def _edges(arm: Arm) -> list[Line]:
    at, start = half_width(arm) - GUTTER + 0.06, _start(arm)
    return [strip(arm, (start, FAR), side) for side in ((at, at + THIN), (-at - THIN, -at))]


def _middle(arm: Arm) -> list[Line]:
    """Between the directions: solid where there are lights or several lanes, else dashed."""
    at, start, half = divider(arm), _start(arm), THIN / 2
    if arm.median:
        around = arm.median / 2 - 0.12
        island = arm.crossing + CROSSING + 15.0
        return [
            strip(arm, (island, FAR), (at + side - half, at + side + half))
            for side in (-around, around)
        ]
    if len(arm.turns) + arm.lanes_out > 2:
        return [
            strip(arm, (start, FAR), (at + side - half, at + side + half)) for side in (-0.12, 0.12)
        ]
    solid = strip(arm, (start, start + SOLID), (at - half, at + half))
    return [solid, *_dashes(arm, start + SOLID + GAP, at)]


def _lane_lines(arm: Arm) -> list[Line]:
    """Between lanes of one direction: kept before the stop line, dashed elsewhere."""
    start, half, lines = _start(arm), THIN / 2, []
    for rank in range(1, len(arm.turns)):
        at = lane_in(arm, rank) - arm.lane / 2
        lines.append(strip(arm, (start, start + SOLID), (at - half, at + half)))
        lines += _dashes(arm, start + SOLID + GAP, at)
    for rank in range(1, arm.lanes_out):
        lines += _dashes(arm, start + GAP, divider(arm) - arm.median / 2 - rank * arm.lane)
    return lines


def _dashes(arm: Arm, start: float, across: float) -> list[Line]:
    half = THIN / 2
    return [
        strip(arm, (s, s + DASH), (across - half, across + half))
        for s in np.arange(start, FAR, DASH + GAP).tolist()
    ]


def _stop_line(arm: Arm, layout: Layout) -> list[Line]:
    """A bar where lights or a stop sign hold; teeth where one gives way."""
    if not np.isfinite(arm.stop) or layout.ring:
        return []
    inner = lane_in(arm, 0) - arm.lane / 2 + 0.15
    outer = lane_in(arm, len(arm.turns) - 1) + arm.lane / 2 - THIN
    if layout.signalised:
        return [strip(arm, (arm.stop, arm.stop + STOP), (inner, outer))]
    return [
        strip(arm, (arm.stop, arm.stop + STOP), (o, min(o + TEETH, outer)))
        for o in np.arange(inner, outer, 2 * TEETH).tolist()
    ]


def give_way_line(layout: Layout, arm: Arm) -> Line:
    """The middle of a roundabout's dashes where an arm joins."""
    angle = arm.angle + np.linspace(*JOIN, 8)
    return (layout.ring + RIM + 0.2) * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _ring_teeth(layout: Layout) -> list[Line]:
    """The give-way lines of a roundabout: dashes along its rim where lanes join."""
    outside, teeth = layout.ring + RIM, []
    for arm in layout.arms:
        for turn in np.arange(*JOIN, 2 * TEETH / outside):
            angle = arm.angle + np.linspace(turn, turn + TEETH / outside, 3)
            ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            teeth.append(np.concatenate([outside * ring, (outside + 0.4) * ring[::-1]]))
    return teeth


def _stripes(crossing: Crossing) -> list[Line]:
    """Stripes along the traffic, side by side from kerb to kerb."""
    first, last = crossing.ends
    length = float(np.hypot(*(last - first)))
    ahead = (last - first) / length
    left = np.array([-ahead[1], ahead[0]]) * crossing.width / 2
    count = int((length - 0.6) / (2 * STRIPE))
    start = (length - (2 * count - 1) * STRIPE) / 2
    stripes = []
    for k in range(count):
        near = first + ahead * (start + 2 * k * STRIPE)
        far = near + ahead * STRIPE
        stripes.append(np.array([near - left, far - left, far + left, near + left]))
    return stripes


def _arrows(arm: Arm, layout: Layout) -> list[Line]:
    """The turns that each lane serves, where there is more than one lane or a light."""
    if layout.ring or not np.isfinite(arm.stop) or layout.kind in STRETCHES:
        return []
    possible = {turn_between(arm, other) for other in layout.arms if other is not arm}
    arrows = []
    for rank, turns in enumerate(arm.turns):
        for back in (6.0, 27.0):
            spot = np.array([_start(arm) + back, lane_in(arm, rank)])
            served = sorted(set(turns) & possible)
            for turn in served:
                behind = 1.3 if len(served) > 1 and turn != "S" else 0.0
                arrows.append(on_arm(arm, _arrow(turn) + spot + [behind, 0.0]))
    return arrows


def _arrow(turn: str) -> Line:
    """An arrow along and across an arm that points to its middle, or bends to one side."""
    if turn == "S":
        half = [(3.6, 0.08), (1.4, 0.08), (1.4, 0.42), (0.0, 0.0)]
        return np.array([*half, *[(s, -o) for s, o in half[-2::-1]]])
    bent = [(3.6, 0.08), (0.5, 0.08), (0.5, -0.5), (0.9, -0.5), (0.3, -1.15), (-0.3, -0.5)]
    bent += [(0.2, -0.5), (0.2, -0.08), (3.6, -0.08)]
    return np.array(bent) * [1.0, 1.0 if turn == "L" else -1.0]


def _bays(car_park: CarPark) -> list[Line]:
    """Lines between the bays."""
    lines = []
    for bay in range(car_park.bays + 1):
        deep = NEAR + bay * BAY[0]
        for side in (1, -1):
            beside = (side * AISLE / 2, side * (AISLE / 2 + BAY[1]))
            lines.append(lot_polygon(car_park, beside, (deep - 0.06, deep + 0.06)))
    return lines
