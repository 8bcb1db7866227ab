"""One time step of all vehicles.

Each vehicle follows its leader by the intelligent driver model (Treiber, Hennecke, Helbing 2000,
Phys. Rev. E 62), whose braking term also stops it at red lights, before crossings with pedestrians
and before conflict zones: there it accepts a gap when it can clear the zone in time.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int8
from numpy import ndarray as Array

from benchmarks.synthetic.exact import round_reproducibly
from benchmarks.synthetic.traffic.conflicts import STRIDE_M
from benchmarks.synthetic.traffic.pedestrians import CrossingPedestrians
from benchmarks.synthetic.traffic.vehicles import (
    COMFORTABLE_BRAKING,
    PathTables,
    PlacedVehicles,
    VehicleContext,
    Vehicles,
    index_points,
)
from geoaim.tracks.car_following import DriverParameters, compute_gap_ratio
from geoaim.tracks.lights import RED, YELLOW

MAX_ACCELERATION = 1.8  # m/s2
CLEARING_ACCELERATION = 1.5  # m/s2, expected when a conflict zone must be cleared
CLEARING_SPEED = 9.0  # m/s, at most expected then
MAX_YELLOW_BRAKING = 3.2  # m/s2; vehicles that would need more pass at yellow
MAX_BRAKING = 8.0  # m/s2
MAX_JERK, MIN_JERK = 3.0, -7.0  # m/s3
SPEED_RELAXATION_S, MAX_SPEED_CORRECTION = 0.7, 3.5  # m/s2; above the desired speed
PREVIEW_S = 0.6  # ahead, where the desired speed is looked up
# gap to a standing vehicle ahead, and to a line, at standstill
STANDSTILL_GAP_M, STOP_MARGIN_M = 2.0, 0.7
LINE_HEADWAY_S = 0.4  # headway to lines and conflict zones
MIN_TIME_GAP_S = 1.0  # time between two vehicles that pass a conflict zone
PEDESTRIAN_CLEARANCE_M = 1.6  # distance between a vehicle's path and a pedestrian
QUEUE_SPEED = 2.5  # m/s of a leader, below which crossings are kept clear
FREE_DISTANCE_M = 1e6
MIN_DISTANCE_M = 0.05  # distance to an obstacle; the model divides by it


@dataclass(frozen=True)
class _Obstacles:
    """The distance to an obstacle ahead of each vehicle (metres) and its speed (m/s)."""

    distance: Float[Array, "n"]
    speed: Float[Array, "n"]


def step_vehicles(
    placed: PlacedVehicles,
    context: VehicleContext,
    tables: PathTables,
    lights: Int8[Array, "G"],
    pedestrians: CrossingPedestrians,
    dt: float,
) -> Vehicles:
    """Move all vehicles by one time step.

    Args:
        placed: the vehicles.
        context: what these vehicles meet on their paths.
        tables: tables over the paths.
        lights: state of each of the G lights of `Signals`, as in `geoaim.tracks.lights`.
        pedestrians: pedestrians on crossings.
        dt: seconds.

    Returns:
        The vehicles after the step.
    """
    vehicles = placed.state
    if len(vehicles.s) == 0:
        return vehicles
    point = index_points(vehicles.s + PREVIEW_S * vehicles.speed, tables)
    desired = vehicles.speed_factor * tables.speed_limit[vehicles.path, point]
    leaders = _find_leaders(placed, context, tables)
    to_signal, waiting = _stop_at_signals(placed, context, lights)
    stop = np.minimum(to_signal, _stop_for_pedestrians(placed, tables, pedestrians))
    stop = np.minimum(stop, _keep_crossings_clear(placed, context, leaders))
    zones = _stop_at_conflict_zones(placed, context, leaders, waiting, desired)
    share = vehicles.speed / desired
    share *= share
    correction = (desired - vehicles.speed) / SPEED_RELAXATION_S
    correction = np.maximum(correction, -MAX_SPEED_CORRECTION)
    free = np.where(share < 1, MAX_ACCELERATION * (1 - share * share), correction)
    lines = _Obstacles(stop, np.zeros_like(stop))
    braking = _brake_for(vehicles, leaders, STANDSTILL_GAP_M, vehicles.headway)
    for obstacles in (lines, zones):
        term = _brake_for(vehicles, obstacles, STOP_MARGIN_M, LINE_HEADWAY_S)
        braking = np.maximum(braking, term)
    return _move(vehicles, np.minimum(free, np.maximum(free, 0) - braking), dt)


def _move(vehicles: Vehicles, acceleration: Float[Array, "n"], dt: float) -> Vehicles:
    """Limit the jerk, except in emergency braking, and integrate; parked vehicles stay."""
    acceleration = np.maximum(acceleration, -MAX_BRAKING)
    smooth = np.minimum(acceleration, vehicles.acceleration + MAX_JERK * dt)
    smooth = np.maximum(smooth, vehicles.acceleration + MIN_JERK * dt)
    is_emergency = acceleration < -MAX_YELLOW_BRAKING
    acceleration = np.where(is_emergency, np.minimum(acceleration, smooth), smooth)
    parked = np.isfinite(vehicles.parked_until)
    speed = round_reproducibly(np.maximum(vehicles.speed + acceleration * dt, 0))
    speed = np.where(parked, 0.0, speed)
    s = round_reproducibly(vehicles.s + 0.5 * (vehicles.speed + speed) * dt)
    s = np.where(parked, vehicles.s, s)
    acceleration = np.where(speed > 0, acceleration, np.maximum(acceleration, 0))
    return replace(vehicles, s=s, speed=speed, acceleration=round_reproducibly(acceleration))


def _brake_for(
    vehicles: Vehicles,
    obstacles: _Obstacles,
    standstill_gap: float,
    headway: Float[Array, "n"] | float,
) -> Float[Array, "n"]:
    """The braking term of the intelligent driver model, m/s2."""
    driver = DriverParameters(MAX_ACCELERATION, COMFORTABLE_BRAKING, standstill_gap, headway)
    closing_speed = vehicles.speed - obstacles.speed
    ratio = compute_gap_ratio(driver, vehicles.speed, closing_speed, obstacles.distance)
    return np.asarray(MAX_ACCELERATION * ratio * ratio)


def _find_leaders(
    placed: PlacedVehicles, context: VehicleContext, tables: PathTables
) -> _Obstacles:
    """The nearest vehicle ahead in the lane; vehicles that merge count as soon as they touch it."""
    vehicles, front = placed.state, placed.front
    fronts, rears = (_project(s, context, tables) for s in (front, placed.rear))
    by_front = np.where(fronts > front[:, None], fronts - vehicles.length, np.inf)
    by_rear = np.where(rears > placed.rear[:, None], rears, np.inf)
    gaps = np.minimum(by_front, by_rear) - front[:, None]
    leader = np.argmin(gaps, axis=1)
    gap = np.minimum(gaps[np.arange(len(leader)), leader], FREE_DISTANCE_M)
    return _Obstacles(gap, np.where(gap < FREE_DISTANCE_M, vehicles.speed[leader], 0.0))


def _project(
    s: Float[Array, "n"], context: VehicleContext, tables: PathTables
) -> Float[Array, "n n"]:
    """The s of each point (column) on each vehicle's path (row); infinite off its lane."""
    last = tables.conflicts.projection.shape[2] - 1
    index = np.minimum(np.maximum(s / STRIDE_M, 0), last).astype(np.int64)
    return tables.projection.take(context.projection_row + index) + (s - STRIDE_M * index)


def _stop_at_signals(
    placed: PlacedVehicles, context: VehicleContext, lights: Int8[Array, "G"]
) -> tuple[Float[Array, "n"], Bool[Array, "n"]]:
    """Metres to the stop line of a light that stops a vehicle, and whether others may ignore it.

    Lights stop vehicles at red, at yellow, and at green while a vehicle from an earlier green has
    not cleared a conflict zone ahead. Others need not yield to these vehicles, nor to those that
    have not passed their own give-way line.
    """
    vehicles, distance = placed.state, context.stop - placed.front
    state = np.append(lights, np.int8(0))[context.signal]
    late = (state == RED) & (distance < -1.0)
    blocked = np.zeros(len(distance), bool)
    in_zone = late[context.other] & (vehicles.s[context.other] < context.zones.other_end)
    blocked[context.vehicle[in_zone]] = True
    braking = np.where((state == RED) | blocked, MAX_BRAKING, MAX_YELLOW_BRAKING)
    can_stop = distance + 0.5 > vehicles.speed * vehicles.speed / (2 * braking)
    stops = (context.signal >= 0) & (distance > -0.5) & can_stop & ((state >= YELLOW) | blocked)
    at_give_way = (context.signal < 0) & np.isfinite(context.stop) & (distance > -0.3)
    to_line = np.where(stops, np.maximum(distance, MIN_DISTANCE_M), FREE_DISTANCE_M)
    return to_line, stops | at_give_way


def _stop_for_pedestrians(
    placed: PlacedVehicles, tables: PathTables, pedestrians: CrossingPedestrians
) -> Float[Array, "n"]:
    """Metres to a crossing where a vehicle and a pedestrian would meet."""
    if len(pedestrians.crossing) == 0:
        return np.full(len(placed.front), FREE_DISTANCE_M)
    path, speed = placed.state.path[:, None], placed.state.speed[:, None]
    span = tables.conflicts.crossing_span[path, pedestrians.crossing]  # (n, m, 2)
    offset = tables.conflicts.crossing_offset[path, pedestrians.crossing]
    to_path = (offset - pedestrians.offset) * np.sign(pedestrians.speed)
    distance = span[..., 0] - placed.front[:, None]
    arrival, clearing = _estimate_times(speed, distance, span[..., 1] - placed.rear[:, None])
    width, walking_speed = PEDESTRIAN_CLEARANCE_M + pedestrians.radius, np.abs(pedestrians.speed)
    meets = (to_path - width) / walking_speed < clearing + 0.5
    meets &= (to_path + width) / walking_speed > arrival - 0.3
    can_stop = (distance > 0.0) & (speed**2 < 2 * MAX_BRAKING * distance)
    stop = np.maximum(distance - STOP_MARGIN_M, MIN_DISTANCE_M)
    return np.where(meets & can_stop, stop, FREE_DISTANCE_M).min(axis=1)


def _keep_crossings_clear(
    placed: PlacedVehicles, context: VehicleContext, leaders: _Obstacles
) -> Float[Array, "n"]:
    """Metres to a crossing on which a queue ahead would hold a vehicle."""
    front = placed.front
    start, end = context.crossing_span[..., 0], context.crossing_span[..., 1]
    distance = start - front[:, None]
    is_full = (front + leaders.distance - placed.state.length)[:, None] < end + STOP_MARGIN_M
    is_full &= (leaders.speed < QUEUE_SPEED)[:, None] & (distance > 0.0)
    stop = np.maximum(distance - STOP_MARGIN_M, MIN_DISTANCE_M)
    return np.where(is_full, stop, FREE_DISTANCE_M).min(axis=1, initial=FREE_DISTANCE_M)


def _estimate_times(
    speed: Float[Array, "*n"], distance: Float[Array, "*m"], clearance: Float[Array, "*m"]
) -> tuple[Float[Array, "*m"], Float[Array, "*m"]]:
    """The earliest time to cover `distance`, the likely time to cover `clearance`, seconds."""
    likely = np.sqrt(speed * speed + 2 * CLEARING_ACCELERATION * np.maximum(clearance, 0)) - speed
    clearing = np.maximum(likely / CLEARING_ACCELERATION, clearance / CLEARING_SPEED)
    return _estimate_arrival(speed, distance), clearing


def _estimate_arrival(
    speed: Float[Array, "*n"], distance: Float[Array, "*m"]
) -> Float[Array, "*m"]:
    """The time to cover a distance with the maximum acceleration, seconds."""
    final = np.sqrt(speed * speed + 2 * MAX_ACCELERATION * np.maximum(distance, 0))
    return (final - speed) / MAX_ACCELERATION


def _stop_at_conflict_zones(
    placed: PlacedVehicles,
    context: VehicleContext,
    leaders: _Obstacles,
    waiting: Bool[Array, "n"],
    desired_speed: Float[Array, "n"],
) -> _Obstacles:
    """The nearest conflict zone that others occupy or will, as an obstacle; gap acceptance."""
    vehicles, front, rear = placed.state, placed.front, placed.rear
    zones, i, j = context.zones, context.vehicle, context.other
    to_zone, other_to_zone = zones.start - front[i], zones.other_start - front[j]
    other_to_clear = zones.other_end - rear[j]
    arrival, clearing = _estimate_times(vehicles.speed[i], to_zone, zones.end - rear[i])
    other_arrival = _estimate_arrival(vehicles.speed[j], other_to_zone)
    other_arrival = np.maximum(other_arrival, other_to_zone / np.maximum(desired_speed[j], 1.0))
    # the other vehicle has left the zone, occupies it, or approaches it freely
    is_past = (other_to_clear < -0.3) | np.isfinite(vehicles.parked_until)[j]
    occupies = (other_to_zone < 0.3) & ~is_past
    queues = (leaders.speed[j] < 0.5) & (leaders.distance[j] < other_to_zone + 1.0)
    approaches = ~(occupies | is_past | waiting[j] | queues)
    overlaps = approaches & (other_arrival < clearing + MIN_TIME_GAP_S)
    overlaps &= other_to_clear / np.maximum(vehicles.speed[j], 2.0) + 0.5 > arrival
    exit_s = (leaders.distance + front - vehicles.length)[i]
    is_full = (exit_s < zones.end + 1.0) & (leaders.speed[i] < 2.0) & ~is_past
    must_wait = zones.yields & (overlaps | is_full | occupies) & (front[i] <= zones.wait + 0.3)
    has_started = approaches & ~zones.yields & (front[j] > context.other_wait + 0.4)
    is_taken = (occupies | (has_started & (other_arrival < arrival))) & (to_zone > -0.1)
    follows = is_taken & zones.same_direction & occupies & ~must_wait
    distance = np.where(must_wait, zones.wait - front[i], FREE_DISTANCE_M)
    distance = np.where(is_taken, np.minimum(distance, to_zone - 0.3), distance)
    distance = np.where(follows, to_zone + rear[j] - zones.other_start, distance)
    distance = np.maximum(distance, MIN_DISTANCE_M)
    nearest, speed = np.full(len(front), FREE_DISTANCE_M), np.zeros(len(front))
    np.minimum.at(nearest, i, distance)
    is_nearest = follows & (distance <= nearest[i])
    speed[i[is_nearest]] = vehicles.speed[j[is_nearest]]
    return _Obstacles(nearest, speed)
