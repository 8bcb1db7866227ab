"""Features by which the WOSAC challenge judges the realism of simulated traffic.

The Waymo Open Sim Agents Challenge is Montali et al. 2023 (arXiv 2305.12032); the definitions are
those of its code of 2024.
"""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.simulation.infractions import Drivable, sample_distance
from geoaim.simulation.kinematics import wrap_angle
from geoaim.simulation.overlap import (
    compute_box_corners,
    compute_box_distance,
    locate_from,
    measure_extents,
)

MAX_TIME_TO_COLLISION_S = 5.0  # also where there is nothing to collide with
# an agent follows another one in front if their headings differ by at most the first angle, and
# their paths overlap by the width, or by less if the headings differ by at most the second angle
MAX_FOLLOWING_ANGLE_RAD, MAX_ALIGNED_ANGLE_RAD = math.radians(75.0), math.radians(10.0)
MIN_FOLLOWING_OVERLAP_M = 0.5
CORNER_ROUNDING = 0.7  # radius of the boxes' rounded corners, as a share of half their width

Features = dict[str, Float[Tensor, "K E T"]]  # features by name; NaN where there is none


def compute_features(
    poses: Float[Tensor, "K N T 3"],
    present: Bool[Tensor, "K N T"],
    sizes: Float[Tensor, "N 2"],
    evaluated: Bool[Tensor, "N"],
    *,
    dt: float,
    drivable: Drivable | None = None,
) -> Features:
    """Compute the features of E evaluated agents in K rollouts of N agents.

    Args:
        poses: x, y, heading; those of absent agents may be NaN.
        present: whether the agent is there.
        sizes: length and width, metres.
        evaluated: the agents whose features are computed.
        dt: time between steps, s.
        drivable: distances from the drivable area; None leaves out the distance to its edge.

    Returns:
        By name: "linear speed" (m/s), "linear acceleration" (m/s²), "angular speed" (rad/s),
        "angular acceleration" (rad/s²), "distance to nearest object" (m, negative in a collision),
        "time to collision" (s) and "distance to road edge" (m, of the corner that is furthest off
        the road, negative on it).
    """
    known, safe = (torch.where(present[..., None], poses, fill) for fill in (torch.nan, 0.0))
    features = compute_kinematics(known[:, evaluated], dt)
    speeds = compute_kinematics(known, dt)["linear speed"]
    nearest, times = [], []
    for sample in range(len(poses)):  # pairs of all samples at once need much memory
        boxes = safe[sample], sizes[:, None]
        pairs = present[sample], evaluated
        nearest.append(measure_nearest_distances(*boxes, *pairs))
        times.append(measure_times_to_collision(*boxes, *pairs, speeds=speeds[sample]))
    features["distance to nearest object"] = torch.stack(nearest)
    features["time to collision"] = torch.stack(times)
    if drivable is not None:
        corners = compute_box_corners(safe[:, evaluated], sizes[evaluated][:, None])
        features["distance to road edge"] = sample_distance(drivable, corners).amax(dim=-1)
    return features


def compute_kinematics(poses: Float[Tensor, "K E T 3"], dt: float) -> Features:
    """Compute speeds and accelerations by central differences over two steps.

    NaN where a neighbouring step is missing: speeds in the first and the last step, accelerations
    in the first two and the last two.
    """
    velocity = _difference(poses[..., :2].transpose(-1, -2))
    speed = velocity.norm(dim=-2) / dt
    # twice the difference is that of two steps, which is the angle to wrap
    turn = wrap_angle(2 * _difference(poses[..., 2])) / 2
    change = wrap_angle(2 * _difference(turn)) / 2
    return {
        "linear speed": speed,
        "linear acceleration": _difference(speed) / dt,
        "angular speed": turn / dt,
        "angular acceleration": change / dt**2,
    }


def measure_nearest_distances(
    poses: Float[Tensor, "N T 3"],
    sizes: Float[Tensor, "N 1 2"],
    present: Bool[Tensor, "N T"],
    evaluated: Bool[Tensor, "N"],
) -> Float[Tensor, "E T"]:
    """Measure signed distances from evaluated agents to the nearest other one that is present.

    Agents are boxes with corners rounded by `CORNER_ROUNDING`.

    Args:
        poses: x, y, heading.
        sizes: length and width, metres.
        present: whether the agent is there.
        evaluated: the agents whose distances are measured.

    Returns:
        Metres between the boxes, negative where they overlap; infinite without another agent.
    """
    radii = CORNER_ROUNDING / 2 * sizes.amin(dim=-1)  # (N, 1)
    cores = sizes - 2 * radii[..., None]
    own = poses[evaluated][:, None], cores[evaluated][:, None]
    distances = compute_box_distance(*own, poses, cores)  # (E, N, T)
    distances = distances - radii[evaluated][:, None] - radii
    others = ~torch.eye(len(poses), dtype=torch.bool, device=poses.device)[evaluated]
    valid = present & present[evaluated][:, None] & others[..., None]
    return torch.where(valid, distances, torch.inf).amin(dim=1)


def measure_times_to_collision(
    poses: Float[Tensor, "N T 3"],
    sizes: Float[Tensor, "N 1 2"],
    present: Bool[Tensor, "N T"],
    evaluated: Bool[Tensor, "N"],
    *,
    speeds: Float[Tensor, "N T"],
) -> Float[Tensor, "E T"]:
    """Measure the times after which evaluated agents would reach the agents that they follow.

    The agent that is followed is the nearest one ahead whose heading and path fit. Differences
    of headings are not wrapped at pi, as in the challenge's code.

    Args:
        poses: x, y, heading.
        sizes: length and width, metres.
        present: whether the agent is there.
        evaluated: the agents whose times are measured.
        speeds: m/s.

    Returns:
        Seconds at constant speeds, at most `MAX_TIME_TO_COLLISION_S`, which is also the time
        without an agent to follow.
    """
    own_poses, own_sizes = poses[evaluated][:, None], sizes[evaluated][:, None]
    located = locate_from(own_poses, poses)  # (E, N, T, 3)
    angle = located[..., 2].abs()
    reach = own_sizes / 2 + measure_extents(angle, sizes)
    ahead = located[..., 0] - reach[..., 0]
    beside = located[..., 1].abs() - reach[..., 1]
    fits = (beside < -MIN_FOLLOWING_OVERLAP_M) | (angle <= MAX_ALIGNED_ANGLE_RAD)
    follows = (ahead > 0) & (angle <= MAX_FOLLOWING_ANGLE_RAD) & (beside < 0) & fits & present
    distance, leader = torch.where(follows, ahead, torch.inf).min(dim=1)  # (E, T)
    approach = speeds[evaluated] - speeds.gather(0, leader)
    time = torch.where(approach > 0, distance / approach, MAX_TIME_TO_COLLISION_S)
    return time.clamp_max(MAX_TIME_TO_COLLISION_S)


def _difference(values: Float[Tensor, "*n T"]) -> Float[Tensor, "*n T"]:
    """Half the difference between the next step and the last one; NaN at both ends."""
    end = torch.full_like(values[..., :1], torch.nan)
    return torch.cat([end, (values[..., 2:] - values[..., :-2]) / 2, end], dim=-1)
