"""States of agents: associated detections -> smoothed and observed states, sizes and types."""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.base.world import World
from geoaim.tracking.cut_boxes import complete_cut_boxes
from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.kalman import TrackMotion, TrackRows, filter_tracks, make_rows, smooth_tracks
from geoaim.tracking.noise import estimate_noise
from geoaim.tracking.poses import compute_poses, observe_states
from geoaim.tracking.sizes import AgentTraits, estimate_size, get_typical_size, vote_type
from geoaim.tracking.standing import Directions
from geoaim.tracks.tracks import Tracks

CUT_SIGMA_M = 1.5  # of the middle of a box that the frame's border may cut off
MIN_WHOLE_BOXES = 5  # that tell a size; fewer may be of something else
COMPLETED_SIGMA_M = 0.2  # of one that has been completed by the agent's size


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
        detections: detections of agents.
        track: number of each detection's agent, from 0.
        times: of the frames, s.
        world: the plane of the positions.
        lanes: directions of lanes, for vehicles that never move; None: not known.

    Returns:
        The tracks, from each agent's first detection to its last.
    """
    rows = make_rows(track, detections.step)
    at = np.empty(len(track), int)  # the row of each detection
    at[rows.detection[rows.detection >= 0]] = np.flatnonzero(rows.detection >= 0)
    sigma = estimate_noise(detections, track) * detections.resolution
    cut = detections.cut.any(axis=(1, 2))
    of_agent = [rows.detection[part][rows.detection[part] >= 0] for part in rows.list_parts()]
    types = tuple(_vote(detections, seen) for seen in of_agent)
    typical = np.array([get_typical_size(kind) for kind in types]).reshape(-1, 2)
    agents = AgentTraits(types, typical)
    first = np.where(cut, CUT_SIGMA_M, sigma)
    smoothed = _estimate_motion(detections.position, first, rows, times, agents)[1]
    heading = compute_poses(smoothed, rows, agents, detections, None).states[at, 2]
    sizes = _estimate_sizes(agents, heading, detections, of_agent, sigma)
    agents = AgentTraits(types, sizes)
    heading = compute_poses(smoothed, rows, agents, detections, lanes).states[at, 2]
    position = complete_cut_boxes(detections, track, heading, sizes)
    del smoothed
    second = np.where(cut, np.hypot(COMPLETED_SIGMA_M, sigma), sigma)
    filtered, smoothed = _estimate_motion(position, second, rows, times, agents)
    poses = compute_poses(smoothed, rows, agents, detections, lanes)
    present = np.zeros((len(types), len(times)), bool)
    present[rows.agent, rows.step] = True
    found = {
        "states": poses.states,
        "observed": observe_states(filtered, rows, agents, poses),
        "seen": rows.detection >= 0,
        "uncertainty": poses.uncertainty,
    }
    return Tracks.from_rows(
        present,
        found,
        times=times,
        sizes=sizes,
        types=types,
        ids=tuple(str(number + 1) for number in range(len(types))),
        world=world,
    )


def _vote(detections: GroundDetections, rows: Int[Array, " m"]) -> str:
    """Vote on the type of an agent; boxes that may be cut off tell no size if others do."""
    whole = rows[~detections.cut[rows].any(axis=(1, 2))]
    extent = detections.extent[whole if len(whole) else rows]
    return vote_type(detections.types[rows].tolist(), extent)


def _estimate_motion(
    position: Float[Array, "M 2"],
    sigma: Float[Array, "M"],
    rows: TrackRows,
    times: Float[Array, "T"],
    agents: AgentTraits,
) -> tuple[TrackMotion, TrackMotion]:
    """Estimate the filtered and the smoothed motion of all agents."""
    noise = agents.acceleration_noise
    # a row without a detection takes the last one, which is not used
    measured = position[rows.detection], sigma[rows.detection]
    filtered = filter_tracks(times, rows, *measured, noise)
    return filtered, smooth_tracks(times, rows, filtered, noise)


def _estimate_sizes(
    agents: AgentTraits,
    headings: Float[Array, "M"],
    detections: GroundDetections,
    of_agent: list[Int[Array, " m"]],
    sigma: Float[Array, "M"],
) -> Float[Array, "N 2"]:
    """Estimate sizes from whole boxes, with the headings that a typical size gives."""
    sizes = agents.sizes.copy()
    whole = ~detections.cut.any(axis=(1, 2)) & (detections.extent.min(axis=1) > 0)
    for agent, seen in enumerate(of_agent):
        used = seen[whole[seen]]
        if len(used) >= MIN_WHOLE_BOXES:
            turn = headings[used] - detections.axis[used]
            side_sigma = 2 * float(np.median(sigma[used]))
            extent = detections.extent[used]
            sizes[agent] = estimate_size(extent, turn, side_sigma, agents.types[agent])
    return sizes
