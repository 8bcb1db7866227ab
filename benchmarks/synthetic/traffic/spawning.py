"""Trips and spawning: vehicles and pedestrians enter, park, leave bays, and leave the plan."""

from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from benchmarks.synthetic.roads.curves import POINT_SPACING_M
from benchmarks.synthetic.traffic.pedestrians import Pedestrians
from benchmarks.synthetic.traffic.vehicles import FRONT_SHARE, REAR_SHARE, PathTables, Vehicles

MIN_PARKING_S, MEAN_PARKING_S = 5.0, 100.0  # time in a bay: the least, and the mean beyond that
ENTRY_GAP_M, ENTRY_HEADWAY_S = 5.0, 0.5  # gap from an entering vehicle to the one ahead
PARKED_TOLERANCE_M = 0.05  # a vehicle this near to the end of its path counts as parked
BAY_CLEARANCE_M = 30.0  # a bay is free once the vehicle that left it is this far along its path
ARRIVAL_M = 0.6  # pedestrians leave within this distance of the end of their path
ENTRY_SPEED_FACTOR = 0.8  # pedestrians enter at this share of their desired speed
BODY_RADIUS_M = {"pedestrian": 0.25, "cyclist": 0.4}
State = TypeVar("State", Vehicles, Pedestrians)


@dataclass(frozen=True)
class VehicleTrip:
    """A vehicle and its driver's parameters."""

    time: float  # time of its departure, seconds
    path: int  # index of its path
    kind: str  # name of the vehicle type
    size: tuple[float, float]  # length and width, metres
    speed_factor: float  # its desired speed as a share of the speed limit
    headway: float  # desired time gap behind others, seconds
    # phases of the waves in which it drifts within its lane, radians
    drift_phases: tuple[float, float]


@dataclass(frozen=True)
class PedestrianTrip:
    """A pedestrian or cyclist and their route."""

    time: float  # time of departure, seconds
    kind: str  # "pedestrian" or "cyclist"
    path: Float[Array, "K 2"]  # equally spaced points, plan metres
    crossing: Int[Array, "K"]  # index of the crossing at each point; -1: none
    lateral_offset: float  # metres to the left of the path where they prefer to walk
    desired_speed: float  # m/s


@dataclass(frozen=True)
class Agents:
    """All vehicles, pedestrians and cyclists at one time."""

    vehicles: Vehicles
    pedestrians: Pedestrians


@dataclass(frozen=True)
class Trips:
    """All trips of a simulation; spawning moves them from the queues to the lists."""

    # trips from each entry that have not begun, in the order of time
    vehicle_queues: list[list[VehicleTrip]]
    pedestrian_queue: list[PedestrianTrip]  # trips that have not begun, in the order of time
    vehicles: list[VehicleTrip]  # trips that have begun
    pedestrians: list[PedestrianTrip]  # trips that have begun


def spawn_agents(
    agents: Agents, trips: Trips, tables: PathTables, time: float, generator: np.random.Generator
) -> Agents:
    """Let vehicles park, leave bays, leave the plan and enter it; pedestrians enter and leave.

    Args:
        agents: the agents that are present.
        trips: the trips of the simulation; they are updated.
        tables: tables over the paths of vehicles.
        time: seconds.
        generator: generator for parking durations and paths out of bays.

    Returns:
        The agents that are present now; `vehicles.path` is the same object if no path changes.
    """
    vehicles, pedestrians = agents.vehicles, agents.pedestrians
    vehicles = _park(vehicles, tables, time, generator)
    vehicles = _leave_bay(vehicles, tables, time, generator)
    finished = vehicles.s >= tables.length[vehicles.path] - POINT_SPACING_M
    vehicles = _remove(vehicles, finished & ~tables.into_bay[vehicles.path])
    for queue in trips.vehicle_queues:
        if queue and queue[0].time <= time:
            entering = _enter(vehicles, tables, queue[0], len(trips.vehicles))
            if entering is not None:
                vehicles = concat(vehicles, entering)
                trips.vehicles.append(queue.pop(0))
    while trips.pedestrian_queue and trips.pedestrian_queue[0].time <= time:
        trip = trips.pedestrian_queue.pop(0)
        pedestrians = concat(pedestrians, make_pedestrian(trip, len(trips.pedestrians)))
        trips.pedestrians.append(trip)
    finished = pedestrians.s >= POINT_SPACING_M * pedestrians.last - ARRIVAL_M
    return Agents(vehicles, _remove(pedestrians, finished))


def make_vehicle(
    trip: VehicleTrip,
    trip_index: int,
    *,
    s: float = 0.0,
    speed: float = 0.0,
    parked_until: float = np.inf,
) -> Vehicles:
    """Make the state of one vehicle: `Vehicles` with one entry.

    Args:
        trip: trip of the vehicle.
        trip_index: index of the trip in `Trips`.
        s: position of its rear axle along the path, metres.
        speed: m/s.
        parked_until: time at which it leaves its parking bay, seconds; infinite if it is not
            parked.

    Returns:
        The state.
    """
    values = (s, speed, 0.0, trip.size[0], trip.speed_factor, trip.headway, parked_until)
    arrays = (np.array([value]) for value in values)
    return Vehicles(np.array([trip_index]), np.array([trip.path]), *arrays)


def make_pedestrian(trip: PedestrianTrip, trip_index: int, s: float = 0.0) -> Pedestrians:
    """Make the state of one pedestrian or cyclist: `Pedestrians` with one entry.

    Args:
        trip: trip of the pedestrian.
        trip_index: index of the trip in `Trips`.
        s: metres of the path walked so far.

    Returns:
        The state.
    """
    last = len(trip.path) - 1
    index = min(int(s / POINT_SPACING_M), last - 1)
    direction = trip.path[index + 1] - trip.path[index]
    direction = direction / np.sqrt((direction**2).sum())
    offset = trip.lateral_offset * np.array([-direction[1], direction[0]])
    return Pedestrians(
        trip=np.array([trip_index]),
        position=(trip.path[index] + offset)[None],
        velocity=ENTRY_SPEED_FACTOR * trip.desired_speed * direction[None],
        path=trip.path[None],
        crossing=trip.crossing[None],
        last=np.array([last]),
        s=np.array([POINT_SPACING_M * index]),
        lateral_offset=np.array([trip.lateral_offset]),
        desired_speed=np.array([trip.desired_speed]),
        radius=np.array([BODY_RADIUS_M[trip.kind]]),
    )


def make_empty() -> Agents:
    """Make `Agents` without vehicles and pedestrians."""
    index, real, pair = np.empty(0, int), np.empty(0), np.empty((0, 2))
    vehicles = Vehicles(index, index, real, real, real, real, real, real, real)
    path, crossing = np.empty((0, 1, 2)), np.empty((0, 1), int)
    pedestrians = Pedestrians(index, pair, pair, path, crossing, index, real, real, real, real)
    return Agents(vehicles, pedestrians)


def concat(first: State, second: State) -> State:
    """Concatenate two states of vehicles, or two of pedestrians."""
    pairs = [(getattr(first, f.name), getattr(second, f.name)) for f in fields(first)]
    return type(first)(*(_concat_rows(*pair) for pair in pairs))


def _concat_rows(first: Array, second: Array) -> Array:
    """Concatenate rows; the last points of shorter paths are repeated."""
    rows = [first, second]
    if first.ndim > 1:
        length = max(first.shape[1], second.shape[1])
        last = [np.repeat(row[:, -1:], length - row.shape[1], axis=1) for row in rows]
        rows = [np.concatenate(pair, axis=1) for pair in zip(rows, last, strict=True)]
    return np.concatenate(rows)


def _remove(state: State, finished: Bool[Array, "n"]) -> State:
    """Remove the agents for which a mask is true; the same object if there are none."""
    if not finished.any():
        return state
    return type(state)(*(getattr(state, f.name)[~finished] for f in fields(state)))


def _park(
    vehicles: Vehicles, tables: PathTables, time: float, generator: np.random.Generator
) -> Vehicles:
    """Park the vehicles at the end of a path into a bay."""
    end = tables.length[vehicles.path]
    arrived = tables.into_bay[vehicles.path] & (vehicles.s > end - PARKED_TOLERANCE_M)
    arrived &= np.isinf(vehicles.parked_until)
    if not arrived.any():
        return vehicles
    parked_until = vehicles.parked_until.copy()
    durations = generator.exponential(MEAN_PARKING_S, int(arrived.sum()))
    parked_until[arrived] = time + MIN_PARKING_S + durations
    speed, s = np.where(arrived, 0.0, vehicles.speed), np.where(arrived, end, vehicles.s)
    acceleration = np.minimum(vehicles.acceleration, speed)
    return replace(vehicles, parked_until=parked_until, s=s, speed=speed, acceleration=acceleration)


def _leave_bay(
    vehicles: Vehicles, tables: PathTables, time: float, generator: np.random.Generator
) -> Vehicles:
    """Put a vehicle whose parking has ended on a path out of its bay, one after the other."""
    ready = np.flatnonzero(vehicles.parked_until <= time)
    out_of_bay = (tables.bay[vehicles.path] >= 0) & ~tables.into_bay[vehicles.path]
    if len(ready) == 0 or (out_of_bay & (vehicles.s < BAY_CLEARANCE_M)).any():
        return vehicles
    path, s, parked_until = vehicles.path.copy(), vehicles.s.copy(), vehicles.parked_until.copy()
    first = ready[0]
    choices = np.flatnonzero((tables.bay == tables.bay[path[first]]) & ~tables.into_bay)
    path[first], s[first], parked_until[first] = generator.choice(choices), 0.0, np.inf
    return replace(vehicles, path=path, s=s, parked_until=parked_until)


def _enter(
    vehicles: Vehicles, tables: PathTables, trip: VehicleTrip, trip_index: int
) -> Vehicles | None:
    """A vehicle at the start of its path, past its bay if that is taken; None without room."""
    path = trip.path
    if tables.bay[path] >= 0 and _is_taken(vehicles, tables, int(tables.bay[path])):
        path = int(np.argmax((tables.entry == tables.entry[path]) & (tables.bay < 0)))
    same = tables.entry[vehicles.path] == tables.entry[path]
    speed = trip.speed_factor * float(tables.speed_limit[path, 0])
    if same.any():
        rears = vehicles.s[same] - REAR_SHARE * vehicles.length[same]
        room = float(rears.min()) - FRONT_SHARE * trip.size[0]
        leader_speed = float(vehicles.speed[same][np.argmin(rears)])
        if room < ENTRY_GAP_M + ENTRY_HEADWAY_S * leader_speed:
            return None
        speed = min(speed, leader_speed + 0.15 * room)
    return make_vehicle(replace(trip, path=path), trip_index, speed=speed)


def _is_taken(vehicles: Vehicles, tables: PathTables, bay: int) -> bool:
    """Whether a vehicle is parked in a bay, drives to it, or has only just left it."""
    has_left = ~tables.into_bay[vehicles.path] & (vehicles.s > BAY_CLEARANCE_M)
    return bool(((tables.bay[vehicles.path] == bay) & ~has_left).any())
