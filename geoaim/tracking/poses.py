"""Poses of agents: headings and signed speeds from their motion, and their uncertainty."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.base.geometry import wrap_angle
from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.headings import (
    MIN_FORWARD_M,
    MIN_MOVE_M,
    MOVING_SPEED,
    REAR_AXLE_SHARE,
    compute_headings,
    observe_headings,
)
from geoaim.tracking.kalman import TrackMotion, TrackRows
from geoaim.tracking.sizes import AgentTraits
from geoaim.tracking.standing import (
    LANE_SIGMA_RAD,
    LINE_SIGMA_RAD,
    UNKNOWN_SIGMA_RAD,
    Directions,
    Standing,
    find_standing,
)
from geoaim.tracks.agent_types import find_group
from geoaim.tracks.tracks import estimate_heading

MAX_REVERSE_SPEED = 3.5  # m/s; a faster vehicle drives forward
# by which errors of the middle turn a vehicle: its axle averages them, and a stop keeps one. Of
# what stands on lanes (validation seeds 900, 910), 90 % then lie in their 95 % range where errors
# last for 1.5 s (83 and 87 % with 1.7), 91 and 96 % where they last for 3 s, all of plain boxes
MOVING_SHARE, STILL_SHARE = 0.75, 2.2


@dataclass(frozen=True, eq=False)
class Poses:
    """States of agents, a row for each agent and step."""

    states: Float[Array, "S 4"]  # x, y, heading, speed
    uncertainty: Float[Array, "S 2"]  # standard deviations of a coordinate (m), heading (rad)


def compute_poses(
    smoothed: TrackMotion,
    rows: TrackRows,
    agents: AgentTraits,
    detections: GroundDetections,
    lanes: Directions | None,
    forward: float,
) -> Poses:
    """Compute headings and speeds from smoothed motion.

    Lanes tell those of vehicles that stand, or boxes, whose first sides are fronts with a
    probability `forward`.
    """
    heading, sigma = np.empty(len(rows.step)), np.empty(len(rows.step))
    turning = np.array([turns_on_spot(kind) for kind in agents.types], bool)
    for agent, part in enumerate(rows.list_parts()):
        motion = TrackMotion(smoothed.mean[part], smoothed.covariance[part])
        if turning[agent]:
            heading[part], sigma[part] = _compute_directions(motion)
            continue
        seen = rows.detection[part]
        stands = find_standing(detections, seen[seen >= 0], agents.types[agent], lanes)
        standing, unsure = stands.face(np.array([forward]))
        length = float(agents.sizes[agent, 0])
        given = float(standing[0]), float(unsure[0])
        found = _compute_vehicle_headings(motion, length, given, seen >= 0)
        heading[part], sigma[part] = found
    velocity = smoothed.mean[:, 1]
    speed = np.where(
        turning[rows.agent],
        np.hypot(*velocity.T),
        velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading),
    )
    states = np.column_stack([smoothed.mean[:, 0], heading, speed])
    spread = np.sqrt(smoothed.covariance[:, 0, 0])
    return Poses(states, np.column_stack([spread, sigma]))


def turns_on_spot(kind: str) -> bool:
    """Whether agents of a type turn on the spot: those without a rear axle."""
    return find_group(kind) in ("pedestrian", "other") and kind != "motorcycle"


def observe_states(
    filtered: TrackMotion,
    rows: TrackRows,
    agents: AgentTraits,
    standing: list[Standing],
    forward: Float[Array, "T"],
) -> Float[Array, "S 5"]:
    """Compute the states that are known at each time, and the deviations of their speeds, m/s.

    The motion knows the detections until each time. `standing` tells each vehicle's heading before
    it moves, and `forward` how far its boxes do at each step; while its sense is not known, the
    speed is NaN.
    """
    observed = np.full((len(rows.step), 5), np.nan)
    for agent, part in enumerate(rows.list_parts()):
        path, velocity = filtered.mean[part, 0], filtered.mean[part, 1]
        if turns_on_spot(agents.types[agent]):
            heading = estimate_heading(velocity[None], causal=True)[0]
            speed = np.hypot(*velocity.T)
        else:
            stands = standing[agent]
            given = stands.heading if stands.sigma <= LANE_SIGMA_RAD else None
            heading = observe_headings(path, float(agents.sizes[agent, 0]), given)
            facing, unsure = stands.face(forward[rows.step[part]])
            unmoved = np.isnan(heading)
            heading = np.where(unmoved, facing, heading)
            speed = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
            speed[unmoved & (unsure >= LINE_SIGMA_RAD)] = np.nan
        sigma = np.where(np.isnan(speed), np.nan, np.sqrt(filtered.covariance[part, 1, 1]))
        observed[part] = np.column_stack([path, wrap_angle(heading), speed, sigma])
    return observed


def _compute_directions(motion: TrackMotion) -> tuple[Float[Array, "T"], Float[Array, "T"]]:
    """Directions of the motion of an agent that turns on the spot, and their deviations, rad."""
    velocity = motion.mean[:, 1]
    speed = np.maximum(np.hypot(*velocity.T), 1e-3)
    sigma = np.sqrt(motion.covariance[:, 1, 1]) / speed
    return estimate_heading(velocity[None])[0], np.minimum(sigma, UNKNOWN_SIGMA_RAD)


def _compute_vehicle_headings(
    motion: TrackMotion, length: float, standing: tuple[float, float], seen: Bool[Array, "T"]
) -> tuple[Float[Array, "T"], Float[Array, "T"]]:
    """Headings of a vehicle and their standard deviations, rad.

    `standing` has both for the vehicle before it moves. A vehicle that drives faster than
    `MAX_REVERSE_SPEED` where it is seen drives forward; where a slower one moves, its sense is that
    of its lane. The front of its box is wrong more often than vehicles reverse.
    """
    path, velocity = motion.mean[:, 0], motion.mean[:, 1]
    fast = path[seen & (np.hypot(*velocity.T) > MAX_REVERSE_SPEED)]
    forward = len(fast) > 0 and np.hypot(*np.ptp(fast, axis=0)) > MIN_FORWARD_M
    known = standing[1] <= LANE_SIGMA_RAD
    headings = None
    if np.hypot(*np.ptp(path, axis=0)) > MIN_MOVE_M:
        headings = compute_headings(path, velocity, length, standing[0] if known else None)
    if headings is None:
        return np.full(len(path), standing[0]), np.full(len(path), standing[1])
    if forward and (velocity[:, 0] @ np.cos(headings) + velocity[:, 1] @ np.sin(headings)) < 0:
        turned = compute_headings(path, velocity, length, None)  # a lane of the other way
        headings = headings if turned is None else turned
    sigma = find_heading_errors(np.sqrt(motion.covariance[:, 0, 0]), np.hypot(*velocity.T), length)
    least = 0.0 if forward or known else LINE_SIGMA_RAD
    return wrap_angle(headings), np.clip(sigma, least, UNKNOWN_SIGMA_RAD)


def find_heading_errors(
    error: Float[Array, "n"], speed: Float[Array, "n"], length: float | Float[Array, "n"]
) -> Float[Array, "n"]:
    """Find by how much errors of a vehicle's middle (standard deviations, m) turn it, rad.

    It depends on its speed (m/s), and its length (m).
    """
    share = np.where(np.abs(speed) > MOVING_SPEED, MOVING_SHARE, STILL_SHARE)
    return share * error / np.maximum(REAR_AXLE_SHARE * length, 0.1)
