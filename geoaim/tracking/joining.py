"""Joining: tracks that were lost for longer, put together when the whole video is known."""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.kalman import TrackMotion, TrackRows, predict
from geoaim.tracks.agent_types import find_group

MAX_GAP_S = 10.0  # between two tracks of one agent that moves
JOIN_NOISE = 6.0  # m²/s³; spectral density of the acceleration of an agent that is lost
MAX_DISTANCE = 25.0  # squared, in standard deviations
STANDING_SPEED = 0.7  # m/s
STANDING_SIGMAS = (0.5, 0.7)  # m and m/s, of what stood before and after, for however long
# minus twice the log of: an end and a start inside the frame; less for each one at the border
UNJOINED_COST, BORDER_GAIN = 34.0, 8.0
SIZE_SIGMA, GROUP_COST, TYPE_COST = 0.2, 10.0, 2.0


def join_tracks(
    motion: TrackMotion,
    rows: TrackRows,
    types: tuple[str, ...],
    detections: GroundDetections,
    times: Float[Array, "T"],
) -> Int[Array, "N"]:
    """Join tracks that end and begin as one agent would, by one optimal assignment.

    The cost of a pair is minus twice its log likelihood: how far the later one begins, in place and
    velocity, from where the earlier one would then be, and how alike their sizes and types are.
    What stands may be lost for however long.

    Args:
        motion: smoothed motion of the tracks.
        rows: of the tracks.
        types: of the tracks.
        detections: of the tracks.
        times: of the frames, s.

    Returns:
        The number of each track's agent, from 0.
    """
    count = len(types)
    if count < 2:
        return np.zeros(count, int)
    first, last = rows.bounds[:-1], rows.bounds[1:] - 1
    begin, end = times[rows.step[first]], times[rows.step[last]]
    early, late = _list_pairs(motion, (first, last), begin, end)
    gap = begin[late] - end[early]
    ends, starts = last[early], first[late]
    mean, covariance = motion.mean[ends], motion.covariance[ends].copy()
    ahead, spread = predict(mean, covariance, gap, np.full(len(gap), JOIN_NOISE))
    spread = spread + motion.covariance[starts]
    cost, distance = _compare(motion.mean[starts] - ahead, spread)
    stands = _find_standing(motion, ends) & _find_standing(motion, starts)
    fixed = np.broadcast_to(np.diag(np.square(STANDING_SIGMAS)), spread.shape)
    resting, near = _compare(motion.mean[starts] - mean, fixed + 2 * motion.covariance[starts])
    better = stands & ((resting < cost) | (gap > MAX_GAP_S))
    cost, distance = np.where(better, resting, cost), np.where(better, near, distance)
    side = _measure_sides(detections, rows)
    change = np.minimum(np.nan_to_num((side[early] - side[late]) / SIZE_SIGMA) ** 2, GROUP_COST)
    kinds = np.array(types)
    groups = np.array([find_group(kind) for kind in types])
    cost += change + TYPE_COST * (kinds[early] != kinds[late])
    cost += GROUP_COST * (groups[early] != groups[late])
    outward = detections.find_outward()
    left = (motion.mean[ends, 1] * outward[rows.detection[ends]]).sum(axis=1) > STANDING_SPEED
    came = (motion.mean[starts, 1] * outward[rows.detection[starts]]).sum(axis=1) < -STANDING_SPEED
    cost -= UNJOINED_COST - BORDER_GAIN * left - BORDER_GAIN * came
    good = (cost < 0) & (distance < MAX_DISTANCE)
    return _number(*_assign(early[good], late[good], cost[good]), count)


def _list_pairs(
    motion: TrackMotion,
    edges: tuple[Int[Array, "N"], Int[Array, "N"]],
    begin: Float[Array, "N"],
    end: Float[Array, "N"],
) -> tuple[Int[Array, " p"], Int[Array, " p"]]:
    """List pairs of an earlier and a later track: soon after it, or at its place."""
    first, last = edges
    order = np.argsort(begin)
    low = np.searchsorted(begin[order], end, side="right")
    high = np.searchsorted(begin[order], end + MAX_GAP_S, side="right")
    pairs = {
        (early, int(late))
        for early, (start, stop) in enumerate(zip(low.tolist(), high.tolist(), strict=True))
        for late in order[start:stop]
    }
    resting = np.flatnonzero(_find_standing(motion, last))
    later = np.flatnonzero(_find_standing(motion, first))
    if len(resting) and len(later):
        near = cKDTree(motion.mean[first[later], 0]).query_ball_point(
            motion.mean[last[resting], 0], 4 * STANDING_SIGMAS[0]
        )
        pairs |= {
            (int(early), int(later[place]))
            for early, places in zip(resting, near, strict=True)
            for place in places
            if begin[later[place]] > end[early]
        }
    found = np.array(sorted(pairs), int).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _find_standing(motion: TrackMotion, rows: Int[Array, " p"]) -> Bool[Array, " p"]:
    return np.hypot(*motion.mean[rows, 1].T) < STANDING_SPEED


def _compare(
    offset: Float[Array, "p 2 2"], spread: Float[Array, "p 2 2"]
) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    """Minus twice the log density of offsets in place and velocity; their squared distance."""
    distance = (offset * np.linalg.solve(spread, offset)).sum(axis=(1, 2))
    return distance + 2 * np.log(4 * np.pi**2 * np.linalg.det(spread)), distance


def _measure_sides(detections: GroundDetections, rows: TrackRows) -> Float[Array, "N"]:
    """Measure the logarithm of each track's mean side, by its whole boxes; NaN without any."""
    sides = np.log(np.maximum(detections.extent.prod(axis=1), 1e-6)) / 2
    sides[detections.may_be_cut] = np.nan
    found = np.full(len(rows.bounds) - 1, np.nan)
    for number, part in enumerate(rows.list_parts()):
        seen = rows.detection[part]
        known = sides[seen[seen >= 0]]
        known = known[np.isfinite(known)]
        if len(known):
            found[number] = np.median(known)
    return found


def _assign(
    early: Int[Array, " p"], late: Int[Array, " p"], cost: Float[Array, " p"]
) -> tuple[Int[Array, " q"], Int[Array, " q"]]:
    """Choose pairs of least total cost, all below 0: in each group that shares no track."""
    if not len(cost):
        return early, late
    count = int(max(early.max(), late.max())) + 1
    graph = coo_array((np.ones(len(cost)), (early, count + late)), shape=(2 * count, 2 * count))
    group = connected_components(graph, directed=False)[1][early]
    chosen = []
    for number in np.unique(group):
        part = np.flatnonzero(group == number)
        ends, row = np.unique(early[part], return_inverse=True)
        starts, column = np.unique(late[part], return_inverse=True)
        table, index = np.zeros((len(ends), len(starts))), np.full((len(ends), len(starts)), -1)
        table[row, column], index[row, column] = cost[part], part
        found = index[linear_sum_assignment(table)]
        chosen.append(found[found >= 0])
    kept = np.concatenate(chosen)
    return early[kept], late[kept]


def _number(early: Int[Array, " q"], late: Int[Array, " q"], count: int) -> Int[Array, "N"]:
    """Number agents whose tracks are linked."""
    links = coo_array((np.ones(len(early)), (early, late)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], int)
