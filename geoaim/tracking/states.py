"""States of agents: associated detections -> smoothed and observed states, sizes and types."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.base.world import World
from geoaim.tracking.association import CUT_SIGMA_M, MIN_HITS, Tracklets
from geoaim.tracking.cut_boxes import complete_cut_boxes
from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.joining import find_false_ends, join_tracks
from geoaim.tracking.kalman import TrackMotion, TrackRows, filter_tracks, make_rows, smooth_tracks
from geoaim.tracking.noise import estimate_lasting_noise, estimate_noise
from geoaim.tracking.poses import Poses, compute_poses, find_heading_errors, observe_states
from geoaim.tracking.sizes import (
    EFFECTIVE_BOXES,
    SIZE_SIGMA,
    AgentTraits,
    estimate_size,
    get_typical_size,
    vote_type,
)
from geoaim.tracking.standing import LINE_SIGMA_RAD, Directions, find_standing, learn_forward
from geoaim.tracks.tracks import Tracks

MIN_WHOLE_BOXES = 5  # that tell a size; fewer may be of something else
LASTING_TURN = 0.6  # share of a lasting error that changes while the rear axle is pulled along
COMPLETED_SIGMA_M = 0.2  # of one that has been completed by the agent's size


def make_states(
    detections: GroundDetections,
    tracklets: Tracklets,
    times: Float[Array, "T"],
    world: World,
    lanes: Directions | None = None,
) -> Tracks:
    """Make the states of agents from their detections, smoothed and as observed at each time.

    What was observed is filtered as the frames came. Then tracks of one agent are joined, and the
    middle of each agent moves at constant velocity but for white noise in its acceleration; a first
    pass gives headings, by these sizes, and by these the middles of boxes that the frame's border
    cuts off, which a second pass uses. Lanes tell the headings of vehicles that never move, or
    the fronts of their boxes, as often as those of other vehicles point to where these drive.
    """
    forward = learn_forward(detections, tracklets.track, len(times))
    rows, track, observed = _observe(detections, tracklets, times, lanes, forward)
    at = np.zeros(len(track), int)  # the row of each detection; any of one that is left out
    at[rows.detection[rows.detection >= 0]] = np.flatnonzero(rows.detection >= 0)
    noise = estimate_noise(detections, track, times)
    sigma = noise * detections.resolution
    cut = detections.may_be_cut
    seen = _list_detections(rows)
    agents = _describe_agents(detections, seen)
    smoothed = _smooth(detections.position, np.where(cut, CUT_SIGMA_M, sigma), rows, times, agents)
    heading = compute_poses(smoothed, rows, agents, detections, lanes, float(forward[-1])).states[
        at, 2
    ]
    del smoothed  # what long videos would fill the memory with
    agents = _describe_agents(detections, seen, heading - detections.axis)
    agents, size_sigma = _estimate_sizes(agents, heading, detections, seen, sigma)
    position = complete_cut_boxes(detections, track, heading, agents.sizes)
    sigma = np.where(cut, np.hypot(COMPLETED_SIGMA_M, sigma), sigma)
    again = _smooth(position, sigma, rows, times, agents)
    del position, sigma
    poses = compute_poses(again, rows, agents, detections, lanes, float(forward[-1]))
    del again
    lasting = _measure_lasting(detections, agents.sizes[track], poses.states[at, 2], noise)
    lasting = np.hypot(lasting, detections.roof_sigma)
    _add_lasting(poses, rows, agents, (lasting, np.where(cut, size_sigma[track] / 2, 0.0)))
    found = {
        "states": poses.states,
        "observed": observed[:, :4],
        "observed_sigma": observed[:, 4],
        "seen": rows.detection >= 0,
        "uncertainty": poses.uncertainty,
    }
    present = np.zeros((len(agents.types), len(times)), bool)
    present[rows.agent, rows.step] = True
    return Tracks.from_rows(
        present,
        found,
        times=times,
        sizes=agents.sizes,
        types=agents.types,
        ids=tuple(str(number + 1) for number in range(len(agents.types))),
        world=world,
    )


def _observe(
    detections: GroundDetections,
    tracklets: Tracklets,
    times: Float[Array, "T"],
    lanes: Directions | None,
    forward: Float[Array, "T"],
) -> tuple[TrackRows, Int[Array, "M"], Float[Array, "S 5"]]:
    """What was known as the frames came, in rows of joined tracks, with each detection's agent.

    From a track's confirmation on, its type, size and first heading stay those of its first boxes.
    False boxes where tracks are joined belong to none, -1.
    """
    rows = make_rows(tracklets.track, detections.step)
    seen = _list_detections(rows)
    early = [part[:MIN_HITS] for part in seen]
    early = [
        part[detections.step[part] <= step]
        for part, step in zip(early, tracklets.confirmed.tolist(), strict=True)
    ]
    agents = _describe_agents(detections, early)
    standing = [
        find_standing(detections, part, kind, lanes)
        for part, kind in zip(early, agents.types, strict=True)
    ]
    measured = detections.position[rows.detection], tracklets.sigma[rows.detection]
    noise = agents.acceleration_noise
    filtered = filter_tracks(times, rows, *measured, noise)
    observed = observe_states(filtered, rows, agents, standing, forward)
    observed[rows.step < tracklets.confirmed[rows.agent]] = np.nan
    smoothed = smooth_tracks(times, rows, filtered, noise)
    types = _describe_agents(detections, seen).types
    false = find_false_ends(smoothed, rows, detections, tracklets.sigma, times)
    agent = join_tracks(smoothed, rows, types, detections, times, false)
    joined = make_rows(agent[tracklets.track], detections.step)
    placed = np.full((len(joined.step), 5), np.nan)
    start = joined.bounds[agent[rows.agent]]
    known = np.isfinite(observed[:, 0])
    placed[(start + rows.step - joined.step[start])[known]] = observed[known]
    # an agent's own first and last detection stay: what comes after might tell that they are right
    false[joined.detection[np.concatenate([joined.bounds[:-1], joined.bounds[1:] - 1])]] = False
    used = np.where((joined.detection >= 0) & ~false[joined.detection], joined.detection, -1)
    track = np.where(false, -1, agent[tracklets.track])
    return replace(joined, detection=used), track, placed


def _list_detections(rows: TrackRows) -> list[Int[Array, "_"]]:
    """List the detections of each agent."""
    parts = (rows.detection[part] for part in rows.list_parts())
    return [part[part >= 0] for part in parts]


def _describe_agents(
    detections: GroundDetections, seen: list[Int[Array, "_"]], turn: Float[Array, "M"] | None = None
) -> AgentTraits:
    """Describe agents by the types of their detections, with the sizes that are typical of them."""
    cut = detections.may_be_cut
    types = []
    for part in seen:
        whole = part[~cut[part]]
        used = whole if len(whole) else part  # boxes that may be cut off tell no size
        turns = None if turn is None else turn[used]
        pixel = float(np.median(detections.resolution[used])) if len(used) else 0.0
        named = detections.types[part].tolist()
        types.append(vote_type(named, detections.extent[used], turns, resolution=pixel))
    typical = np.array([get_typical_size(kind) for kind in types]).reshape(-1, 2)
    return AgentTraits(tuple(types), typical)


def _smooth(
    position: Float[Array, "M 2"],
    sigma: Float[Array, "M"],
    rows: TrackRows,
    times: Float[Array, "T"],
    agents: AgentTraits,
) -> TrackMotion:
    """Estimate the smoothed motion of all agents."""
    noise = agents.acceleration_noise
    # a row without a detection takes the last one, which is not used
    measured = position[rows.detection], sigma[rows.detection]
    filtered = filter_tracks(times, rows, *measured, noise)
    return smooth_tracks(times, rows, filtered, noise)


def _estimate_sizes(
    agents: AgentTraits,
    headings: Float[Array, "M"],
    detections: GroundDetections,
    seen: list[Int[Array, "_"]],
    sigma: Float[Array, "M"],
) -> tuple[AgentTraits, Float[Array, "N"]]:
    """Estimate sizes from whole boxes by these headings, and how far off the lengths may be, m."""
    sizes, off = agents.sizes.copy(), SIZE_SIGMA * agents.sizes[:, 0]
    whole = ~detections.may_be_cut & (detections.extent.min(axis=1) > 0)
    for agent, part in enumerate(seen):
        used = part[whole[part]]
        if len(used) >= MIN_WHOLE_BOXES:
            turn = headings[used] - detections.axis[used]
            side_sigma = 2 * float(np.median(sigma[used]))
            extent = detections.extent[used]
            sizes[agent] = estimate_size(extent, turn, side_sigma, agents.types[agent])
            off[agent] = 2 * side_sigma / np.sqrt(min(len(used), EFFECTIVE_BOXES))
    return AgentTraits(agents.types, sizes), off


def _measure_lasting(
    detections: GroundDetections,
    sizes: Float[Array, "M 2"],
    headings: Float[Array, "M"],
    noise: float,
) -> Float[Array, "M"]:
    """Measure errors of the middles that last, by how extents scatter about what they should be."""
    whole = np.flatnonzero(~detections.may_be_cut)
    whole = whole[:: len(whole) // 100_000 + 1]  # enough boxes tell them
    turn = headings[whole] - detections.axis[whole]
    cosine, sine = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    length, width = sizes[whole].T
    should = np.column_stack([cosine * length + sine * width, sine * length + cosine * width])
    residual = detections.extent[whole] - should
    lasting = estimate_lasting_noise(residual, detections.resolution[whole], noise)
    return lasting * detections.resolution


def _add_lasting(
    poses: Poses,
    rows: TrackRows,
    agents: AgentTraits,
    errors: tuple[Float[Array, "M"], Float[Array, "M"]],
) -> None:
    """Add errors that last to the uncertainty: of the boxes, and of those that are completed."""
    steps = np.arange(len(rows.step))
    last = rows.detection[np.maximum.accumulate(np.where(rows.detection >= 0, steps, 0))]
    error = np.hypot(*errors)[last]
    poses.uncertainty[:, 0] = np.hypot(poses.uncertainty[:, 0], error)
    known = poses.uncertainty[:, 1] < LINE_SIGMA_RAD
    length, speed = agents.sizes[rows.agent[known], 0], poses.states[known, 3]
    drift = find_heading_errors(LASTING_TURN * error[known], speed, length)
    poses.uncertainty[known, 1] = np.minimum(np.hypot(poses.uncertainty[known, 1], drift), np.pi)
