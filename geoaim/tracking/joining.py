"""Joining: tracks that were lost for longer, put together when the whole video is known."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from geoaim.tracking.association import MIN_HITS, TYPE_COST, find_max_gap
from geoaim.tracking.ground_detections import GroundDetections, select_detections
from geoaim.tracking.headings import MOVING_SPEED
from geoaim.tracking.kalman import TrackMotion, TrackRows, predict
from geoaim.tracking.noise import SLOW_DT

MAX_GAP_S = 10.0  # between two tracks of one agent that moves
# m²/s³; spectral densities of the acceleration of an agent that is lost, along its way and across:
# it goes on as it was, changes its speed in its lane, or turns as well
JOIN_NOISE = ((0.3, 0.3), (6.0, 0.3), (6.0, 25.0))
MAX_END_DISTANCE = 9.0  # the same of an end of a track from what the rest of it tells
STANDING_SIGMAS = (0.5, 0.7)  # m and m/s, of what stood before and after, for however long
TURN_COST = 10.0  # the same of how seldom an agent turns back while it is lost
ROUNDS = 20  # of weighing pairs and counting what is left; later ones change nothing


@dataclass(frozen=True, eq=False)
class _Edges:
    """First or last detections that count of tracks; N of them."""

    row: Int[Array, " N"]
    time: Float[Array, " N"]  # s
    at_border: Bool[Array, " N"]  # where the agent drives over it
    told: Bool[Array, " N"]  # by the video's own first or last frame


def find_false_ends(
    motion: TrackMotion,
    rows: TrackRows,
    detections: GroundDetections,
    sigma: Float[Array, "M"],
    times: Float[Array, "T"],
) -> Bool[Array, "M"]:
    """Find first and last detections that lie off where the others of their track tell.

    A false box beside an agent that is lost or found soon after would turn its velocity there, by
    which the track is joined and its gap is bridged. Inside a track neighbours correct it. Sigma is
    that of each coordinate, m. Where frames are seldom, agents do not go on straight, and none is.
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

    The cost of a pair is minus twice the log of the odds of one agent that was lost against one
    that ended and another that began. How far the later one begins, in place and velocity, from
    where the earlier one would then be tells for the first; how often agents begin and end in this
    video, and how many of its tracks are false, for the second. That is counted in what is left
    unjoined, until joins and counts agree. What stands may be lost for however long. Detections of
    `find_false_ends` do not count. Gives the number of each track's agent, from 0.
    """
    count = len(types)
    first, last = _find_edges(motion, rows, detections, times, ~false)
    early, late = _list_pairs(motion, first, last)
    if not len(early):
        return np.arange(count)
    gap = first.time[late] - last.time[early]
    cost = _compare_motion(motion, last.row[early], first.row[late], gap)
    starting, ending = _find_directions(motion, rows)
    cost += TURN_COST * np.maximum(-(ending[early] * starting[late]).sum(axis=1), 0)
    cost += TYPE_COST * (np.array(types)[early] != np.array(types)[late])
    view = detections.view[rows.detection[first.row]]
    birth = _find_birth_density(motion.mean[first.row, 1], np.maximum(view, 1e-9), types)
    cost += 2 * (np.log(MAX_GAP_S) + birth[late])
    border = (detections.may_be_cut.sum() + 1) / (len(false) + 2)
    duration = float(times[-1] - times[0])
    chance = np.zeros(len(early))
    for _ in range(ROUNDS):
        followed, follows = (np.bincount(row, chance, count) for row in (early, late))
        ending, beginning = _count_unjoined(first, last, (followed, follows), duration, border)
        odds = cost + 2 * (ending[early] + beginning[late])
        weight = np.exp(-odds / 2)
        others = np.bincount(early, weight, count)[early] + np.bincount(late, weight, count)[late]
        chance = weight / (1 + others - weight)
    good = odds < 0
    links = _assign(early[good], late[good], odds[good])
    return _number(*links, count)


def _find_edges(
    motion: TrackMotion,
    rows: TrackRows,
    detections: GroundDetections,
    times: Float[Array, "T"],
    counts: Bool[Array, "M"],
) -> tuple[_Edges, _Edges]:
    """Find the first and the last detection that counts of each track."""
    counted = np.flatnonzero((rows.detection >= 0) & counts[rows.detection])
    bounds = np.searchsorted(rows.agent[counted], np.arange(len(rows.bounds)))
    soon = find_max_gap(float(times[1] - times[0])) if len(times) > 1 else 0.0
    found = []
    for sense, row in ((-1, counted[bounds[:-1]]), (1, counted[bounds[1:] - 1])):
        outward = select_detections(detections, rows.detection[row]).find_outward()
        speed = sense * (motion.mean[row, 1] * outward).sum(axis=1)
        time = times[rows.step[row]]
        told = time < times[0] + soon if sense < 0 else time > times[-1] - soon
        found.append(_Edges(row, time, speed > MOVING_SPEED, told))
    return found[0], found[1]


def _find_birth_density(
    velocity: Float[Array, "N 2"], view: Float[Array, "N"], types: tuple[str, ...]
) -> Float[Array, "N"]:
    """Log density of a new agent at each track's start, per m² and (m/s)².

    It begins anywhere in what the frame shows, and as fast as those of its type do.
    """
    square = (velocity**2).sum(axis=1)
    _, kind = np.unique(types, return_inverse=True)
    # of each coordinate; one more, of 1 m/s, stands for those that are not seen
    variance = ((np.bincount(kind, square) / 2 + 1) / (np.bincount(kind) + 1))[kind]
    return np.asarray(-np.log(view * 2 * np.pi * variance) - square / variance / 2)


def _count_unjoined(
    first: _Edges,
    last: _Edges,
    joined: tuple[Float[Array, "N"], Float[Array, "N"]],
    duration: float,
    border: float,
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Log odds that each track's agent ends for good, and rates at which others begin, 1/s.

    Tracks that neither begin nor end as agents do may be false: how many they are, and how long
    they last, tells how much each of them counts. To every count one is added, so that none is
    certain. `joined` has the chances that each track goes on in another one, and that it is what
    goes on; `border` is the share of the detections at the frame's border.
    """
    gone, new = 1 - joined[0], 1 - joined[1]
    inside = ~(first.at_border | first.told | last.at_border | last.told)
    alone = inside * gone * new
    ending, beginning = np.zeros((2, len(inside)))
    for at_border, share in ((True, border), (False, 1 - border)):
        ends = ~last.told & (last.at_border == at_border)
        begins = ~first.told & (first.at_border == at_border)
        lost, left = joined[0][ends].sum() + 1, (gone - alone)[ends].sum() + 1
        came = (new - alone)[begins].sum() + 1
        ending[ends], beginning[begins] = np.log(left / lost), np.log(came / duration / share)
    span = last.time - first.time
    lasting = ((alone * span).sum() + 1) / (alone.sum() + 1)  # s
    # how many are false, against agents that begin and end inside, of any length
    false = alone.sum() * np.exp(-span / lasting) / lasting
    doubt = np.log1p(inside * false * len(inside) * duration / (left * came))
    return ending + doubt, beginning + doubt


def _list_pairs(
    motion: TrackMotion, first: _Edges, last: _Edges
) -> tuple[Int[Array, " p"], Int[Array, " p"]]:
    """List pairs of an earlier and a later track: soon after it, or at its place."""
    order = np.argsort(first.time)
    low = np.searchsorted(first.time[order], last.time, side="right")
    high = np.searchsorted(first.time[order], last.time + MAX_GAP_S, side="right")
    pairs = {
        (early, int(late))
        for early, (start, stop) in enumerate(zip(low.tolist(), high.tolist(), strict=True))
        for late in order[start:stop]
    }
    resting = np.flatnonzero(_find_standing(motion, last.row))
    later = np.flatnonzero(_find_standing(motion, first.row))
    if len(resting) and len(later):
        near = cKDTree(motion.mean[first.row[later], 0]).query_ball_point(
            motion.mean[last.row[resting], 0], 4 * STANDING_SIGMAS[0]
        )
        pairs |= {
            (int(early), int(later[place]))
            for early, places in zip(resting, near, strict=True)
            for place in places
            if first.time[later[place]] > last.time[early]
        }
    found = np.array(sorted(pairs), int).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _find_standing(motion: TrackMotion, rows: Int[Array, " p"]) -> Bool[Array, " p"]:
    return np.hypot(*motion.mean[rows, 1].T) < MOVING_SPEED


def _compare_motion(
    motion: TrackMotion, ends: Int[Array, " p"], starts: Int[Array, " p"], gap: Float[Array, " p"]
) -> Float[Array, " p"]:
    """Compare where later tracks start with where earlier ones would then be, as `_compare`.

    Of several ways to go on the likeliest counts; what stands before and after may stay.
    """
    before, after = motion.mean[ends], motion.mean[starts]
    way = before[:, 1] + after[:, 1]
    way = way / np.maximum(np.hypot(*way.T), 1e-9)[:, None]
    turned = np.stack([way, np.column_stack([-way[:, 1], way[:, 0]])], axis=2)
    stands = _find_standing(motion, ends) & _find_standing(motion, starts)
    fixed = np.diag(np.square(STANDING_SIGMAS)) + 2 * motion.covariance[starts]
    costs = [np.where(stands, _compare(after - before, fixed, fixed), np.inf)]
    for noises in JOIN_NOISE:
        spreads = []
        for noise in noises:
            ahead, spread = predict(before, motion.covariance[ends], gap, np.full(len(gap), noise))
            spreads.append(spread + motion.covariance[starts])
        cost = _compare((after - ahead) @ turned, *spreads)
        costs.append(np.where((gap <= MAX_GAP_S) | ~stands, cost, np.inf))
    return np.asarray(np.min(costs, axis=0))


def _compare(
    offset: Float[Array, "p 2 2"], along: Float[Array, "p 2 2"], across: Float[Array, "p 2 2"]
) -> Float[Array, " p"]:
    """Minus twice the log density of offsets in place and velocity.

    The covariances of both are those of each coordinate.
    """
    spread = np.stack([along, across], axis=1)
    parts = offset.swapaxes(1, 2)[..., None]
    distance = (parts * np.linalg.solve(spread, parts)).sum(axis=(1, 2, 3))
    return np.asarray(distance + np.log(4 * np.pi**2 * np.linalg.det(spread)).sum(axis=1))


def _find_directions(
    motion: TrackMotion, rows: TrackRows
) -> tuple[Float[Array, "N 2"], Float[Array, "N 2"]]:
    """Find the first and the last direction in which each track moves; 0 if it never does."""
    velocity = motion.mean[:, 1]
    speed = np.hypot(*velocity.T)
    moving = np.flatnonzero(speed > MOVING_SPEED)
    bounds = np.searchsorted(rows.agent[moving], np.arange(len(rows.bounds)))
    moves = np.diff(bounds) > 0
    found = np.zeros((2, len(moves), 2))
    for number, edge in enumerate((bounds[:-1][moves], bounds[1:][moves] - 1)):
        found[number, moves] = velocity[moving[edge]] / speed[moving[edge], None]
    return found[0], found[1]


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
