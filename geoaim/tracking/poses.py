"""Poses of agents: headings and signed speeds from their motion, and their uncertainty."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.base.geometry import wrap_angle
from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.headings import REAR_AXLE_SHARE, compute_headings, observe_headings
from geoaim.tracking.kalman import TrackMotion
from geoaim.tracking.sizes import get_typical_size
from geoaim.tracking.standing import UNKNOWN_SIGMA_RAD, Directions, find_standing_heading
from geoaim.tracks.agent_types import find_group
from geoaim.tracks.tracks import estimate_heading

MAX_REVERSE_SPEED = 3.5  # m/s; a faster vehicle drives forward
MAX_OBSERVED_SPEED_SIGMA = 0.6  # m/s; a less certain speed is not known yet
ORIENTED_SIGMA_RAD = 0.05  # of the heading of an oriented box


@dataclass(frozen=True, eq=False)
class Poses:
    """States of N agents at T times; NaN where they are absent."""

    states: Float[Array, "N T 4"]  # x, y, heading, speed
    uncertainty: Float[Array, "N T 2"]  # standard deviations of a coordinate (m), heading (rad)
    standing: Float[Array, " N"]  # heading before a vehicle moves, rad; NaN if it is unknown

    @property
    def headings(self) -> Float[Array, "N T"]:
        """Headings, rad."""
        return self.states[..., 2]


def compute_poses(
    smoothed: TrackMotion,
    types: tuple[str, ...],
    sizes: Float[Array, "N 2"],
    detections: GroundDetections,
    row: Int[Array, "N T"],
    lanes: Directions | None,
) -> Poses:
    """Compute headings and speeds from smoothed motion.

    Args:
        smoothed: the motion of the agents.
        types: their types.
        sizes: their lengths and widths, m.
        detections: all detections.
        row: number of each agent's detection at each time; -1 for none.
        lanes: directions of lanes, for vehicles that stand; None: not known.

    Returns:
        The poses.
    """
    mean = smoothed.mean
    heading, sigma = (np.full(row.shape, np.nan) for _ in range(2))
    turning = np.array([turns_on_spot(kind) for kind in types], bool)
    standing = np.full((len(types), 2), np.nan)
    for agent in range(len(types)):
        compute = _compute_directions if turning[agent] else _compute_vehicle_headings
        here, part = _select_present(smoothed, agent)
        heading[agent, here], sigma[agent, here] = compute(part, float(sizes[agent, 0]), None)
    for agent in np.flatnonzero(~turning).tolist():
        rows = row[agent, row[agent] >= 0]
        standing[agent] = _find_heading(detections, rows, get_typical_size(types[agent]), lanes)
        here, part = _select_present(smoothed, agent)
        may_reverse = np.hypot(*part.mean[:, 1].T).max() < MAX_REVERSE_SPEED
        if may_reverse or np.isnan(heading[agent, here]).any():
            found = _compute_vehicle_headings(part, float(sizes[agent, 0]), standing[agent])
            heading[agent, here], sigma[agent, here] = found
    speed = mean[:, :, 1, 0] * np.cos(heading) + mean[:, :, 1, 1] * np.sin(heading)
    speed[turning] = np.hypot(mean[turning, :, 1, 0], mean[turning, :, 1, 1])
    states = np.concatenate([mean[:, :, 0], heading[..., None], speed[..., None]], axis=-1)
    spread = np.sqrt(smoothed.covariance[:, :, 0, 0])
    before = np.where(standing[:, 1] < UNKNOWN_SIGMA_RAD, standing[:, 0], np.nan)
    return Poses(states, np.stack([spread, sigma], axis=-1), before)


def turns_on_spot(kind: str) -> bool:
    """Whether agents of a type turn on the spot: those without a rear axle."""
    return find_group(kind) in ("pedestrian", "other") and kind != "motorcycle"


def observe_states(
    filtered: TrackMotion, types: tuple[str, ...], sizes: Float[Array, "N 2"], poses: Poses
) -> Float[Array, "N T 4"]:
    """Compute the states that are known at each time.

    Args:
        filtered: motion that knows the detections until each time.
        types: of the agents.
        sizes: lengths and widths, m.
        poses: which hold the heading of a vehicle before it moves.

    Returns:
        The states; NaN where the heading or the speed is not known yet.
    """
    observed = np.full(poses.states.shape, np.nan)
    for agent, kind in enumerate(types):
        here = np.flatnonzero(np.isfinite(filtered.mean[agent, :, 0, 0]))
        path, velocity = filtered.mean[agent, here, 0], filtered.mean[agent, here, 1]
        if turns_on_spot(kind):
            heading = estimate_heading(velocity[None], causal=True)[0]
            speed = np.hypot(*velocity.T)
        else:
            standing = float(poses.standing[agent])
            given = None if np.isnan(standing) else standing
            heading = observe_headings(path, float(sizes[agent, 0]), given)
            speed = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
        states = np.column_stack([path, wrap_angle(heading), speed])
        certain = np.sqrt(filtered.covariance[agent, here, 1, 1]) < MAX_OBSERVED_SPEED_SIGMA
        usable = np.isfinite(heading) & certain
        observed[agent, here[usable]] = states[usable]
    return observed


def _select_present(motion: TrackMotion, agent: int) -> tuple[Bool[Array, " T"], TrackMotion]:
    """Select the times at which an agent is present, and its motion then."""
    here = np.isfinite(motion.mean[agent, :, 0, 0])
    return here, TrackMotion(motion.mean[agent, here], motion.covariance[agent, here])


def _compute_directions(
    motion: TrackMotion, length: float, standing: Float[Array, "2"] | None
) -> tuple[Float[Array, "T"], Float[Array, "T"]]:
    """Directions of the motion of an agent that turns on the spot, and their deviations, rad."""
    velocity = motion.mean[:, 1]
    speed = np.maximum(np.hypot(*velocity.T), 1e-3)
    sigma = np.sqrt(motion.covariance[:, 1, 1]) / speed
    return estimate_heading(velocity[None])[0], np.minimum(sigma, UNKNOWN_SIGMA_RAD)


def _compute_vehicle_headings(
    motion: TrackMotion, length: float, standing: Float[Array, "2"] | None
) -> tuple[Float[Array, "T"], Float[Array, "T"]]:
    """Headings of a vehicle and their standard deviations, rad.

    `standing` has both for the vehicle before it moves. Without it, or where it is uncertain, a
    vehicle drives forward; NaN for one that does not move.
    """
    steps = len(motion.mean)
    given, given_sigma = (np.nan, 0.0) if standing is None else standing.tolist()
    facing = given if given_sigma < UNKNOWN_SIGMA_RAD and standing is not None else None
    headings = compute_headings(motion.mean[:, 0], motion.mean[:, 1], length, facing)
    if headings is None:
        return np.full(steps, given), np.full(steps, given_sigma)
    sigma = np.sqrt(motion.covariance[:, 0, 0]) / (REAR_AXLE_SHARE * length)
    least = UNKNOWN_SIGMA_RAD if given_sigma == UNKNOWN_SIGMA_RAD else 0.0  # its sense is unknown
    return wrap_angle(headings), np.clip(sigma, least, UNKNOWN_SIGMA_RAD)


def _find_heading(
    detections: GroundDetections,
    rows: Int[Array, " m"],
    size: tuple[float, float],
    lanes: Directions | None,
) -> tuple[float, float]:
    """Find the heading of a vehicle that never moves, and its standard deviation, rad."""
    middle = np.median(detections.position[rows], axis=0)
    extent = np.median(detections.extent[rows], axis=0)
    double = np.exp(2j * detections.axis[rows]).mean()
    axis = float(np.angle(double) / 2)
    heading, sigma = find_standing_heading(middle, axis, extent, size, lanes)
    if detections.oriented[rows].all():
        facing = axis if np.cos(heading - axis) >= 0 or sigma == UNKNOWN_SIGMA_RAD else axis + np.pi
        return facing, ORIENTED_SIGMA_RAD if sigma < UNKNOWN_SIGMA_RAD else sigma
    return heading, sigma
