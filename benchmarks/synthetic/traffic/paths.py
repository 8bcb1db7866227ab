"""The fixed paths of vehicles: where a rear axle moves from one end of the plan to the other.

A vehicle's position is the distance s of its rear axle along its path. There the heading of a
kinematic bicycle is the direction of motion, so that any motion along a path is feasible.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from benchmarks.synthetic.roads import curves
from benchmarks.synthetic.roads.approaches import locate_inbound_lane, plan_from_road
from benchmarks.synthetic.roads.car_park import CAR_PARK_SPEED, Manoeuvre, make_manoeuvres
from benchmarks.synthetic.roads.lanes import Lane, Route
from benchmarks.synthetic.roads.plan import Roads, find_approach, find_signal

MAX_LATERAL_ACCELERATION = 2.4  # m/s2, in curves
REVERSAL_SPEED = 0.15  # m/s, where a vehicle changes between reverse and forward
# without traffic lights, a path with a higher number yields to one with a lower number
TURN_PRIORITY = {"S": 0, "R": 1, "L": 2}
SIDE_ROAD_PRIORITY, CAR_PARK_PRIORITY = 3, 7
TURN_SHARES = {"S": 0.75, "R": 0.25, "L": 0.15}  # shares of a lane's vehicles
SIDE_ROAD_SHARE = 0.35  # traffic of a side road as a share of the main road's
PARKING_SHARE = 0.03  # share of a lane's vehicles for each bay


@dataclass(frozen=True)
class VehiclePath:
    """The path of a vehicle's rear axle (L points)."""

    name: str  # "east in 0 to south", "into bay 3", ...
    line: curves.Polyline  # equally spaced points, plan metres
    heading: Float[Array, "L"]  # direction of motion, radians, unwrapped
    forward: Bool[Array, "L"]  # whether a vehicle drives forward there
    curvature: Float[Array, "L"]  # 1/m
    speed_limit: Float[Array, "L"]  # speed limit in lanes, curves and reversals, m/s
    priority: Int[Array, "L"]  # vehicles at each point yield to paths with a lower number
    stop: float = np.inf  # s of the stop or give-way line, metres; infinite where there is none
    signal: str = ""  # name of the traffic light that controls it, or ""
    entry: str = ""  # name of the lane where vehicles enter; "": a bay
    share: float = 0.0  # share of the vehicles that enter at its first point
    bay: int = -1  # number of the bay where the path begins or ends; -1: none


@dataclass(frozen=True)
class _Part:
    """A part of a path with one speed limit and priority."""

    line: curves.Polyline
    speed_limit: float
    priority: int


def make_paths(roads: Roads) -> tuple[VehiclePath, ...]:
    """Make all paths of a place: its routes, and those into and out of the car park."""
    lanes = {lane.name: lane for lane in roads.lanes}
    paths = [_make_route_path(roads, route, lanes) for route in roads.routes]
    if roads.car_park is not None:
        approach = find_approach(roads.layout, roads.car_park.approach)
        outer_lane = f"{approach.name} out {approach.outbound_lanes - 1}"
        route = next(r for r in roads.routes if r.turn == "S" and r.lanes[-1] == outer_lane)
        for manoeuvre in make_manoeuvres(roads.car_park, approach):
            make = _make_path_into_bay if manoeuvre.forward.all() else _make_path_out_of_bay
            paths.append(make(roads, route, lanes, manoeuvre))
    return tuple(paths)


def _make_route_path(roads: Roads, route: Route, lanes: dict[str, Lane]) -> VehiclePath:
    origin = find_approach(roads.layout, route.origin)
    priority = TURN_PRIORITY[route.turn]
    if roads.layout.kind in ("t", "campus") and np.isfinite(origin.stop):
        priority += SIDE_ROAD_PRIORITY
    on_main_road = origin.name in ("east", "west")
    share = TURN_SHARES[route.turn] * (1.0 if on_main_road else SIDE_ROAD_SHARE)
    parts = [_Part(lanes[k].centreline, lanes[k].speed_limit, priority) for k in route.lanes]
    path = _make_path(f"{route.lanes[0]} to {route.destination}", parts)
    return _add_entry(roads, path, route, share)


def _make_path_into_bay(
    roads: Roads, route: Route, lanes: dict[str, Lane], manoeuvre: Manoeuvre
) -> VehiclePath:
    """Along a route as far as the car park, and into a bay."""
    parts = [_Part(lanes[name].centreline, lanes[name].speed_limit, 0) for name in route.lanes]
    last = parts[-1].line
    parts[-1] = replace(parts[-1], line=last[: _find_nearest(last, manoeuvre.line[0]) + 1])
    path = _make_path(manoeuvre.name, [*parts, _Part(manoeuvre.line, CAR_PARK_SPEED, 0)])
    path.speed_limit[-1] = REVERSAL_SPEED
    return replace(_add_entry(roads, path, route, PARKING_SHARE), bay=manoeuvre.bay)


def _make_path_out_of_bay(
    roads: Roads, route: Route, lanes: dict[str, Lane], manoeuvre: Manoeuvre
) -> VehiclePath:
    """In reverse out of a bay, and along the last lane of a route."""
    line, lane = manoeuvre.line, lanes[route.lanes[-1]]
    change = int(np.argmax(manoeuvre.forward))
    backwards = _Part(line[:change], CAR_PARK_SPEED / 2, CAR_PARK_PRIORITY)
    reverse = _make_path(manoeuvre.name, [backwards])
    onwards = lane.centreline[_find_nearest(lane.centreline, line[-1]) :]
    forwards = _Part(line[change - 1 :], CAR_PARK_SPEED, CAR_PARK_PRIORITY)
    ahead = _make_path(manoeuvre.name, [forwards, _Part(onwards, lane.speed_limit, 0)])

    def join(before: Array, after: Array) -> Array:
        return np.concatenate([before, after[1:]])  # the reversal is a point of both

    reversal = len(reverse.line) - 1
    speed_limit = join(reverse.speed_limit, ahead.speed_limit)
    speed_limit[reversal - 1 : reversal + 2] = REVERSAL_SPEED
    line = join(reverse.line, ahead.line)
    return VehiclePath(
        name=manoeuvre.name,
        line=line,
        heading=join(reverse.heading, ahead.heading),
        forward=np.arange(len(line)) > reversal,
        curvature=join(reverse.curvature, ahead.curvature),
        speed_limit=speed_limit,
        priority=join(reverse.priority, ahead.priority),
        bay=manoeuvre.bay,
    )


def _make_path(name: str, parts: list[_Part]) -> VehiclePath:
    """Resample and concatenate parts that are driven forward."""
    whole = np.concatenate([parts[0].line, *[part.line[1:] for part in parts[1:]]])
    counts = [len(part.line) - (k > 0) for k, part in enumerate(parts)]
    line = curves.resample_polyline(whole)
    s = curves.compute_arc_lengths(line), curves.compute_arc_lengths(whole)
    nearest = np.rint(np.interp(*s, np.arange(len(whole)))).astype(int)
    speed_limit = np.repeat([part.speed_limit for part in parts], counts)[nearest]
    priority = np.repeat([part.priority for part in parts], counts)[nearest]
    curvature = curves.compute_curvature(line)
    in_curve = np.sqrt(MAX_LATERAL_ACCELERATION / np.maximum(np.abs(curvature), 1e-4))
    return VehiclePath(
        name=name,
        line=line,
        heading=curves.compute_headings(line),
        forward=np.ones(len(line), bool),
        curvature=curvature,
        speed_limit=np.minimum(speed_limit, in_curve),
        priority=priority,
    )


def _add_entry(roads: Roads, path: VehiclePath, route: Route, share: float) -> VehiclePath:
    """The path with the stop line and signal of the lane where its vehicles enter."""
    lane = route.lanes[0]
    name, index = lane.split(" in ")
    approach = find_approach(roads.layout, name)
    stop = np.inf
    if np.isfinite(approach.stop):
        t = locate_inbound_lane(approach, int(index))
        point = plan_from_road(approach, np.array([[approach.stop, t]]))[0]
        stop = curves.POINT_SPACING_M * _find_nearest(path.line, point)
    signal = find_signal(roads, lane, route.turn)
    return replace(path, stop=stop, signal=signal, entry=lane, share=share)


def _find_nearest(line: curves.Polyline, point: Float[Array, "2"]) -> int:
    return int(np.argmin(((line - point) ** 2).sum(axis=1)))
