"""Pedestrians accept gaps between vehicles: they wait at the kerb for a green light or a gap."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int8
from numpy import ndarray as Array

from benchmarks.synthetic.traffic.pedestrians import (
    CrossingTable,
    Outlook,
    Pedestrians,
    Reaction,
    dot,
)
from benchmarks.synthetic.traffic.vehicles import PathTables, PlacedVehicles
from geoaim.tracks.lights import GREEN

VEHICLE_HALF_WIDTH_M = 1.8  # half the width of the strip that a vehicle needs, with some clearance
MARKED_MARGIN_S, UNMARKED_MARGIN_S = 0.5, 1.6  # time between a pedestrian and a vehicle
COMFORTABLE_STOP = 2.5  # m/s2 of a vehicle that is expected to stop at a marked crossing
DETOUR_MARGIN_M = 1.0  # distance to the end of a vehicle that a pedestrian walks around
MAX_DETOUR_M = 6.0
STANDING_SPEED = 0.3  # m/s of vehicles that pedestrians walk around


@dataclass(frozen=True)
class _Encounters:
    """The n vehicles as m pedestrians on or near crossings see them; distances in metres."""

    # distance along the crossing to the vehicle's path; negative when passed
    to_path: Float[Array, "n m"]
    to_crossing: Float[Array, "n m"]  # distance from the vehicle's front to the crossing
    on_crossing: Bool[Array, "n m"]  # whether the vehicle is on it
    # position of the vehicle's front on its path, from the crossing's centreline
    front: Float[Array, "n m"]
    rear: Float[Array, "n m"]
    side: Float[Array, "n m"]  # 1 where its path leads to the left of the crossing, else -1
    speed: Float[Array, "n 1"]  # m/s


def react_to_vehicles(
    pedestrians: Pedestrians,
    outlook: Outlook,
    crossings: CrossingTable,
    placed: PlacedVehicles,
    tables: PathTables,
    lights: Int8[Array, "G"],
) -> Reaction:
    """Decide which pedestrians wait, and which walk around a vehicle.

    They wait at the kerb until they can cross, and on a crossing while a vehicle passes.

    Args:
        pedestrians: all pedestrians and cyclists.
        outlook: their targets, and which of them are on or near which crossing.
        crossings: the crossings of the place.
        placed: the vehicles.
        tables: lengths, limits and conflicts of the vehicles' paths.
        lights: state of each of the G lights of `Signals`, as in `geoaim.tracks.lights`.

    Returns:
        The reaction of each pedestrian.
    """
    count = len(pedestrians.trip)
    waits, detour = np.zeros(count, bool), np.zeros(count)
    if len(outlook.near) == 0 or len(placed.front) == 0:
        return Reaction(waits, detour)
    near, crossing = outlook.near, outlook.crossing
    encounters = _list_encounters(outlook, placed, tables)
    speed, on_crossing = pedestrians.desired_speed[near], outlook.on_crossing[near]
    state = np.append(lights, np.int8(GREEN))[crossings.signal[crossing]]
    may_start = (state == GREEN) | crossings.priority[crossing]
    may_start &= _find_gaps(encounters, speed, outlook, crossings)
    direction = crossings.direction[crossing]
    left = np.column_stack([-direction[:, 1], direction[:, 0]])
    lateral = dot(pedestrians.position[near] - crossings.first[crossing], left)
    blocked = _find_blocked(encounters, speed, lateral)
    waits[near] = np.where(on_crossing, blocked, ~may_start)
    detour[near] = np.where(on_crossing, _choose_detours(encounters, outlook), 0.0)
    return Reaction(waits, detour)


def _list_encounters(outlook: Outlook, placed: PlacedVehicles, tables: PathTables) -> _Encounters:
    conflicts, path = tables.conflicts, placed.state.path[:, None]
    span = conflicts.crossing_span[path, outlook.crossing]
    to_crossing = span[..., 0] - placed.front[:, None]
    to_clear = span[..., 1] - placed.rear[:, None]
    middle = 0.5 * (span[..., 0] + span[..., 1])
    offset = conflicts.crossing_offset[path, outlook.crossing] - outlook.offset
    return _Encounters(
        to_path=offset * outlook.sign,
        to_crossing=to_crossing,
        on_crossing=(to_crossing < 0.4) & (to_clear > -0.4),
        front=placed.front[:, None] - middle + DETOUR_MARGIN_M,
        rear=placed.rear[:, None] - middle - DETOUR_MARGIN_M,
        side=conflicts.crossing_side[path, outlook.crossing],
        speed=placed.state.speed[:, None],
    )


def _find_gaps(
    e: _Encounters, speed: Float[Array, "m"], outlook: Outlook, crossings: CrossingTable
) -> Bool[Array, "m"]:
    """Whether pedestrians can step on the road before the next vehicle."""
    marked = crossings.marked[outlook.crossing]
    margin = np.where(marked, MARKED_MARGIN_S, UNMARKED_MARGIN_S)
    needed = (e.to_path + VEHICLE_HALF_WIDTH_M) / speed + margin
    can_stop = e.to_crossing > e.speed * e.speed / (2 * COMFORTABLE_STOP) + 2.0
    can_stop |= (e.speed < STANDING_SPEED) & (e.to_crossing > 0.5)
    comes = (e.to_crossing > 0) & (e.to_crossing < needed * np.maximum(e.speed, 1.0))
    comes &= (e.to_path > 0) & ~(marked & can_stop)
    # at lights, turning vehicles yield
    comes &= (crossings.signal[outlook.crossing] < 0) & ~crossings.priority[outlook.crossing]
    passes = e.on_crossing & (e.to_path > 0)
    passes &= (e.to_path < 3.0 * speed) | (e.speed < 0.5)
    return ~(comes | passes).any(axis=0)


def _find_blocked(
    e: _Encounters, speed: Float[Array, "m"], lateral: Float[Array, "m"]
) -> Bool[Array, "m"]:
    """Whether a vehicle is right before pedestrians, `lateral` metres left of the centreline."""
    beside = (lateral * e.side < e.front - 0.1) & (lateral * e.side > e.rear + 0.1)
    close = (e.to_path > -0.2) & (e.to_path < VEHICLE_HALF_WIDTH_M + 0.7 * speed)
    return (e.on_crossing & beside & close).any(axis=0)


def _choose_detours(e: _Encounters, outlook: Outlook) -> Float[Array, "m"]:
    """Metres to the left by which pedestrians walk around a standing vehicle."""
    stands = e.on_crossing & (e.speed < STANDING_SPEED)
    stands &= (e.to_path > -VEHICLE_HALF_WIDTH_M) & (e.to_path < VEHICLE_HALF_WIDTH_M + 2.0)
    nearer_end = np.where(np.abs(e.front) < np.abs(e.rear), e.front, e.rear)
    detour = nearer_end * e.side * outlook.sign
    detour = np.where(stands & (np.abs(detour) < MAX_DETOUR_M), detour, 0.0)
    return detour[np.argmax(np.abs(detour), axis=0), np.arange(len(outlook.near))]
