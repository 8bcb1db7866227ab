"""The state of all vehicles, and the tables over their paths that a time step looks up."""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray as Array

from benchmarks.synthetic.roads.curves import POINT_SPACING_M
from benchmarks.synthetic.traffic.conflicts import ConflictZones, PathConflicts
from benchmarks.synthetic.traffic.paths import VehiclePath
from benchmarks.synthetic.traffic.signals import Signals

FRONT_SHARE, REAR_SHARE = 0.8, 0.2  # shares of the length before and behind the rear axle
COMFORTABLE_BRAKING = 2.2  # m/s2
ANTICIPATED_BRAKING = 0.8 * COMFORTABLE_BRAKING  # m/s2, before lower speed limits


@dataclass(frozen=True)
class Vehicles:
    """The vehicles at one time (n of them)."""

    trip: Int[Array, "n"]  # index of the vehicle's trip
    path: Int[Array, "n"]  # index of its path
    s: Float[Array, "n"]  # metres of its rear axle along the path
    speed: Float[Array, "n"]  # m/s along the path
    acceleration: Float[Array, "n"]  # m/s2
    length: Float[Array, "n"]  # metres
    speed_factor: Float[Array, "n"]  # its desired speed as a share of the speed limit
    headway: Float[Array, "n"]  # desired time gap behind others, seconds
    # time at which it leaves its bay, seconds; infinite while it drives
    parked_until: Float[Array, "n"]


@dataclass(frozen=True)
class PlacedVehicles:
    """Vehicles, with where their fronts and rears are along their paths."""

    state: Vehicles  # the n vehicles
    front: Float[Array, "n"]  # s of their foremost points along their paths, metres
    rear: Float[Array, "n"]  # s of their rearmost points


@dataclass(frozen=True)
class PathTables:
    """Properties of all R paths, padded to K points; s is the position along a path, metres."""

    conflicts: PathConflicts  # what paths share
    # m/s, lowered ahead of lower limits, so that comfortable braking reaches them
    speed_limit: Float[Array, "R K"]
    forward: Bool[Array, "R K"]  # whether vehicles drive forward there
    length: Float[Array, "R"]  # length of each path, metres
    stop: Float[Array, "R"]  # s of the stop line; infinite where there is none
    signal: Int[Array, "R"]  # index of the traffic light that controls the path; -1: none
    entry: Int[Array, "R"]  # index of the lane where its vehicles enter; -1: a bay
    bay: Int[Array, "R"]  # number of the bay where the path begins or ends; -1: none
    into_bay: Bool[Array, "R"]  # whether it ends in a bay
    # `conflicts.projection` as one row, followed by a row of infinities
    projection: Float32[Array, "_"]


@dataclass(frozen=True)
class VehicleContext:
    """What n vehicles meet on their paths: leaders, conflicts, a light, a stop line, C crossings.

    It is recomputed only when a vehicle changes its path. P pairs of vehicles conflict.
    """

    # [i, j]: offset in `PathTables.projection` of the row that projects j's path onto i's
    projection_row: Int[Array, "n n"]
    vehicle: Int[Array, "P"]  # index of a vehicle whose path conflicts with another's
    other: Int[Array, "P"]  # index of the vehicle that it conflicts with
    zones: ConflictZones  # (P,) zones in which their paths conflict
    other_wait: Float[Array, "P"]  # position along the other's path (m) where it would wait
    # index of the traffic light that controls each vehicle's path; -1: none
    signal: Int[Array, "n"]
    stop: Float[Array, "n"]  # position of the stop line along the path, m; infinite: none
    crossing_span: Float[Array, "n C 2"]  # ends of crossings along the path, m


def make_path_tables(
    paths: tuple[VehiclePath, ...], conflicts: PathConflicts, signals: Signals
) -> PathTables:
    """Arrange the properties of paths in tables.

    Args:
        paths: paths of vehicles.
        conflicts: conflicts between them.
        signals: the signals that control them.

    Returns:
        The tables.
    """
    longest = max(len(path.line) for path in paths)
    entries = sorted({path.entry for path in paths} - {""})
    speed_limit = np.full((len(paths), longest), 0.1)
    forward = np.ones((len(paths), longest), bool)
    for r, path in enumerate(paths):
        speed_limit[r, : len(path.line)] = _anticipate_limits(path.speed_limit)
        forward[r, : len(path.line)] = path.forward
    indices = {name: k for k, name in enumerate(signals.names)}
    end = np.full(longest, np.inf, np.float32)
    return PathTables(
        conflicts=conflicts,
        speed_limit=speed_limit,
        forward=forward,
        length=np.array([POINT_SPACING_M * (len(path.line) - 1) for path in paths]),
        stop=np.array([path.stop for path in paths]),
        signal=np.array([indices[path.signal] if path.signal else -1 for path in paths]),
        entry=np.array([entries.index(path.entry) if path.entry else -1 for path in paths]),
        bay=np.array([path.bay for path in paths]),
        into_bay=np.array([path.bay >= 0 and path.entry != "" for path in paths]),
        projection=np.append(conflicts.projection.ravel(), end),
    )


def place_vehicles(state: Vehicles, tables: PathTables) -> PlacedVehicles:
    """Compute where the fronts and rears of vehicles are along their paths."""
    forward = tables.forward[state.path, index_points(state.s, tables)]
    front = state.s + np.where(forward, FRONT_SHARE, REAR_SHARE) * state.length
    return PlacedVehicles(state, front, front - state.length)


def make_vehicle_context(vehicles: Vehicles, tables: PathTables) -> VehicleContext:
    """Look up what vehicles meet on their paths, and find the pairs whose paths conflict."""
    count, _, length = tables.conflicts.projection.shape
    own, others = vehicles.path[:, None], vehicles.path[None, :]
    rows = (own * count + others) * length
    np.fill_diagonal(rows, count * count * length)  # no vehicle follows itself
    index = tables.conflicts.zone_index[own, others]  # (n, n, 2)
    vehicle, other, slot = np.nonzero(index >= 0)
    zone = index[vehicle, other, slot]
    reverse = tables.conflicts.zone_index[vehicles.path[other], vehicles.path[vehicle], slot]
    zones = tables.conflicts.zones
    return VehicleContext(
        projection_row=rows,
        vehicle=vehicle,
        other=other,
        zones=ConflictZones(*(getattr(zones, field.name)[zone] for field in fields(zones))),
        other_wait=zones.wait[reverse],
        signal=tables.signal[vehicles.path],
        stop=tables.stop[vehicles.path],
        crossing_span=tables.conflicts.crossing_span[vehicles.path],
    )


def index_points(s: Float[Array, "n"], tables: PathTables) -> Int[Array, "n"]:
    """Compute the index of the path's point before s (metres), at most the last one's."""
    return np.minimum((s / POINT_SPACING_M).astype(np.int64), tables.speed_limit.shape[1] - 1)


def _anticipate_limits(speed_limit: Float[Array, "L"]) -> Float[Array, "L"]:
    """Lower speed limits where a vehicle must brake for later ones."""
    square = speed_limit**2
    for k in range(len(square) - 2, -1, -1):
        before = square[k + 1] + 2 * ANTICIPATED_BRAKING * POINT_SPACING_M
        square[k] = min(square[k], before)
    return np.sqrt(square)
