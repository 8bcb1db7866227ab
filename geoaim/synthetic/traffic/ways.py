"""Ways of vehicles: where a rear axle goes from the edge of the plan to its other edge.

A vehicle's place is the metres of its rear axle along its way. There the direction of a kinematic
bicycle is that of its motion, so that every vehicle on a way is feasible by construction.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.synthetic.roads.approaches import Approach, locate_inbound_lane, plan_from_road
from geoaim.synthetic.roads.car_park import CAR_PARK_SPEED, CarPark, Manoeuvre, make_manoeuvres
from geoaim.synthetic.roads.curves import (
    POINT_SPACING_M,
    Polyline,
    compute_arc_lengths,
    compute_curvature,
    compute_headings,
    resample_polyline,
)
from geoaim.synthetic.roads.lanes import Lane, Route
from geoaim.synthetic.roads.plan import Roads, find_approach, find_signal

SIDEWAYS = 2.4  # m/s2, in curves
CUSP = 0.15  # m/s where a vehicle changes between reverse and forward
# who gives way to whom where no light does: the higher number to the lower
RANKS = {"S": 0, "R": 1, "L": 2}
SHARES = {"S": 0.75, "R": 0.25, "L": 0.15}  # of a lane's vehicles, where it serves several turns
SIDE_SHARE = 0.35  # of the main road's
PARKING = 0.03  # of a lane's vehicles, for each bay that can be reached from it
FROM_SIDE, OUT_OF_PARK = 3, 7


@dataclass(frozen=True)
class Way:
    """A way of vehicles.

    Attributes:
        name: "east 0 to south 0", "into bay 3", ...
        line: a point each `POINT_SPACING_M`, plan metres.
        heading: direction of the motion at each point, radians, unwrapped.
        forward: whether a vehicle drives forward there.
        bend: curvature, 1/m.
        limit: speed that lanes, curves and changes of direction allow, m/s.
        stop: metres to the stop or give-way line; infinite where there is none.
        signal: the light that holds it there, or "".
        rank: at each point, gives way to ways of lower rank there.
        entry: where vehicles appear: the name of a lane, or "" in a bay.
        bay: the bay of the car park that it leads into or out of; -1: none.
        share: of the vehicles of its entry.
    """

    name: str
    line: Polyline
    heading: Float[Array, "L"]
    forward: Bool[Array, "L"]
    bend: Float[Array, "L"]
    limit: Float[Array, "L"]
    stop: float
    signal: str
    rank: Int[Array, "L"]
    entry: str
    share: float
    bay: int = -1


def make_ways(roads: Roads) -> tuple[Way, ...]:
    """All ways of a place: through it, and into and out of the car park."""
    lanes = {lane.name: lane for lane in roads.lanes}
    ways = [_passing(roads, route, lanes) for route in roads.routes]
    if roads.car_park is not None:
        approach = find_approach(roads.layout, roads.car_park.approach)
        lines = make_manoeuvres(roads.car_park, approach)
        ways += [_parking(roads, roads.car_park, manoeuvre) for manoeuvre in lines]
    return tuple(ways)


def _passing(roads: Roads, route: Route, lanes: dict[str, Lane]) -> Way:
    """The way of a route."""
    come = find_approach(roads.layout, route.origin)
    rank = RANKS[route.turn]
    if roads.layout.kind in ("t", "campus") and np.isfinite(come.stop):
        rank += FROM_SIDE
    share = SHARES[route.turn] * (1.0 if come.name in ("east", "west") else SIDE_SHARE)
    return _way(
        " to ".join((route.lanes[0], route.destination)),
        [_Part(lanes[name].centreline, lanes[name].speed_limit, rank) for name in route.lanes],
        stop=_stop_line(roads, route.lanes[0]),
        signal=find_signal(roads, route.lanes[0], route.turn),
        entry=route.lanes[0],
        share=share,
    )


def _parking(roads: Roads, car_park: CarPark, manoeuvre: Manoeuvre) -> Way:
    """The way of a manoeuvre, with the lanes before or after it."""
    line, lanes = manoeuvre.line, {lane.name: lane for lane in roads.lanes}
    approach = find_approach(roads.layout, car_park.approach)
    road = f"{approach.name} out {approach.outbound_lanes - 1}"
    chain = next(p.lanes for p in roads.routes if p.turn == "S" and p.lanes[-1] == road)
    before = [_Part(lanes[name].centreline, lanes[name].speed_limit, 0) for name in chain]
    last, name = before[-1].line, manoeuvre.name
    if manoeuvre.forward.all():
        parts = [*before[:-1], replace(before[-1], line=last[: _nearest(last, line[0]) + 1])]
        parts.append(_Part(line, CAR_PARK_SPEED, 0))
        stop, signal = _stop_line(roads, chain[0]), find_signal(roads, chain[0], "S")
        way = _way(name, parts, stop=stop, signal=signal, entry=chain[0], share=PARKING)
        way.limit[-1] = CUSP
        return replace(way, bay=manoeuvre.bay)
    back = int(np.argmax(manoeuvre.forward))
    parts = [_Part(line[:back], CAR_PARK_SPEED / 2, OUT_OF_PARK, forward=False)]
    parts.append(_Part(line[back - 1 :], CAR_PARK_SPEED, OUT_OF_PARK))
    parts.append(replace(before[-1], line=last[_nearest(last, line[-1]) :]))
    way = _way(name, parts, stop=None, signal="", entry="", share=0.0)
    return replace(way, bay=manoeuvre.bay)


@dataclass(frozen=True)
class _Part:
    """A stretch of a way that is driven alike."""

    line: Polyline
    speed: float
    rank: int
    forward: bool = True


def _way(
    name: str,
    parts: list[_Part],
    *,
    stop: tuple[Approach, float] | None,
    signal: str,
    entry: str,
    share: float,
) -> Way:
    """A way from its parts, those in reverse first."""
    ahead = _section([part for part in parts if part.forward])
    reverse = [part for part in parts if not part.forward]
    line, heading, bend, speed, rank = ahead
    cusp = 0
    if reverse:  # a section starts where the one before it ends
        back = _section(reverse)
        cusp = len(back[0]) - 1
        pairs = zip(back, ahead, strict=True)
        line, heading, bend, speed, rank = (np.concatenate([b, a[1:]]) for b, a in pairs)
    forward = np.ones(len(line), bool)
    limit = np.minimum(speed, np.sqrt(SIDEWAYS / np.maximum(np.abs(bend), 1e-4)))
    if reverse:
        forward[: cusp + 1] = False
        limit[cusp - 1 : cusp + 2] = CUSP
    at = np.inf if stop is None or not np.isfinite(stop[0].stop) else _stop(line, *stop)
    return Way(name, line, heading, forward, bend, limit, at, signal, rank, entry, share)


def _section(parts: list[_Part]) -> tuple[Polyline, Array, Array, Array, Array]:
    """Points at equal steps, direction, curvature, speed limit and rank."""
    whole = np.concatenate([parts[0].line, *[part.line[1:] for part in parts[1:]]])
    counts = [len(part.line) - (k > 0) for k, part in enumerate(parts)]
    line = resample_polyline(whole)
    near = np.rint(
        np.interp(compute_arc_lengths(line), compute_arc_lengths(whole), np.arange(len(whole)))
    ).astype(int)
    speed, rank = (
        np.repeat([getattr(part, name) for part in parts], counts) for name in ("speed", "rank")
    )
    return line, compute_headings(line), compute_curvature(line), speed[near], rank[near]


def _stop_line(roads: Roads, lane: str) -> tuple[Approach, float]:
    """The approach that a lane comes in on, and where across it the lane lies."""
    name, rank = lane.split(" in ")
    approach = find_approach(roads.layout, name)
    return approach, locate_inbound_lane(approach, int(rank))


def _stop(line: Polyline, approach: Approach, across: float) -> float:
    """Metres along a way to an approach's stop line."""
    return POINT_SPACING_M * _nearest(
        line, plan_from_road(approach, np.array([[approach.stop, across]]))[0]
    )


def _nearest(line: Polyline, point: Array) -> int:
    return int(np.argmin(((line - point) ** 2).sum(axis=1)))
