"""Infractions: which agents are off the road, run a red light or drive the wrong way.

Collisions are overlaps of boxes, in `overlap`. All functions are batched. Absent agents commit no
infraction.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.lights import RED
from geoaim.simulation.ground import apply_matrix
from geoaim.simulation.overlap import compute_box_corners, cross

WRONG_WAY_ANGLE_RAD = 2.0  # at which a heading differs too much from a lane's direction


@dataclass(frozen=True, eq=False)
class Drivable:
    """Signed distances from the edge of the drivable area, as a raster."""

    # metres at the centres of the pixels: positive outside, negative inside
    distance: Float[Tensor, "H W"]
    grid_from_world: Float[Tensor, "2 3"]  # metres to pixels (corner origin)


@dataclass(frozen=True, eq=False)
class Lanes:
    """Directions of one-way lanes, sampled at M points along their centre lines."""

    points: Float[Tensor, "M 2"]  # metres
    directions: Float[Tensor, "M"]  # radians
    radii: Float[Tensor, "M"]  # metres around a point within which an agent is on its lane


def compute_offroad_distance(
    drivable: Drivable,
    poses: Float[Tensor, "... 3"],
    sizes: Float[Tensor, "... 2"],
    present: Bool[Tensor, "..."],
) -> Float[Tensor, "..."]:
    """Compute how far the furthest corner of each agent is off the road; differentiable.

    Args:
        drivable: signed distances; beyond the raster, the distance to the raster is added.
        poses: (..., 3) x, y, heading.
        sizes: (..., 2) length and width, metres.
        present: (...); poses of absent agents may be NaN.

    Returns:
        (...) metres, 0 on the road and for absent agents.
    """
    safe = torch.where(present[..., None], poses, 0.0)
    corners = compute_box_corners(safe, sizes)
    outside = sample_distance(drivable, corners).amax(dim=-1).clamp_min(0)
    return torch.where(present, outside, 0.0)


def detect_offroad(
    drivable: Drivable,
    poses: Float[Tensor, "... 3"],
    sizes: Float[Tensor, "... 2"],
    present: Bool[Tensor, "..."],
) -> Bool[Tensor, "..."]:
    """Mark agents of which a corner is off the road, without a tolerance, as in Liu et al. 2023.

    Args:
        drivable: signed distances.
        poses: (..., 3) x, y, heading.
        sizes: (..., 2) length and width, metres.
        present: (...); poses of absent agents may be NaN.

    Returns:
        (...) True for those off the road.
    """
    return compute_offroad_distance(drivable, poses, sizes, present) > 0


def sample_distance(drivable: Drivable, points: Float[Tensor, "... 2"]) -> Float[Tensor, "..."]:
    """Interpolate signed distances to the edge of the drivable area, metres.

    Beyond the raster it is the distance at the raster's nearest point, plus that to this point.
    """
    height, width = drivable.distance.shape
    matrix = drivable.grid_from_world
    pixels = apply_matrix(matrix[:, :2].to(points), points) + matrix[:, 2].to(points)
    size = pixels.new_tensor([width, height])
    grid = (pixels * (2 / size) - 1).reshape(1, 1, -1, 2)  # grid_sample: -1 to 1
    raster = drivable.distance[None, None]
    distance = F.grid_sample(raster, grid.to(raster), padding_mode="border", align_corners=False)
    offset = pixels - torch.minimum(pixels.clamp_min(0), size)
    beyond = offset.abs().sum(-1) > 0
    scale = torch.linalg.det(matrix[:, :2].double()).abs().sqrt().to(points)
    extra = torch.where(beyond[..., None], offset, 1.0).norm(dim=-1) / scale
    return distance.to(points).view(points.shape[:-1]) + torch.where(beyond, extra, 0.0)


def detect_red_light_running(
    last_poses: Float[Tensor, "B A 3"],
    poses: Float[Tensor, "B A 3"],
    lengths: Float[Tensor, "B A"],
    present: Bool[Tensor, "B A"],
    stop_lines: Float[Tensor, "... L 2 2"],
    states: Int[Tensor, "B L"],
) -> Bool[Tensor, "B A"]:
    """Mark agents whose front crosses a stop line in a step while its light is red.

    Args:
        last_poses: (B, A, 3) x, y, heading at the start of the step.
        poses: (B, A, 3) at its end.
        lengths: (B, A) of the agents, metres.
        present: (B, A) agents present at both.
        stop_lines: (L, 2, 2) or (B, L, 2, 2) both ends of each line, metres.
        states: (B, L) of the lights, as in `geoaim.lights`.

    Returns:
        (B, A) True for those that run a red light in this step.
    """
    start = _locate_fronts(last_poses, lengths)[:, :, None]  # (B, A, 1, 2)
    end = _locate_fronts(poses, lengths)[:, :, None]
    lines = stop_lines.expand(len(states), *stop_lines.shape[-3:])[:, None]
    first, second = lines[..., 0, :], lines[..., 1, :]  # (B, 1, L, 2)
    side, next_side = cross(second - first, start - first), cross(second - first, end - first)
    crosses_line = (side * next_side <= 0) & (side != next_side)
    path = end - start
    between_ends = cross(path, first - start) * cross(path, second - start) <= 0
    red = (states == RED)[:, None]
    return (crosses_line & between_ends & red).any(-1) & present


def detect_wrong_way(
    lanes: Lanes, poses: Float[Tensor, "... 3"], present: Bool[Tensor, "..."]
) -> tuple[Bool[Tensor, "..."], Bool[Tensor, "..."]]:
    """Mark agents whose heading follows none of the one-way lanes that they are on.

    Args:
        lanes: directions of one-way lanes.
        poses: (..., 3) x, y, heading.
        present: (...).

    Returns:
        (...) agents that drive the wrong way; (...) agents on any one-way lane, which could.
    """
    safe = torch.where(present[..., None], poses, 0.0).reshape(-1, 3)
    exact = "donot_use_mm_for_euclid_dist"  # matrix products are inexact far from the origin
    distances = torch.cdist(safe[:, :2], lanes.points.to(safe), compute_mode=exact)
    matches = distances < lanes.radii  # (n, M)
    follows = torch.cos(safe[:, 2:] - lanes.directions) > math.cos(WRONG_WAY_ANGLE_RAD)
    on_lane = matches.any(dim=1)
    wrong = on_lane & ~(matches & follows).any(dim=1)
    return wrong.view(present.shape) & present, on_lane.view(present.shape) & present


def _locate_fronts(
    poses: Float[Tensor, "... 3"], lengths: Float[Tensor, "..."]
) -> Float[Tensor, "... 2"]:
    forward = torch.stack([poses[..., 2].cos(), poses[..., 2].sin()], dim=-1)
    return poses[..., :2] + forward * lengths[..., None] / 2
