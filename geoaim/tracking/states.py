"""States of agents: associated detections -> smoothed and observed states, sizes and types."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.base.world import World
from geoaim.tracking.cut_boxes import complete_cut_boxes
from geoaim.tracking.ground_detections import GroundDetections, select_detections
from geoaim.tracking.kalman import START_SPEED_SIGMA, TrackMotion, filter_tracks, smooth_tracks
from geoaim.tracking.noise import estimate_noise
from geoaim.tracking.poses import Poses, compute_poses, observe_states
from geoaim.tracking.sizes import estimate_size, vote_type
from geoaim.tracking.standing import Directions
from geoaim.tracks.agent_types import find_group
from geoaim.tracks.tracks import Tracks

# spectral density of the acceleration by group, m²/s³; chosen on validation videos
ACCELERATION_NOISE = {"vehicle": 1.0, "pedestrian": 0.15, "cyclist": 0.5, "other": 0.5}
CUT_SIGMA_M = 1.5  # of the middle of a box that the frame's border may cut off
MIN_WHOLE_BOXES = 5  # that tell a size; fewer may be of something else
COMPLETED_SIGMA_M = 0.2  # of one that has been completed by the agent's size


@dataclass(frozen=True, eq=False)
class AgentTraits:
    """What is the same for an agent at all times; N agents."""

    types: tuple[str, ...]
    sizes: Float[Array, "N 2"]  # length and width, m

    @property
    def acceleration_noise(self) -> Float[Array, "N"]:
        """Spectral densities of the accelerations, m²/s³."""
        return np.array([ACCELERATION_NOISE[find_group(kind)] for kind in self.types])


def make_states(
    detections: GroundDetections,
    track: Int[Array, "M"],
    times: Float[Array, "T"],
    world: World,
    lanes: Directions | None = None,
) -> Tracks:
    """Make the states of agents from their detections, smoothed and as observed at each time.

    The middle of each agent moves at constant velocity but for white noise in its acceleration;
    a first pass gives headings, by these sizes, and by these the middles of boxes that the frame's
    border cuts off, which a second pass uses.

    Args:
        detections: detections of all frames.
        track: number of each detection's agent, from 0; -1 for none.
        times: of the frames, s.
        world: the plane of the positions.
        lanes: directions of lanes, for vehicles that never move; None: not known.

    Returns:
        The tracks, from each agent's first detection to its last.
    """
    kept = np.flatnonzero(track >= 0)
    detections, track = select_detections(detections, kept), track[kept]
    row = np.full((track.max(initial=-1) + 1, len(times)), -1)
    row[track, detections.step] = np.arange(len(track))
    sigma = estimate_noise(detections, track) * detections.resolution
    cut = detections.cut.any(axis=(1, 2))
    types = tuple(_vote(detections, np.flatnonzero(track == n)) for n in range(len(row)))
    agents = AgentTraits(types, np.ones((len(row), 2)))
    first = np.where(cut, CUT_SIGMA_M, sigma)
    _, smoothed = _estimate_motion(detections.position, first, row, times, agents)
    agents = _estimate_sizes(agents, smoothed, detections, row, sigma)
    poses = compute_poses(smoothed, agents.types, agents.sizes, detections, row, lanes)
    position = complete_cut_boxes(detections, track, poses.headings, agents.sizes)
    second = np.where(cut, np.hypot(COMPLETED_SIGMA_M, sigma), sigma)
    filtered, smoothed = _estimate_motion(position, second, row, times, agents)
    poses = compute_poses(smoothed, agents.types, agents.sizes, detections, row, lanes)
    return _collect_tracks(poses, filtered, agents, row, times, world)


def _vote(detections: GroundDetections, rows: Int[Array, " m"]) -> str:
    """Vote on the type of an agent; boxes that may be cut off tell no size if others do."""
    whole = rows[~detections.cut[rows].any(axis=(1, 2))]
    extent = detections.extent[whole if len(whole) else rows]
    return vote_type(detections.types[rows].tolist(), extent)


def _estimate_motion(
    position: Float[Array, "M 2"],
    sigma: Float[Array, "M"],
    row: Int[Array, "N T"],
    times: Float[Array, "T"],
    agents: AgentTraits,
) -> tuple[TrackMotion, TrackMotion]:
    """Estimate the filtered and the smoothed motion of all agents."""
    seen = row >= 0
    positions = np.where(seen[..., None], position[row], np.nan)
    sigmas = np.where(seen, sigma[row], np.nan)
    noise = agents.acceleration_noise
    filtered = filter_tracks(times, positions, sigmas, noise, speed_sigma=START_SPEED_SIGMA)
    return filtered, smooth_tracks(times, filtered, noise)


def _estimate_sizes(
    agents: AgentTraits,
    smoothed: TrackMotion,
    detections: GroundDetections,
    row: Int[Array, "N T"],
    sigma: Float[Array, "M"],
) -> AgentTraits:
    """Estimate sizes from whole boxes, with the headings that a typical size gives."""
    typical = np.array([estimate_size(np.empty((0, 2)), np.empty(0), 1.0, k) for k in agents.types])
    poses = compute_poses(smoothed, agents.types, typical.reshape(-1, 2), detections, row, None)
    sizes = typical.reshape(-1, 2).copy()
    whole = ~detections.cut.any(axis=(1, 2)) & (detections.extent.min(axis=1) > 0)
    for agent in range(len(row)):
        steps = np.flatnonzero(row[agent] >= 0)
        steps = steps[whole[row[agent, steps]]]
        used = row[agent, steps]
        if len(used) >= MIN_WHOLE_BOXES:
            turn = poses.headings[agent, steps] - detections.axis[used]
            side_sigma = 2 * float(np.median(sigma[used]))
            extent = detections.extent[used]
            sizes[agent] = estimate_size(extent, turn, side_sigma, agents.types[agent])
    return replace(agents, sizes=sizes)


def _collect_tracks(
    poses: Poses,
    filtered: TrackMotion,
    agents: AgentTraits,
    row: Int[Array, "N T"],
    times: Float[Array, "T"],
    world: World,
) -> Tracks:
    present = np.isfinite(poses.states[..., 0])
    return Tracks(
        times=times,
        states=poses.states,
        present=present,
        sizes=agents.sizes,
        types=agents.types,
        ids=tuple(str(number + 1) for number in range(len(row))),
        world=world,
        observed=observe_states(filtered, agents.types, agents.sizes, poses),
        seen=row >= 0,
        uncertainty=poses.uncertainty,
    )
