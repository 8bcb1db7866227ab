"""Lanes of a place: on its approaches, through the junction, and around a roundabout."""

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.synthetic.roads import curves
from benchmarks.synthetic.roads.approaches import (
    Approach,
    classify_turn,
    locate_inbound_lane,
    locate_outbound_lane,
    plan_from_road,
)
from benchmarks.synthetic.roads.layouts import RING_LANE_WIDTH_M, Layout

# distance from the centre, outside the drawn extent, at which lanes begin and end
LANE_END_M = 150.0
RING_JOIN_ANGLE = 0.62  # radians on the ring from an approach to where its lanes join and leave
RING_SPEED_LIMIT = 8.3  # m/s


@dataclass(frozen=True)
class Lane:
    """A lane in the direction of its traffic."""

    name: str  # "east in 0", "east 0 to north 0", "north out 0", "ring past east", ...
    centreline: curves.Polyline  # equally spaced points, plan metres
    width: tuple[float, float]  # metres
    speed_limit: float = 13.9  # m/s
    turn: str = ""  # L, S or R through the junction; "" elsewhere


@dataclass(frozen=True)
class Route:
    """The sequence of lanes from one approach to another."""

    origin: str  # name of the approach where it begins
    destination: str  # name of the approach where it ends
    lanes: tuple[str, ...]  # their names, in the order of travel
    turn: str  # L, S or R


def make_lanes(layout: Layout) -> tuple[tuple[Lane, ...], tuple[Route, ...]]:
    """Make all lanes of a layout, and all routes over them."""
    lanes = [lane for approach in layout.approaches for lane in _make_approach_lanes(approach)]
    by_name = {lane.name: lane for lane in lanes}
    if layout.ring_radius:
        lanes += _make_ring_lanes(layout, by_name)
        routes = _list_ring_routes(layout.approaches)
    else:
        connecting, routes = _make_connecting_lanes(layout.approaches, by_name)
        lanes += connecting
    return tuple(lanes), tuple(routes)


def compute_lane_bounds(lane: Lane) -> tuple[curves.Polyline, curves.Polyline]:
    """Compute the left and the right bound of a lane, in plan metres."""
    share = np.linspace(0, 1, len(lane.centreline))
    half = 0.5 * (lane.width[0] + (lane.width[1] - lane.width[0]) * share)
    return curves.offset_polyline(lane.centreline, half), curves.offset_polyline(
        lane.centreline, -half
    )


def _make_approach_lanes(approach: Approach) -> list[Lane]:
    """The inbound and outbound lanes of an approach, outside its mouth."""
    s = np.linspace(approach.mouth, LANE_END_M, int(2 * (LANE_END_M - approach.mouth)))
    inbound = [locate_inbound_lane(approach, k) for k in range(len(approach.turns))]
    outbound = [locate_outbound_lane(approach, k) for k in range(approach.outbound_lanes)]

    def make(name: str, s: Float[Array, "L"], t: float) -> Lane:
        line = plan_from_road(approach, np.stack([s, np.full_like(s, t)], axis=1))
        width = (approach.lane_width, approach.lane_width)
        return Lane(name, curves.resample_polyline(line), width, approach.speed_limit)

    lanes = [make(f"{approach.name} in {k}", s[::-1], t) for k, t in enumerate(inbound)]
    return lanes + [make(f"{approach.name} out {k}", s, t) for k, t in enumerate(outbound)]


def _make_connecting_lanes(
    approaches: tuple[Approach, ...], by_name: dict[str, Lane]
) -> tuple[list[Lane], list[Route]]:
    """A lane through the junction for each turn that an inbound lane serves."""
    connecting, routes = [], []
    inbound = [(a, k, turns) for a in approaches for k, turns in enumerate(a.turns)]
    for (origin, index, turns), destination in product(inbound, approaches):
        turn = classify_turn(origin, destination)
        if destination is origin or turn not in turns:
            continue
        exit_index = _choose_exit_lane(origin, destination, index, turn)
        start, end = f"{origin.name} in {index}", f"{destination.name} out {exit_index}"
        name = f"{origin.name} {index} to {destination.name} {exit_index}"
        before, after = by_name[start].centreline, by_name[end].centreline
        headings = curves.compute_headings(before)[-1], curves.compute_headings(after)[0]
        line = curves.connect_poses(before[-1], headings[0], after[0], headings[1])
        width = (origin.lane_width, destination.lane_width)
        speed_limit = min(origin.speed_limit, destination.speed_limit)
        connecting.append(Lane(name, line, width, speed_limit, turn))
        routes.append(Route(origin.name, destination.name, (start, name, end), turn))
    return connecting, routes


def _choose_exit_lane(origin: Approach, destination: Approach, index: int, turn: str) -> int:
    """Left turns take the inner lane, right turns the outer one, others the lane opposite."""
    lanes = destination.outbound_lanes
    if turn == "L":
        return 0
    if turn == "R":
        return lanes - 1
    return int(np.clip(index - (len(origin.turns) - lanes), 0, lanes - 1))


def _make_ring_lanes(layout: Layout, by_name: dict[str, Lane]) -> list[Lane]:
    """The lanes around the ring, and for each approach one onto the ring and one off it."""
    radius, approaches = layout.ring_radius, layout.approaches
    lanes = []
    for road, following in zip(approaches, [*approaches[1:], approaches[0]], strict=True):
        on, off = road.angle + RING_JOIN_ANGLE, road.angle - RING_JOIN_ANGLE
        inbound, outbound = (by_name[f"{road.name} {way} 0"].centreline for way in ("in", "out"))
        join, leave = radius * curves.make_unit_vector(on), radius * curves.make_unit_vector(off)
        ends = curves.compute_headings(inbound)[-1], curves.compute_headings(outbound)[0]
        bend, turn = 1 / radius, np.pi / 2
        onto = curves.connect_poses(inbound[-1], ends[0], join, on + turn, end_curvature=bend)
        away = curves.connect_poses(leave, off + turn, outbound[0], ends[1], start_curvature=bend)
        gap = (following.angle - RING_JOIN_ANGLE - on) % (2 * np.pi)
        past, after = (curves.sample_arc(radius, angles) for angles in ((off, on), (on, on + gap)))
        wide, narrow = RING_LANE_WIDTH_M, road.lane_width
        lanes += [
            Lane(f"{road.name} onto ring", onto, (narrow, wide), RING_SPEED_LIMIT),
            Lane(f"{road.name} off ring", away, (wide, narrow), RING_SPEED_LIMIT),
            Lane(f"ring past {road.name}", past, (wide, wide), RING_SPEED_LIMIT),
            Lane(f"ring after {road.name}", after, (wide, wide), RING_SPEED_LIMIT),
        ]
    return lanes


def _list_ring_routes(approaches: tuple[Approach, ...]) -> list[Route]:
    """The routes from each approach of a roundabout to every other."""
    routes = []
    for i, origin in enumerate(approaches):
        following = [*approaches[i:], *approaches[:i]]
        lanes = [f"{origin.name} in 0", f"{origin.name} onto ring"]
        for before, destination in pairwise(following):
            lanes.append(f"ring after {before.name}")
            names = (*lanes, f"{destination.name} off ring", f"{destination.name} out 0")
            turn = classify_turn(origin, destination)
            routes.append(Route(origin.name, destination.name, names, turn))
            lanes.append(f"ring past {destination.name}")
    return routes
