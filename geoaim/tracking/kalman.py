"""Kalman filter and Rauch-Tung-Striebel smoother of many tracks at once.

Each track is a point that moves at constant velocity but for white noise in its acceleration (Bar-
Shalom, Li, Kirubarajan 2001, chapter 6.2). Noise is the same in x and y and independent between
them, so that one covariance of position and velocity (2, 2) holds for both coordinates.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

START_SPEED_SIGMA = 8.0  # m/s, of each component of a velocity that is not known yet


@dataclass(frozen=True, eq=False)
class TrackRows:
    """A row for each agent and step from its first detection to its last; S rows, by agent."""

    agent: Int[Array, " S"]
    step: Int[Array, " S"]
    detection: Int[Array, " S"]  # number of the agent's detection; -1 where it has none
    bounds: Int[Array, " n"]  # number of each agent's first row, and that of all rows

    def list_parts(self) -> list[slice]:
        """List the rows of each agent."""
        ends = self.bounds.tolist()
        return [slice(*pair) for pair in pairwise(ends)]

    def list_steps(self) -> list[Int[Array, " r"]]:
        """List the rows of each step that have one before them, in order of time."""
        follows = np.ones(len(self.step), bool)
        follows[self.bounds[:-1]] = False
        order = np.argsort(self.step, kind="stable")
        order = order[follows[order]]
        edges = np.flatnonzero(np.diff(self.step[order])) + 1
        return [part for part in np.split(order, edges) if len(part)]


def make_rows(track: Int[Array, "M"], step: Int[Array, "M"]) -> TrackRows:
    """Make rows of detections; each belongs to an agent, numbered from 0.

    >>> make_rows(np.array([0, 1, 0]), np.array([4, 5, 6])).detection
    array([ 0, -1,  2,  1])
    """
    count = int(track.max(initial=-1)) + 1
    first, last = np.full(count, np.iinfo(int).max), np.full(count, -1)
    np.minimum.at(first, track, step)
    np.maximum.at(last, track, step)
    bounds = np.concatenate([[0], np.cumsum(last - first + 1)])
    agent = np.repeat(np.arange(count), np.diff(bounds))
    offset = bounds[:-1] - first
    detection = np.full(bounds[-1], -1)
    detection[offset[track] + step] = np.arange(len(track))
    return TrackRows(agent, np.arange(bounds[-1]) - offset[agent], detection, bounds)


@dataclass(frozen=True, eq=False)
class TrackMotion:
    """Estimated motion of tracks, a row for each agent and step."""

    mean: Float[Array, "S 2 2"]  # position (m) and velocity (m/s), each x and y
    covariance: Float[Array, "S 2 2"]  # of position and velocity, in one coordinate


def predict(
    mean: Float[Array, "n 2 2"],
    covariance: Float[Array, "n 2 2"],
    dt: float | Float[Array, "n"],
    acceleration_noise: Float[Array, "n"],
) -> tuple[Float[Array, "n 2 2"], Float[Array, "n 2 2"]]:
    """Predict tracks by `dt` seconds; the noise is a spectral density, m²/s³."""
    ahead, spread = mean.copy(), np.empty_like(covariance)
    ahead[:, 0] += np.asarray(dt)[..., None] * mean[:, 1]
    (place, both), speed = covariance[:, 0].T, covariance[:, 1, 1]
    moved = both + dt * speed
    spread[:, 0, 0] = place + dt * (both + moved) + acceleration_noise * (dt**3 / 3)
    spread[:, 0, 1] = spread[:, 1, 0] = moved + acceleration_noise * (dt**2 / 2)
    spread[:, 1, 1] = speed + acceleration_noise * dt
    return ahead, spread


def update(
    mean: Float[Array, "n 2 2"],
    covariance: Float[Array, "n 2 2"],
    position: Float[Array, "n 2"],
    sigma: Float[Array, "n"],
) -> tuple[Float[Array, "n 2 2"], Float[Array, "n 2 2"]]:
    """Update predicted tracks by positions, each coordinate with its standard deviation, m."""
    gain = covariance[:, :, 0] / (covariance[:, 0, 0] + sigma**2)[:, None]
    mean = mean + gain[:, :, None] * (position - mean[:, 0])[:, None, :]
    return mean, covariance - gain[:, :, None] * covariance[:, None, 0, :]


def start(
    position: Float[Array, "n 2"], sigma: Float[Array, "n"], speed_sigma: float
) -> tuple[Float[Array, "n 2 2"], Float[Array, "n 2 2"]]:
    """Start tracks at positions (m, to sigma), with a velocity of 0 to speed_sigma (m/s)."""
    mean = np.stack([position, np.zeros_like(position)], axis=1)
    covariance = np.zeros((len(position), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = sigma**2, speed_sigma**2
    return mean, covariance


def filter_tracks(
    times: Float[Array, "T"],
    rows: TrackRows,
    positions: Float[Array, "S 2"],
    sigmas: Float[Array, "S"],
    acceleration_noise: Float[Array, "N"],
) -> TrackMotion:
    """Filter tracks forward in time: each state knows the measurements until then.

    Positions (m) are NaN where there is none, with the standard deviation of each coordinate. The
    noise of acceleration is a spectral density, m²/s³.
    """
    mean, covariance = np.empty((len(rows.step), 2, 2)), np.empty((len(rows.step), 2, 2))
    begin, seen = rows.bounds[:-1], rows.detection >= 0
    mean[begin], covariance[begin] = start(positions[begin], sigmas[begin], START_SPEED_SIGMA)
    for now in rows.list_steps():
        step = rows.step[now[0]]
        dt = float(times[step] - times[step - 1])
        noise = acceleration_noise[rows.agent[now]]
        mean[now], covariance[now] = predict(mean[now - 1], covariance[now - 1], dt, noise)
        hit = now[seen[now]]
        mean[hit], covariance[hit] = update(mean[hit], covariance[hit], positions[hit], sigmas[hit])
    return TrackMotion(mean, covariance)


def smooth_tracks(
    times: Float[Array, "T"],
    rows: TrackRows,
    filtered: TrackMotion,
    acceleration_noise: Float[Array, "N"],
) -> TrackMotion:
    """Smooth filtered tracks backward in time, so that each state knows all measurements.

    By Rauch, Tung, Striebel (1965), with the noise (m²/s³) of the filter, whose result is
    overwritten, since long videos fill the memory.
    """
    mean, covariance = filtered.mean, filtered.covariance
    for after in reversed(rows.list_steps()):
        now, step = after - 1, rows.step[after[0]]
        dt = float(times[step] - times[step - 1])
        before = covariance[now]
        ahead, spread = predict(mean[now], before, dt, acceleration_noise[rows.agent[now]])
        cross = before.copy()
        cross[:, :, 0] += dt * before[:, :, 1]
        gain = cross @ _invert(spread)
        mean[now] += gain @ (mean[after] - ahead)
        covariance[now] = before + gain @ (covariance[after] - spread) @ np.swapaxes(gain, 1, 2)
    return filtered


def _invert(matrices: Float[Array, "n 2 2"]) -> Float[Array, "n 2 2"]:
    """Invert symmetric matrices, in half the time of numpy's."""
    (one, both), other = matrices[:, 0].T, matrices[:, 1, 1]
    inverse = np.empty_like(matrices)
    inverse[:, 0, 0], inverse[:, 1, 1] = other, one
    inverse[:, 0, 1] = inverse[:, 1, 0] = -both
    return np.asarray(inverse / (one * other - both**2)[:, None, None])
