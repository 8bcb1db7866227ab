"""Association: which detections of successive frames belong to one agent, as they come."""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from geoaim.tracking.ground_detections import GroundDetections, select_detections
from geoaim.tracking.headings import MOVING_SPEED
from geoaim.tracking.kalman import START_SPEED_SIGMA, predict, start, update
from geoaim.tracking.noise import DEFAULT_NOISE_PX, MARGIN, SLOW_DT, estimate_noise

ACCELERATION_NOISE = 4.0  # m²/s³; spectral density of the acceleration of any agent
STANDING_NOISE = 0.5  # and of one that has stood for some time
STANDING_HITS = 10  # detections after which an agent that does not move stands
GATE = 16.0  # squared distance in standard deviations beyond which a detection is another agent's
CUT_SIGMA_M = 1.5  # of the middle of a box that the frame's border may cut off, across it
# minus twice the log of: a miss, and new agents or false boxes per m², inside and at the border
MISS_COST, BIRTH_COST, BORDER_BIRTH_COST = 4.6, 13.8, 9.2
TYPE_COST = 5.0  # the same of how seldom an agent's type changes
# a track ends when it is not seen for longer; it may be joined to a later one
MAX_GAP_S, MAX_GAP_STEPS = 0.6, 2.5
LEFT_M = 3.0  # beyond its last box at the border an agent has left the frame
CONFIRMING_HITS = 3  # detections after which a track may be missed for so long
MAX_FIRST_MISSES = 2  # frames without a detection after which a track ends before that
MIN_HITS = 5  # of a track, or `CONFIRMING_HITS` where frames are seldom; fewer are false boxes
MIN_START_SCORE = 0.4  # of a detection that starts a track, or the median one
LEARNING_STEPS, MEMORY = 25, 4000  # frames after which noise and scores are learnt; boxes of them


@dataclass(frozen=True, eq=False)
class Tracklets:
    """What was associated as the frames came; nothing here knows of later frames."""

    track: Int[Array, "M"]  # number of each detection's track, from 0; -1 for none
    confirmed: Int[Array, " N"]  # step from which each track counts
    sigma: Float[Array, "M"]  # standard deviation of each coordinate as known then, m


@dataclass(frozen=True)
class _Candidates:
    """The tracks that are followed at a time, or the detections of a frame; n of them."""

    number: Int[Array, " n"]  # of the track, or of the detection
    mean: Float[Array, "n 2 2"]
    covariance: Float[Array, "n 2 2"]
    hits: Int[Array, " n"]  # number of detections
    misses: Int[Array, " n"]  # frames since the last one
    seen: Float[Array, " n"]  # its time, s
    outward: Float[Array, "n 2"]  # unit vector to the border that may cut off the last one, or 0
    last: Float[Array, "n 2"]  # position of the last one, m
    types: Shaped[Array, " n"]


def associate(detections: GroundDetections, times: Float[Array, "T"]) -> Tracklets:
    """Associate detections of all frames to tracks by optimal assignment to predicted positions.

    Tracks are predicted at constant velocity. The cost of a pair is minus twice its log likelihood,
    against that of a miss and a new agent: of the distance and the type. A track counts
    from its fifth detection on; what has fewer is false. The noise is that of the boxes so far.
    """
    # frames without any box count neither as misses nor as steps: a detector may have been given
    # every third frame only
    searched, ranks = np.unique(detections.step, return_inverse=True)
    detections, times = replace(detections, step=ranks), times[searched]
    track, confirmed = np.full(len(detections.step), -1), np.empty(0, int)
    sigma = np.empty(len(track))
    outward = detections.find_outward()
    cut = detections.may_be_cut
    usual_dt = float(np.diff(times).min()) if len(times) > 1 else 0.0
    needed = CONFIRMING_HITS if usual_dt > SLOW_DT else MIN_HITS
    max_gap = find_max_gap(usual_dt)
    bounds = np.searchsorted(detections.step, np.arange(len(times) + 1))
    active = _describe(detections, np.empty(0, int), sigma, outward, 0.0)
    noise, least_score = DEFAULT_NOISE_PX, 0.0
    for step, time in enumerate(times.tolist()):
        rows = np.arange(bounds[step], bounds[step + 1])
        if step % LEARNING_STEPS == 0:
            past = np.arange(max(0, bounds[step] - MEMORY), bounds[step])
            found = estimate_noise(select_detections(detections, past), track[past], times)
            noise = max(MARGIN * found, DEFAULT_NOISE_PX)
            scores = detections.score[max(0, bounds[step] - MEMORY) : bounds[step + 1]]
            scores = scores[~np.isnan(scores)]
            least_score = min(MIN_START_SCORE, float(np.median(scores))) if len(scores) else 0.0
        sigma[rows] = np.where(cut[rows], CUT_SIGMA_M, noise * detections.resolution[rows])
        new = _describe(detections, rows, sigma, outward, time)
        active = _drop_lost(active, time - usual_dt, max_gap)
        active = _predict(active, time - float(times[max(step - 1, 0)]))
        cost = _compute_cost(active, new, noise * detections.resolution[rows])
        matched, columns = linear_sum_assignment(cost)
        fits = cost[matched, columns] < 0
        matched, columns = matched[fits], columns[fits]
        track[rows[columns]] = active.number[matched]
        active = _update(active, matched, _select(new, columns), sigma[rows[columns]])
        counts = (active.hits[matched] >= needed) & (confirmed[active.number[matched]] < 0)
        confirmed[active.number[matched[counts]]] = step
        born = np.setdiff1d(np.arange(len(rows)), columns)
        born = born[~(detections.score[rows[born]] < least_score)]
        track[rows[born]] = len(confirmed) + np.arange(len(born))
        started = replace(_select(new, born), number=track[rows[born]])
        confirmed = np.concatenate([confirmed, np.full(len(born), -1)])
        active = _join(active, started)
    counted = confirmed >= 0
    number = np.where(counted, np.cumsum(counted) - 1, -1)
    track = np.where(track >= 0, np.append(number, -1)[track], -1)
    return Tracklets(track, searched[confirmed[counted]], sigma)


def find_max_gap(usual_dt: float) -> float:
    """Find how long a track may be missed as the frames come, by the time between these, s."""
    return max(MAX_GAP_S, MAX_GAP_STEPS * usual_dt)


def _describe(
    detections: GroundDetections,
    rows: Int[Array, " n"],
    sigma: Float[Array, "M"],
    outward: Float[Array, "M 2"],
    time: float,
) -> _Candidates:
    """Describe detections as tracks that start with them."""
    mean, covariance = start(detections.position[rows], sigma[rows], START_SPEED_SIGMA)
    ones = np.ones(len(rows), int)
    return _Candidates(
        rows,
        mean,
        covariance,
        ones,
        0 * ones,
        np.full(len(rows), time),
        outward[rows],
        detections.position[rows],
        detections.types[rows],
    )


def _select(tracks: _Candidates, chosen: Shaped[Array, " m"]) -> _Candidates:
    return _Candidates(*(getattr(tracks, field.name)[chosen] for field in fields(tracks)))


def _join(one: _Candidates, other: _Candidates) -> _Candidates:
    pairs = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    return _Candidates(*(np.concatenate(pair) for pair in pairs))


def _predict(active: _Candidates, dt: float) -> _Candidates:
    """Predict tracks; one that has stood for some time is believed to go on standing."""
    stands = np.hypot(*active.mean[:, 1].T) < MOVING_SPEED
    stands &= active.hits >= STANDING_HITS
    noise = np.where(stands, STANDING_NOISE, ACCELERATION_NOISE)
    mean, covariance = predict(active.mean, active.covariance, dt, noise)
    return replace(active, mean=mean, covariance=covariance, misses=active.misses + 1)


def _is_leaving(active: _Candidates) -> Bool[Array, " n"]:
    return (active.mean[:, 1] * active.outward).sum(axis=1) > MOVING_SPEED


def _compute_cost(
    active: _Candidates, new: _Candidates, sigma: Float[Array, " m"]
) -> Float[Array, "n m"]:
    """Compute the cost of each pair against that of a miss and a new agent.

    A box that the border cuts off is uncertain across the border, and not along it.
    """
    offset = new.mean[None, :, 0] - active.mean[:, None, 0]
    across = (offset * new.outward).sum(axis=2) ** 2
    along = (offset**2).sum(axis=2) - across
    spread = active.covariance[:, None, 0, 0]
    variance = np.stack(
        [spread + sigma**2, spread + np.where(new.outward.any(axis=1), CUT_SIGMA_M, sigma) ** 2]
    )
    distance = along / variance[0] + across / variance[1]
    cost = distance + np.log(4 * np.pi**2 * variance.prod(axis=0))
    typed = (active.types[:, None] != "") & (new.types[None] != "")
    cost += TYPE_COST * (typed & (active.types[:, None] != new.types[None]))
    miss = np.where(_is_leaving(active), 0.0, MISS_COST)
    birth = np.where(new.outward.any(axis=1), BORDER_BIRTH_COST, BIRTH_COST)
    cost -= miss[:, None] + birth
    return np.where(distance < GATE, np.minimum(cost, 0), 0.0)


def _update(
    active: _Candidates, matched: Int[Array, " m"], new: _Candidates, sigma: Float[Array, " m"]
) -> _Candidates:
    """Update the matched tracks by their detections."""
    values = {field.name: getattr(active, field.name).copy() for field in fields(active)}
    values["mean"][matched], values["covariance"][matched] = update(
        active.mean[matched], active.covariance[matched], new.mean[:, 0], sigma
    )
    values["hits"][matched] += 1
    values["misses"][matched] = 0
    for name in ("seen", "outward", "last"):
        values[name][matched] = getattr(new, name)
    return _Candidates(**values)


def _drop_lost(active: _Candidates, time: float, max_gap: float) -> _Candidates:
    confirmed = active.hits >= CONFIRMING_HITS
    lasting = np.where(confirmed, time - active.seen <= max_gap, active.misses <= MAX_FIRST_MISSES)
    beyond = ((active.mean[:, 0] - active.last) * active.outward).sum(axis=1)
    return _select(active, lasting & (beyond < LEFT_M))
