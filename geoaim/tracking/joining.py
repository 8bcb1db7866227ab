"""Joining: tracks that were lost for longer, put together when the whole video is known."""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from geoaim.tracking.association import MIN_HITS, find_max_gap
from geoaim.tracking.ground_detections import GroundDetections, select_detections
from geoaim.tracking.kalman import TrackMotion, TrackRows, predict
from geoaim.tracking.noise import SLOW_DT
from geoaim.tracking.sizes import estimate_size
from geoaim.tracks.agent_types import find_group

MAX_GAP_S = 10.0  # between two tracks of one agent that moves
# m²/s³; spectral densities of the acceleration of an agent that is lost, along its way and across:
# it goes on as it was, changes its speed in its lane, or turns as well
JOIN_NOISE = ((0.3, 0.3), (6.0, 0.3), (6.0, 25.0))
PEDESTRIAN_SHARE = 0.01  # of these for pedestrians, who hardly change their walk
MAX_DISTANCE = 25.0  # squared, in standard deviations
MAX_END_DISTANCE = 9.0  # the same of an end of a track from what the rest of it tells
STANDING_SPEED = 0.7  # m/s
STANDING_SIGMAS = (0.5, 0.7)  # m and m/s, of what stood before and after, for however long
# minus twice the log of: an end and a start inside the frame; less for each one at the border
UNJOINED_COST, BORDER_GAIN = 34.0, 8.0
LENGTH_SIGMA, GROUP_COST, TYPE_COST = 0.1, 10.0, 2.0  # the first of the logarithm of a length
MIN_MOVING_SPEED, SIDE_SIGMA_M = 2.0, 0.2  # m/s, above which boxes tell it; m, of their sides
TURNED_BACK, TURN_COST = -0.7, 10.0  # cosine of a turn while lost that few vehicles make


def find_false_ends(
    motion: TrackMotion,
    rows: TrackRows,
    detections: GroundDetections,
    sigma: Float[Array, "M"],
    times: Float[Array, "T"],
) -> Bool[Array, "M"]:
    """Find first and last detections that lie off where the others of their track tell.

    A false box beside an agent that is lost or found soon after would turn its velocity there, by
    which the track is joined and its gap is bridged. Inside a track neighbours correct it.

    Args:
        motion: smoothed motion of the tracks.
        rows: of the tracks.
        detections: of the tracks.
        sigma: standard deviation of each coordinate, m.
        times: of the frames, s; where they are seldom, agents do not go on straight.

    Returns:
        Whether each detection is such a one.
    """
    false = np.zeros(len(sigma), bool)
    usual_dt = float(times[1] - times[0]) if len(times) > 1 else np.inf
    if usual_dt > SLOW_DT:
        return false
    long = np.diff(rows.bounds) >= MIN_HITS
    # of what may return no end is known yet
    gone = times[-1] - times[rows.step[rows.bounds[1:] - 1]] > find_max_gap(usual_dt)
    for ends in (rows.bounds[:-1][long], rows.bounds[1:][long & gone] - 1):
        part = rows.detection[ends]
        offset = detections.position[part] - motion.mean[ends, 0]
        # those from a prediction without it, and their variance, follow from the smoothed state
        variance = np.maximum(sigma[part] ** 2 - motion.covariance[ends, 0, 0], 0)
        false[part] = (offset**2).sum(axis=1) > MAX_END_DISTANCE * variance
    return false & ~detections.may_be_cut


def join_tracks(
    motion: TrackMotion,
    rows: TrackRows,
    types: tuple[str, ...],
    detections: GroundDetections,
    times: Float[Array, "T"],
    false: Bool[Array, "M"],
) -> Int[Array, "N"]:
    """Join tracks that end and begin as one agent would, by one optimal assignment.

    The cost of a pair is minus twice its log likelihood: how far the later one begins, in place and
    velocity, from where the earlier one would then be, and how alike their lengths and types are.
    Of several ways to go on, the likeliest counts. What stands may be lost for however long.

    Args:
        motion: smoothed motion of the tracks.
        rows: of the tracks.
        types: of the tracks.
        detections: of the tracks.
        times: of the frames, s.
        false: detections that do not count: those of `find_false_ends`.

    Returns:
        The number of each track's agent, from 0.
    """
    count = len(types)
    if count < 2:
        return np.zeros(count, int)
    counted = np.flatnonzero((rows.detection >= 0) & ~false[rows.detection])
    bounds = np.searchsorted(rows.agent[counted], np.arange(count + 1))
    first, last = counted[bounds[:-1]], counted[bounds[1:] - 1]
    begin, end = times[rows.step[first]], times[rows.step[last]]
    early, late = _list_pairs(motion, (first, last), begin, end)
    gap = begin[late] - end[early]
    ends, starts = last[early], first[late]
    kinds = np.array(types)
    groups = np.array([find_group(kind) for kind in types])
    walks = (groups[early] == "pedestrian") & (groups[late] == "pedestrian")
    share = np.where(walks, PEDESTRIAN_SHARE, 1.0)
    cost, distance = _compare_motion(motion, ends, starts, gap, share)
    stands = _find_standing(motion, ends) & _find_standing(motion, starts)
    fixed = np.diag(np.square(STANDING_SIGMAS)) + 2 * motion.covariance[starts]
    resting, near = _compare(motion.mean[starts] - motion.mean[ends], fixed, fixed)
    better = stands & ((resting < cost) | (gap > MAX_GAP_S))
    cost, distance = np.where(better, resting, cost), np.where(better, near, distance)
    length = _measure_lengths(detections, rows, motion, types)
    change = np.nan_to_num((length[early] - length[late]) / LENGTH_SIGMA) ** 2
    cost += np.minimum(change, GROUP_COST)
    starting, ending = _find_directions(motion, rows)
    back = (ending[early] * starting[late]).sum(axis=1) < TURNED_BACK
    cost += TURN_COST * back
    cost += TYPE_COST * (kinds[early] != kinds[late])
    cost += GROUP_COST * (groups[early] != groups[late])
    edges = [select_detections(detections, rows.detection[part]) for part in (ends, starts)]
    outward = [part.find_outward() for part in edges]
    left = (motion.mean[ends, 1] * outward[0]).sum(axis=1) > STANDING_SPEED
    came = (motion.mean[starts, 1] * outward[1]).sum(axis=1) < -STANDING_SPEED
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


def _compare_motion(
    motion: TrackMotion,
    ends: Int[Array, " p"],
    starts: Int[Array, " p"],
    gap: Float[Array, " p"],
    share: Float[Array, " p"],
) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    """Compare where later tracks start with where earlier ones would then be, as `_compare`.

    Each pair has its share of the noise.
    """
    before, after = motion.mean[ends], motion.mean[starts]
    way = before[:, 1] + after[:, 1]
    way = way / np.maximum(np.hypot(*way.T), 1e-9)[:, None]
    turned = np.stack([way, np.column_stack([-way[:, 1], way[:, 0]])], axis=2)
    found = []
    for along, across in JOIN_NOISE:
        spreads = []
        for noise in (along, across):
            ahead, spread = predict(before, motion.covariance[ends], gap, noise * share)
            spreads.append(spread + motion.covariance[starts])
        found.append(_compare((after - ahead) @ turned, *spreads))
    costs, distances = (np.stack(part) for part in zip(*found, strict=True))
    best = costs.argmin(axis=0)[None]
    return np.take_along_axis(costs, best, 0)[0], np.take_along_axis(distances, best, 0)[0]


def _compare(
    offset: Float[Array, "p 2 2"], along: Float[Array, "p 2 2"], across: Float[Array, "p 2 2"]
) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    """Minus twice the log density of offsets in place and velocity; their squared distance.

    The covariances of both are those of each coordinate.
    """
    spread = np.stack([along, across], axis=1)
    parts = offset.swapaxes(1, 2)[..., None]
    distance = (parts * np.linalg.solve(spread, parts)).sum(axis=(1, 2, 3))
    density = np.log(4 * np.pi**2 * np.linalg.det(spread)).sum(axis=1)
    return distance + density, distance


def _find_directions(
    motion: TrackMotion, rows: TrackRows
) -> tuple[Float[Array, "N 2"], Float[Array, "N 2"]]:
    """Find the first and the last direction in which each track moves; 0 if it never does."""
    velocity = motion.mean[:, 1]
    speed = np.hypot(*velocity.T)
    moving = np.flatnonzero(speed > MIN_MOVING_SPEED)
    bounds = np.searchsorted(rows.agent[moving], np.arange(len(rows.bounds)))
    moves = np.diff(bounds) > 0
    found = np.zeros((2, len(moves), 2))
    for number, edge in enumerate((bounds[:-1][moves], bounds[1:][moves] - 1)):
        found[number, moves] = velocity[moving[edge]] / speed[moving[edge], None]
    return found[0], found[1]


def _measure_lengths(
    detections: GroundDetections, rows: TrackRows, motion: TrackMotion, types: tuple[str, ...]
) -> Float[Array, "N"]:
    """Measure the logarithm of each track's length, by whole boxes where it moves; or NaN."""
    velocity = motion.mean[:, 1]
    usable = (rows.detection >= 0) & (np.hypot(*velocity.T) > MIN_MOVING_SPEED)
    usable &= ~detections.may_be_cut[rows.detection]
    direction = np.arctan2(velocity[:, 1], velocity[:, 0])
    found = np.full(len(types), np.nan)
    for number, part in enumerate(rows.list_parts()):
        seen = rows.detection[part][usable[part]]
        if len(seen) >= MIN_HITS:
            turn = direction[part][usable[part]] - detections.axis[seen]
            extent = detections.extent[seen]
            found[number] = np.log(estimate_size(extent, turn, SIDE_SIGMA_M, types[number])[0])
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
