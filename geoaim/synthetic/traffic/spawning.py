"""Spawning: vehicles and pedestrians enter, park, leave bays, and leave the plan."""

from dataclasses import fields, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from geoaim.synthetic.roads.curves import POINT_SPACING_M
from geoaim.synthetic.traffic.demand import PedestrianTrip, VehicleTrip
from geoaim.synthetic.traffic.pedestrians import Pedestrians
from geoaim.synthetic.traffic.vehicles import FRONT_SHARE, REAR_SHARE, PathTables, Vehicles

MIN_PARKING_S, MEAN_PARKING_S = 5.0, 100.0  # in a bay: at least, and on average beyond that
ENTRY_GAP_M, ENTRY_HEADWAY_S = 5.0, 0.5  # from an entering vehicle to the one ahead
PARKED_TOLERANCE_M = 0.05  # from the end of its path, where a vehicle counts as parked
BAY_CLEARANCE_M = 30.0  # along a path out of a bay, after which the bay is free
ARRIVAL_M = 0.6  # from the end of their path, where pedestrians leave
ENTRY_SPEED_FACTOR = 0.8  # of a pedestrian's desired speed
BODY_RADIUS_M = {"pedestrian": 0.25, "cyclist": 0.4}
State = TypeVar("State", Vehicles, Pedestrians)


def enter_vehicle(
    vehicles: Vehicles, tables: PathTables, trip: VehicleTrip, number: int
) -> Vehicles:
    """Let a vehicle enter at the start of its path; if its bay is taken, it drives on.

    Args:
        vehicles: those that are present.
        tables: over the paths.
        trip: of the vehicle that enters.
        number: index of the trip.

    Returns:
        All vehicles; the same object if there is no room to enter.
    """
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
            return vehicles
        speed = min(speed, leader_speed + 0.15 * room)
    return concat(vehicles, make_vehicle(replace(trip, path=path), number, speed=speed))


def make_vehicle(
    trip: VehicleTrip,
    number: int,
    *,
    s: float = 0.0,
    speed: float = 0.0,
    parked_until: float = np.inf,
) -> Vehicles:
    """Make the state of one vehicle.

    Args:
        trip: of the vehicle.
        number: index of the trip.
        s: metres of its rear axle along the path.
        speed: m/s.
        parked_until: when it leaves its bay, seconds.

    Returns:
        The state.
    """
    values = (s, speed, 0.0, trip.size[0], trip.speed_factor, trip.headway, parked_until)
    arrays = (np.array([value]) for value in values)
    return Vehicles(np.array([number]), np.array([trip.path]), *arrays)


def park_vehicles(
    vehicles: Vehicles, tables: PathTables, time: float, generator: np.random.Generator
) -> Vehicles:
    """Park the vehicles at the end of a path into a bay.

    Args:
        vehicles: all.
        tables: over the paths.
        time: seconds.
        generator: of the parking durations.

    Returns:
        All vehicles.
    """
    end = tables.length[vehicles.path]
    arrived = tables.into_bay[vehicles.path] & (vehicles.s > end - PARKED_TOLERANCE_M)
    arrived &= np.isinf(vehicles.parked_until)
    if not arrived.any():
        return vehicles
    parked_until = vehicles.parked_until.copy()
    durations = generator.exponential(MEAN_PARKING_S, int(arrived.sum()))
    parked_until[arrived] = time + MIN_PARKING_S + durations
    speed = np.where(arrived, 0.0, vehicles.speed)
    return replace(
        vehicles,
        parked_until=parked_until,
        s=np.where(arrived, end, vehicles.s),
        speed=speed,
        acceleration=np.minimum(vehicles.acceleration, speed),
    )


def leave_bay(
    vehicles: Vehicles, tables: PathTables, time: float, generator: np.random.Generator
) -> Vehicles:
    """Put a vehicle whose parking has ended on a path out of its bay, one after the other.

    Args:
        vehicles: all.
        tables: over the paths.
        time: seconds.
        generator: chooses the path.

    Returns:
        All vehicles; the same object if none leaves.
    """
    ready = np.flatnonzero(vehicles.parked_until <= time)
    out_of_bay = (tables.bay[vehicles.path] >= 0) & ~tables.into_bay[vehicles.path]
    if len(ready) == 0 or (out_of_bay & (vehicles.s < BAY_CLEARANCE_M)).any():
        return vehicles
    path, s, parked_until = vehicles.path.copy(), vehicles.s.copy(), vehicles.parked_until.copy()
    first = ready[0]
    choices = np.flatnonzero((tables.bay == tables.bay[path[first]]) & ~tables.into_bay)
    path[first], s[first], parked_until[first] = generator.choice(choices), 0.0, np.inf
    return replace(vehicles, path=path, s=s, parked_until=parked_until)


def remove_finished_vehicles(vehicles: Vehicles, tables: PathTables) -> Vehicles:
    """Remove the vehicles at the end of their path, except in bays."""
    at_end = vehicles.s >= tables.length[vehicles.path] - POINT_SPACING_M
    finished = at_end & ~tables.into_bay[vehicles.path]
    return select(vehicles, ~finished) if finished.any() else vehicles


def enter_pedestrian(
    pedestrians: Pedestrians, trip: PedestrianTrip, number: int, s: float = 0.0
) -> Pedestrians:
    """Let a pedestrian enter.

    Args:
        pedestrians: those that are present.
        trip: of the pedestrian who enters.
        number: index of the trip.
        s: metres of the path walked so far.

    Returns:
        All pedestrians.
    """
    last = len(trip.path) - 1
    index = min(int(s / POINT_SPACING_M), last - 1)
    direction = trip.path[index + 1] - trip.path[index]
    direction = direction / np.sqrt((direction**2).sum())
    offset = trip.lateral_offset * np.array([-direction[1], direction[0]])
    length = max(pedestrians.path.shape[1], last + 1)
    entering = Pedestrians(
        trip=np.array([number]),
        position=(trip.path[index] + offset)[None],
        velocity=ENTRY_SPEED_FACTOR * trip.desired_speed * direction[None],
        path=_pad(trip.path[None], length),
        crossing=_pad(trip.crossing[None], length),
        last=np.array([last]),
        s=np.array([POINT_SPACING_M * index]),
        lateral_offset=np.array([trip.lateral_offset]),
        desired_speed=np.array([trip.desired_speed]),
        radius=np.array([BODY_RADIUS_M[trip.kind]]),
    )
    path, crossing = _pad(pedestrians.path, length), _pad(pedestrians.crossing, length)
    return concat(replace(pedestrians, path=path, crossing=crossing), entering)


def remove_finished_pedestrians(pedestrians: Pedestrians) -> Pedestrians:
    """Remove the pedestrians at the end of their path."""
    finished = pedestrians.s >= POINT_SPACING_M * pedestrians.last - ARRIVAL_M
    return select(pedestrians, ~finished) if finished.any() else pedestrians


def make_empty() -> tuple[Vehicles, Pedestrians]:
    """No vehicles and no pedestrians."""
    index, real, pair = np.empty(0, int), np.empty(0), np.empty((0, 2))
    vehicles = Vehicles(index, index, real, real, real, real, real, real, real)
    path, crossing = np.empty((0, 1, 2)), np.empty((0, 1), int)
    pedestrians = Pedestrians(index, pair, pair, path, crossing, index, real, real, real, real)
    return vehicles, pedestrians


def concat(first: State, second: State) -> State:
    """Concatenate the agents of two states."""
    pairs = ((getattr(first, f.name), getattr(second, f.name)) for f in fields(first))
    return type(first)(*(np.concatenate(pair) for pair in pairs))


def select(state: State, mask: Bool[Array, "n"]) -> State:
    """The agents for which a mask is true."""
    return type(state)(*(getattr(state, f.name)[mask] for f in fields(state)))


def _is_taken(vehicles: Vehicles, tables: PathTables, bay: int) -> bool:
    """Whether a vehicle is parked in a bay, drives to it, or has only just left it."""
    has_left = ~tables.into_bay[vehicles.path] & (vehicles.s > BAY_CLEARANCE_M)
    return bool(((tables.bay[vehicles.path] == bay) & ~has_left).any())


def _pad(rows: Array, length: int) -> Array:
    """Repeat the last point of paths up to a length."""
    missing = max(length - rows.shape[1], 0)
    return np.concatenate([rows, np.repeat(rows[:, -1:], missing, axis=1)], axis=1)
