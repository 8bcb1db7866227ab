"""Where paths conflict: leaders on merging paths, conflict zones, right of way, crossings.

Everything that depends on the plan alone is computed here once, as tables that a step of the
simulation only looks up.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray as Array

from benchmarks.synthetic.roads.curves import POINT_SPACING_M
from benchmarks.synthetic.roads.paving import Crossing, outline_crossing
from benchmarks.synthetic.roads.plan import Roads
from benchmarks.synthetic.traffic.paths import VehiclePath

STRIDE = 2  # every second point of a path is compared with other paths
STRIDE_M = STRIDE * POINT_SPACING_M
CONTACT_M = 2.8  # vehicles on paths that are nearer to each other would touch
LANE_HALF_WIDTH_M = 2.3  # vehicles within this distance from a path are in its lane
MIN_PARALLEL_COSINE = 0.5  # cosine of the angle between paths with the same direction
MERGED_M = 0.7  # paths that are nearer to each other have merged
MERGE_LENGTH_M = 8.0  # length after which a vehicle that has merged simply drives ahead
GROUP_GAP_M = 7.0  # conflict zones closer to each other are passed without stopping between them
WAIT_MARGIN_M = 1.0  # distance from the waiting position to the conflict zone
# vehicles wait at a give-way line for zones within this distance behind it
MAX_STOP_LINE_GAP_M = 14.0
MIN_ZONE_GAP_M = 16.0  # zones of the same two paths that are nearer to each other are merged
PARKED_REACH_M = 1.6  # how far a parked vehicle reaches along its path out of the bay
PARKED_MARGIN_M = 0.4
MAX_ZONES = 2  # zones of a pair of paths
# every `STRIDE`-th point of a path, and its unit direction there
Samples = tuple[Float[Array, "J 2"], Float[Array, "J 2"]]


@dataclass(frozen=True)
class ConflictZones:
    """Ground that two paths share, each seen from both paths (Z entries).

    Distances are metres along a path.
    """

    wait: Float[Array, "Z"]  # where vehicles of the path wait for those of the other path
    start: Float[Array, "Z"]  # where the zone begins on the path
    end: Float[Array, "Z"]  # where the zone ends on the path
    other_start: Float[Array, "Z"]  # where the zone begins on the other path
    other_end: Float[Array, "Z"]  # where the zone ends on the other path
    yields: Bool[Array, "Z"]  # whether vehicles of the path yield to those of the other
    same_direction: Bool[Array, "Z"]  # whether both paths have the same direction there


@dataclass(frozen=True)
class PathConflicts:
    """Where R paths meet each other and C crossings; s is the position along a path, metres."""

    # [a, b, k]: s on path a of a vehicle at the k-th metre of path b, if it drives in a's lane
    # and direction; infinite otherwise
    projection: Float32[Array, "R R K"]
    zone_index: Int[Array, "R R 2"]  # conflict zones of two paths; -1: none
    zones: ConflictZones  # all conflict zones
    crossing_span: Float[Array, "R C 2"]  # s where a crossing begins and ends; NaN: not crossed
    crossing_offset: Float[Array, "R C"]  # metres from the crossing's first end to the path
    # 1 where the path leads to the left of pedestrians who walk from the first end, -1 where
    # to their right
    crossing_side: Float[Array, "R C"]


@dataclass(frozen=True)
class _Overlap:
    """Ground that paths a and b share: spans along both, metres."""

    a: int
    b: int
    span_a: tuple[float, float]
    span_b: tuple[float, float]
    same_direction: bool


def find_conflicts(roads: Roads, paths: tuple[VehiclePath, ...]) -> PathConflicts:
    """Compare all paths of vehicles with each other and with the crossings."""
    samples = [_sample_path(path) for path in paths]
    longest = max(len(points) for points, _ in samples)
    projection = np.full((len(paths), len(paths), longest), np.inf, np.float32)
    overlaps = []
    for a, b in combinations(range(len(paths)), 2):
        (points_a, directions_a), (points_b, directions_b) = samples[a], samples[b]
        (ax, ay), (bx, by) = points_a.T, points_b.T
        distance = np.sqrt((ax[:, None] - bx) ** 2 + (ay[:, None] - by) ** 2)
        cosine = directions_a @ directions_b.T
        projection[a, b, : len(bx)] = _project(samples[a], points_b, distance, cosine)
        projection[b, a, : len(ax)] = _project(samples[b], points_a, distance.T, cosine.T)
        spans = _find_overlaps(distance, cosine)
        overlaps += _merge_overlaps([_Overlap(a, b, *span) for span in spans])
    for a, (points, _) in enumerate(samples):
        projection[a, a, : len(points)] = STRIDE_M * np.arange(len(points))
    is_roundabout = roads.layout.ring_radius > 0
    zone_index, zones = _make_zones(paths, overlaps, roundabout=is_roundabout)
    crossings = _intersect_crossings(paths, roads.crossings)
    return PathConflicts(projection, zone_index, zones, *crossings)


def _sample_path(path: VehiclePath) -> Samples:
    heading = path.heading[::STRIDE]
    return path.line[::STRIDE], np.stack([np.cos(heading), np.sin(heading)], axis=1)


def _project(
    path: Samples,
    others: Float[Array, "K 2"],
    distance: Float[Array, "J K"],
    cosine: Float[Array, "J K"],
) -> Float[Array, "K"]:
    """The s on a path of each point of another, where that is in its lane and direction."""
    points, directions = path
    nearest, columns = np.argmin(distance, axis=0), np.arange(distance.shape[1])
    offset = ((others - points[nearest]) * directions[nearest]).sum(axis=1)
    in_lane = distance[nearest, columns] < LANE_HALF_WIDTH_M
    in_lane &= cosine[nearest, columns] > MIN_PARALLEL_COSINE
    return np.where(in_lane, STRIDE_M * nearest + offset, np.inf)


def _find_overlaps(
    distance: Float[Array, "J K"], cosine: Float[Array, "J K"]
) -> list[tuple[tuple[float, float], tuple[float, float], bool]]:
    """Spans of two paths that overlap, except where both start together; whether in parallel."""
    close = distance < CONTACT_M
    edges = np.flatnonzero(np.diff(np.concatenate([[0], close.any(axis=1), [0]])))
    overlaps = []
    for first, last in zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True):
        columns = np.flatnonzero(close[first : last + 1].any(axis=0))
        if first == 0 and columns[0] == 0:
            continue
        nearest = np.argmin(distance[last])
        same_direction = bool(cosine[last, nearest] > MIN_PARALLEL_COSINE)
        a, b = (first, last), (int(columns[0]), int(columns[-1]))
        if same_direction:  # once they drive in one lane, vehicles no longer wait for each other
            merged = np.flatnonzero((distance[first:last] < MERGED_M).any(axis=1))
            end = first + (int(merged[0]) if len(merged) else 0) + round(MERGE_LENGTH_M)
            a = (first, min(last, end))
            b = (b[0], min(b[1], int(np.argmin(distance[a[1]]))))
        span_a, span_b = ((STRIDE_M * start, STRIDE_M * end) for start, end in (a, b))
        overlaps.append((span_a, span_b, same_direction))
    return overlaps


def _merge_overlaps(overlaps: list[_Overlap]) -> list[_Overlap]:
    """Merge overlaps of two paths between which a vehicle has no room to wait."""
    merged: list[_Overlap] = []
    for overlap in overlaps:
        if merged and overlap.span_a[0] - merged[-1].span_a[1] < MIN_ZONE_GAP_M:
            before = merged.pop()
            span_a = before.span_a[0], overlap.span_a[1]
            ends = (*before.span_b, *overlap.span_b)
            same_direction = before.same_direction and overlap.same_direction
            span_b = min(ends), max(ends)
            merged.append(_Overlap(overlap.a, overlap.b, span_a, span_b, same_direction))
        else:
            merged.append(overlap)
    return merged


def _make_zones(
    paths: tuple[VehiclePath, ...], overlaps: list[_Overlap], *, roundabout: bool
) -> tuple[Int[Array, "R R 2"], ConflictZones]:
    """The conflict zone of each overlap, seen from both paths."""
    index = np.full((len(paths), len(paths), MAX_ZONES), -1)
    rows: list[tuple[float, ...]] = []
    for overlap in overlaps:
        first = _choose_first(paths, overlap, roundabout=roundabout)
        a, b = overlap.a, overlap.b
        spans = {a: overlap.span_a, b: overlap.span_b}
        for path, other in ((a, b), (b, a)):
            free = np.flatnonzero(index[path, other] < 0)
            if len(free) == 0:
                names = f"{paths[path].name} and {paths[other].name}"
                raise AssertionError(f"{names} have more than {MAX_ZONES} conflict zones")
            index[path, other, free[0]] = len(rows)
            span = _leave_out_parked(paths[path], spans[path])
            other_span = _leave_out_parked(paths[other], spans[other])
            rows.append((path, *span, *other_span, path != first, overlap.same_direction))
    table = np.array(rows, float).reshape(-1, 7)
    yields, same_direction = table[:, 5] > 0, table[:, 6] > 0
    start, end, other_start, other_end = table[:, 1:5].T
    wait = _place_waiting_positions(paths, table[:, 0], start, end, yields)
    return index, ConflictZones(wait, start, end, other_start, other_end, yields, same_direction)


def _leave_out_parked(path: VehiclePath, span: tuple[float, float]) -> tuple[float, float]:
    """A zone's span on a path, without the place where a vehicle is parked."""
    return span if path.entry else (max(span[0], PARKED_REACH_M + PARKED_MARGIN_M), span[1])


def _choose_first(paths: tuple[VehiclePath, ...], overlap: _Overlap, *, roundabout: bool) -> int:
    """The path with the right of way: on the ring already, or of the lower priority number."""
    a, b = paths[overlap.a], paths[overlap.b]
    if roundabout:
        since_a, since_b = overlap.span_a[0] - a.stop, overlap.span_b[0] - b.stop
        return overlap.a if since_a > since_b else overlap.b
    priority_a = a.priority[round(overlap.span_a[0] / POINT_SPACING_M)]
    priority_b = b.priority[round(overlap.span_b[0] / POINT_SPACING_M)]
    return overlap.a if priority_a <= priority_b else overlap.b


def _place_waiting_positions(
    paths: tuple[VehiclePath, ...],
    path_of: Float[Array, "Z"],
    start: Float[Array, "Z"],
    end: Float[Array, "Z"],
    yields: Bool[Array, "Z"],
) -> Float[Array, "Z"]:
    """Where vehicles wait: before the first zone of a group that is passed in one go."""
    wait = start - WAIT_MARGIN_M
    for number, path in enumerate(paths):
        own = np.flatnonzero((path_of == number) & yields)
        group_end, position = -np.inf, 0.0
        for k in own[np.argsort(start[own], kind="stable")]:
            if start[k] > group_end + GROUP_GAP_M:
                position = start[k] - WAIT_MARGIN_M
                if not path.signal and 0 <= position - path.stop < MAX_STOP_LINE_GAP_M:
                    position = path.stop
            wait[k] = max(position, 0.0 if path.entry else PARKED_REACH_M)
            group_end = max(group_end, end[k])
    return wait


def _intersect_crossings(
    paths: tuple[VehiclePath, ...], crossings: tuple[Crossing, ...]
) -> tuple[Float[Array, "R C 2"], Float[Array, "R C"], Float[Array, "R C"]]:
    """Where each path crosses each crossing: span along the path, offset, and side."""
    span = np.full((len(paths), len(crossings), 2), np.nan)
    offset, side = np.full_like(span[..., 0], np.nan), np.ones_like(span[..., 0])
    for c, crossing in enumerate(crossings):
        area = outline_crossing(crossing)
        first, last = crossing.ends
        direction = (last - first) / np.hypot(*(last - first))
        for r, path in enumerate(paths):
            inside = np.flatnonzero(shapely.contains_xy(area, *path.line.T))
            if len(inside):
                span[r, c] = POINT_SPACING_M * inside[0], POINT_SPACING_M * inside[-1]
                offset[r, c] = ((path.line[inside].mean(axis=0) - first) * direction).sum()
                x, y = path.line[inside[-1]] - path.line[inside[0]]
                side[r, c] = 1.0 if direction[0] * y - direction[1] * x > 0 else -1.0
    return span, offset, side
