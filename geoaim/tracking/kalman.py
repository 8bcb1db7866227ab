"""Kalman filter and Rauch-Tung-Striebel smoother of many tracks at once.

Each track is a point that moves at constant velocity but for white noise in its acceleration (Bar-
Shalom, Li, Kirubarajan 2001, chapter 6.2). Noise is the same in x and y and independent between
them, so that one covariance of position and velocity (2, 2) holds for both coordinates.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

START_SPEED_SIGMA = 8.0  # m/s, of each component of a velocity that is not known yet


@dataclass(frozen=True, eq=False)
class TrackMotion:
    """Estimated motion of N tracks at T times; NaN outside the track."""

    mean: Float[Array, "*N T 2 2"]  # position (m) and velocity (m/s), each x and y
    covariance: Float[Array, "*N T 2 2"]  # of position and velocity, in one coordinate


def predict(
    mean: Float[Array, "n 2 2"],
    covariance: Float[Array, "n 2 2"],
    dt: float,
    acceleration_noise: Float[Array, "n"],
) -> tuple[Float[Array, "n 2 2"], Float[Array, "n 2 2"]]:
    """Predict tracks.

    Args:
        mean: positions (m) and velocities (m/s).
        covariance: of position and velocity, in one coordinate.
        dt: how far ahead, s.
        acceleration_noise: spectral density, m²/s³.

    Returns:
        Mean and covariance then.
    """
    transition = np.array([[1.0, dt], [0.0, 1.0]])
    noise = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    spread = transition @ covariance @ transition.T
    return transition @ mean, spread + acceleration_noise[:, None, None] * noise


def update(
    mean: Float[Array, "n 2 2"],
    covariance: Float[Array, "n 2 2"],
    position: Float[Array, "n 2"],
    sigma: Float[Array, "n"],
) -> tuple[Float[Array, "n 2 2"], Float[Array, "n 2 2"]]:
    """Update tracks by measured positions.

    Args:
        mean: predicted positions (m) and velocities (m/s).
        covariance: of position and velocity, in one coordinate.
        position: measured, m.
        sigma: standard deviation of each of its coordinates, m.

    Returns:
        Mean and covariance.
    """
    gain = covariance[:, :, 0] / (covariance[:, 0, 0] + sigma**2)[:, None]
    mean = mean + gain[:, :, None] * (position - mean[:, 0])[:, None, :]
    return mean, covariance - gain[:, :, None] * covariance[:, None, 0, :]


def start(
    position: Float[Array, "n 2"], sigma: Float[Array, "n"], speed_sigma: float
) -> tuple[Float[Array, "n 2 2"], Float[Array, "n 2 2"]]:
    """Start tracks at measured positions.

    Args:
        position: measured, m.
        sigma: standard deviation of each of its coordinates, m.
        speed_sigma: of each component of the velocity about 0, m/s.

    Returns:
        Mean and covariance.
    """
    mean = np.stack([position, np.zeros_like(position)], axis=1)
    covariance = np.zeros((len(position), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = sigma**2, speed_sigma**2
    return mean, covariance


def filter_tracks(
    times: Float[Array, "T"],
    positions: Float[Array, "N T 2"],
    sigmas: Float[Array, "N T"],
    acceleration_noise: Float[Array, "N"],
    *,
    speed_sigma: float,
) -> TrackMotion:
    """Filter tracks forward in time: each state knows the measurements until then.

    Args:
        times: seconds, increasing.
        positions: measured positions, m; NaN where there is none.
        sigmas: their standard deviations in each coordinate, m.
        acceleration_noise: spectral density of the acceleration, m²/s³.
        speed_sigma: standard deviation of each velocity component at the start, m/s.

    Returns:
        The motion from each track's first measurement to its last.
    """
    count, steps = positions.shape[:2]
    mean, covariance = (np.full((count, steps, 2, 2), np.nan) for _ in range(2))
    seen = np.isfinite(positions[..., 0])
    first = np.where(seen.any(axis=1), np.argmax(seen, axis=1), steps)
    last = steps - 1 - np.argmax(seen[:, ::-1], axis=1)
    for step in range(steps):
        running = np.flatnonzero((first < step) & (last >= step))
        if len(running):
            state = mean[running, step - 1], covariance[running, step - 1]
            dt = float(times[step] - times[step - 1])
            new_mean, new_covariance = predict(*state, dt, acceleration_noise[running])
            hit = seen[running, step]
            measured = positions[running[hit], step], sigmas[running[hit], step]
            new_mean[hit], new_covariance[hit] = update(
                new_mean[hit], new_covariance[hit], *measured
            )
            mean[running, step], covariance[running, step] = new_mean, new_covariance
        begun = np.flatnonzero(first == step)
        mean[begun, step], covariance[begun, step] = start(
            positions[begun, step], sigmas[begun, step], speed_sigma
        )
    return TrackMotion(mean, covariance)


def smooth_tracks(
    times: Float[Array, "T"], filtered: TrackMotion, acceleration_noise: Float[Array, "N"]
) -> TrackMotion:
    """Smooth filtered tracks backward in time, so that each state knows all measurements.

    Args:
        times: seconds, increasing.
        filtered: what `filter_tracks` gave.
        acceleration_noise: the same as in the filter, m²/s³.

    Returns:
        The smoothed motion (Rauch, Tung, Striebel 1965).
    """
    mean, covariance = filtered.mean.copy(), filtered.covariance.copy()
    known = np.isfinite(mean[:, :, 0, 0])
    for step in range(len(times) - 2, -1, -1):
        running = np.flatnonzero(known[:, step] & known[:, step + 1])
        if not len(running):
            continue
        dt = float(times[step + 1] - times[step])
        before = covariance[running, step]
        ahead, spread = predict(mean[running, step], before, dt, acceleration_noise[running])
        cross = before @ np.array([[1.0, 0.0], [dt, 1.0]])
        gain = np.swapaxes(np.linalg.solve(spread, np.swapaxes(cross, 1, 2)), 1, 2)
        mean[running, step] += gain @ (mean[running, step + 1] - ahead)
        change = covariance[running, step + 1] - spread
        covariance[running, step] = before + gain @ change @ np.swapaxes(gain, 1, 2)
    return TrackMotion(mean, covariance)
