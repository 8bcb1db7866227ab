"""Association: which detections of successive frames belong to one agent."""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.kalman import START_SPEED_SIGMA, predict, start, update

ACCELERATION_NOISE = 4.0  # m²/s³; spectral density of the acceleration of any agent
GATE = 16.0  # squared distance in standard deviations beyond which a detection is another agent's
MAX_GATE_M = 5.0  # and the distance in metres
MAX_GAP_S = 2.0  # a track ends when it is not seen for longer
CONFIRMING_HITS = 3  # detections after which a track may be missed for so long
MAX_FIRST_MISSES = 2  # frames without a detection after which a track ends before that
MIN_HITS, MIN_HIT_SHARE = 5, 0.4  # of a track; fewer are taken for false detections
MIN_START_SCORE = 0.4  # of a detection that starts a track, or the median one
UNMATCHED = 1e6  # cost of a pair outside the gate


@dataclass(frozen=True)
class _Candidates:
    """The tracks that are followed at a time, or the detections of a frame; n of them."""

    number: Int[Array, " n"]  # of the track, or of the detection
    mean: Float[Array, "n 2 2"]
    covariance: Float[Array, "n 2 2"]
    hits: Int[Array, " n"]  # number of detections
    misses: Int[Array, " n"]  # frames since the last one
    seen: Float[Array, " n"]  # its time, s


def associate(
    detections: GroundDetections, times: Float[Array, "T"], sigma: Float[Array, "M"]
) -> Int[Array, "M"]:
    """Associate detections to tracks by optimal assignment to predicted positions.

    Tracks are predicted at constant velocity. The cost of a pair is minus twice its log likelihood:
    the squared distance in standard deviations, and the logarithm of the covariance's determinant.

    Args:
        detections: detections of all frames.
        times: of the frames, s.
        sigma: standard deviation of each coordinate of the positions, m.

    Returns:
        The number of each detection's track, from 0; -1 for one that belongs to none.
    """
    track, count = np.full(len(detections.step), -1), 0
    scores = detections.score[np.isfinite(detections.score)]
    least_score = min(MIN_START_SCORE, float(np.median(scores))) if len(scores) else 0.0
    bounds = np.searchsorted(detections.step, np.arange(len(times) + 1))
    active = _describe(detections, np.empty(0, int), sigma, 0.0)
    for step, time in enumerate(times.tolist()):
        rows = np.arange(bounds[step], bounds[step + 1])
        new = _describe(detections, rows, sigma, time)
        dt = time - float(times[max(step - 1, 0)])
        mean, covariance = predict(
            active.mean, active.covariance, dt, np.full(len(active.number), ACCELERATION_NOISE)
        )
        active = replace(active, mean=mean, covariance=covariance, misses=active.misses + 1)
        cost = _compute_cost(active, new, sigma[rows])
        matched, columns = linear_sum_assignment(cost)
        fits = cost[matched, columns] < UNMATCHED
        matched, columns = matched[fits], columns[fits]
        track[rows[columns]] = active.number[matched]
        active = _update(active, matched, _select(new, columns), sigma[rows[columns]])
        born = np.setdiff1d(np.arange(len(rows)), columns)
        born = born[~(detections.score[rows[born]] < least_score)]
        track[rows[born]] = count + np.arange(len(born))
        started = replace(_select(new, born), number=track[rows[born]])
        count += len(born)
        active = _drop_lost(_join(active, started), time)
    return _drop_false(track, detections.step)


def _describe(
    detections: GroundDetections, rows: Int[Array, " n"], sigma: Float[Array, "M"], time: float
) -> _Candidates:
    """Describe detections as tracks that start with them."""
    mean, covariance = start(detections.position[rows], sigma[rows], START_SPEED_SIGMA)
    ones = np.ones(len(rows), int)
    return _Candidates(rows, mean, covariance, ones, 0 * ones, np.full(len(rows), time))


def _select(tracks: _Candidates, chosen: Shaped[Array, " m"]) -> _Candidates:
    return _Candidates(*(getattr(tracks, field.name)[chosen] for field in fields(tracks)))


def _join(one: _Candidates, other: _Candidates) -> _Candidates:
    pairs = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    return _Candidates(*(np.concatenate(pair) for pair in pairs))


def _compute_cost(
    active: _Candidates, new: _Candidates, sigma: Float[Array, " m"]
) -> Float[Array, "n m"]:
    """Compute minus twice the log likelihood of each pair, `UNMATCHED` outside the gate."""
    offset = active.mean[:, None, 0] - new.mean[None, :, 0]
    distance = (offset**2).sum(axis=2)
    variance = active.covariance[:, None, 0, 0] + sigma**2
    inside = (distance / variance < GATE) & (distance < MAX_GATE_M**2)
    return np.where(inside, distance / variance + 2 * np.log(variance), UNMATCHED)


def _update(
    active: _Candidates, matched: Int[Array, " m"], new: _Candidates, sigma: Float[Array, " m"]
) -> _Candidates:
    """Update the matched tracks by their detections."""
    mean, covariance, hits, misses, seen = (
        getattr(active, field.name).copy() for field in fields(active)[1:]
    )
    mean[matched], covariance[matched] = update(
        mean[matched], covariance[matched], new.mean[:, 0], sigma
    )
    hits[matched] += 1
    misses[matched], seen[matched] = 0, new.seen
    return _Candidates(active.number, mean, covariance, hits, misses, seen)


def _drop_lost(active: _Candidates, time: float) -> _Candidates:
    confirmed = active.hits >= CONFIRMING_HITS
    lasting = np.where(
        confirmed, time - active.seen <= MAX_GAP_S, active.misses <= MAX_FIRST_MISSES
    )
    return _select(active, lasting)


def _drop_false(track: Int[Array, "M"], step: Int[Array, "M"]) -> Int[Array, "M"]:
    """Drop tracks of few detections, and number the others from 0 without gaps."""
    numbers, place = np.unique(track, return_inverse=True)
    hits = np.bincount(place)
    first, last = np.full(len(numbers), len(step) + 1), np.full(len(numbers), -1)
    np.minimum.at(first, place, step)
    np.maximum.at(last, place, step)
    kept = (hits >= MIN_HITS) & (hits >= MIN_HIT_SHARE * (last - first + 1)) & (numbers >= 0)
    renumbered = np.where(kept, np.cumsum(kept) - 1, -1)
    return renumbered[place]
