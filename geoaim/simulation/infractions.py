"""Infractions: which agents collide, are off the road, run a red light or drive the wrong way.

All functions are batched. Absent agents commit no infraction; a present agent without a finite pose
raises ValueError.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.rendering.ground import apply_matrix, compute_resolutions
from geoaim.simulation.overlap import box_iou, check_poses, compute_box_corners, cross
from geoaim.tracks.lights import RED

# a vehicle whose furthest corner is within this distance of the drivable area counts as on the
# road. Vehicles of synthetic recordings leave their lanes by up to 0.4 m
# (`benchmarks.simulation.policies`); the raster of distances is off by up to 0.15 m
OFFROAD_TOLERANCE_M = 0.5
WRONG_WAY_ANGLE_RAD = 2.0  # a heading that differs by more from a lane's direction is wrong


@dataclass(frozen=True, eq=False)
class Drivable:
    """Signed distances from the edge of the drivable area, as a raster.

    `stack_rules` and `RoadRules.select` make one for a batch of B scenes.
    """

    # metres at the centres of the pixels: positive outside, negative inside
    distance: Float[Tensor, "H W"]
    grid_from_world: Float[Tensor, "*B 2 3"]  # metres to pixels (corner origin)
    # left, top, right and bottom edge of each scene's part of the raster; None: all of it
    regions: Int[Tensor, "*B 4"] | None = None

    @cached_property
    def resolution(self) -> Float[Tensor, "*B"]:
        """Metres per pixel, which takes a tenth of a step of `DrivingEnv` to compute."""
        with torch.inference_mode(False), torch.no_grad():
            return compute_resolutions(self.grid_from_world)


@dataclass(frozen=True, eq=False)
class Lanes:
    """Directions of one-way lanes, sampled at M points along their centre lines.

    `stack_rules` and `RoadRules.select` make one for a batch of B scenes.
    """

    points: Float[Tensor, "*B M 2"]  # metres
    directions: Float[Tensor, "*B M"]  # radians
    radii: Float[Tensor, "*B M"]  # metres around a point within which an agent is on its lane


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
    corners = compute_box_corners(check_poses(poses, present), sizes)
    outside = sample_distance(drivable, corners).amax(dim=-1).clamp_min(0)
    return torch.where(present, outside, 0.0)


def detect_offroad(
    drivable: Drivable,
    poses: Float[Tensor, "... 3"],
    sizes: Float[Tensor, "... 2"],
    present: Bool[Tensor, "..."],
) -> tuple[Bool[Tensor, "..."], Bool[Tensor, "..."]]:
    """Mark agents with a corner further off the road than allowed, and those on the raster."""
    corners = compute_box_corners(check_poses(poses, present), sizes)
    distance = sample_distance(drivable, corners).amax(dim=-1)
    pixels, (low, high) = _pixels_from_world(drivable, corners)
    known = ((pixels >= low) & (pixels <= high)).flatten(-2).all(dim=-1) & present
    return (distance > OFFROAD_TOLERANCE_M) & known, known


def detect_collisions(
    poses: Float[Tensor, "B A 3"],
    sizes: Float[Tensor, "B A 2"],
    present: Bool[Tensor, "B A"],
    vehicles: Bool[Tensor, "*B A"],
) -> tuple[Bool[Tensor, "B A A"], Bool[Tensor, "B A A"]]:
    """Mark pairs of agents whose boxes overlap: collisions with a vehicle, contacts without."""
    overlaps = box_iou(poses, sizes, present) > 0
    either = vehicles[..., :, None] | vehicles[..., None, :]
    return overlaps & either, overlaps & ~either


def sample_distance(drivable: Drivable, points: Float[Tensor, "... 2"]) -> Float[Tensor, "..."]:
    """Interpolate signed distances to the edge of the drivable area, metres.

    Beyond the raster, it is the value at the nearest point of the raster, plus the distance to that
    point.
    """
    pixels, (low, high) = _pixels_from_world(drivable, points)
    size = pixels.new_tensor(drivable.distance.shape[::-1])
    inside = torch.minimum(torch.maximum(pixels, low + 0.5), high - 0.5)
    grid = (inside * (2 / size) - 1).reshape(1, 1, -1, 2)  # grid_sample: -1 to 1
    raster = drivable.distance[None, None]
    distance = F.grid_sample(raster, grid.to(raster), padding_mode="border", align_corners=False)
    offset = pixels - torch.minimum(torch.maximum(pixels, low), high)
    beyond = offset.abs().sum(-1) > 0
    resolution = _align(drivable.resolution, 0, points)
    extra = torch.where(beyond[..., None], offset, 1.0).norm(dim=-1) * resolution
    return distance.to(points).view(points.shape[:-1]) + torch.where(beyond, extra, 0.0)


def detect_red_light_running(
    last_poses: Float[Tensor, "B A 3"],
    poses: Float[Tensor, "B A 3"],
    lengths: Float[Tensor, "B A"],
    present: Bool[Tensor, "B A"],
    stop_lines: Float[Tensor, "... L 2 2"],
    states: Int[Tensor, "B L"],
) -> Bool[Tensor, "B A"]:
    """Mark agents whose front crosses a stop line forwards in a step while its light is red."""
    last_poses, poses = (check_poses(x, present) for x in (last_poses, poses))
    start = _locate_fronts(last_poses, lengths)[:, :, None]  # (B, A, 1, 2)
    end = _locate_fronts(poses, lengths)[:, :, None]
    lines = stop_lines.expand(len(states), *stop_lines.shape[-3:])[:, None]
    first, second = lines[..., 0, :], lines[..., 1, :]  # (B, 1, L, 2)
    side, next_side = cross(second - first, start - first), cross(second - first, end - first)
    # counted when the front leaves the line, so that stopping on it is no crossing
    crosses_line = (side * next_side <= 0) & (next_side != 0)
    path = end - start
    forwards = (path[:, :, 0] * _make_directions(poses[..., 2])).sum(-1) > 0
    between_ends = cross(path, first - start) * cross(path, second - start) <= 0
    red = (states == RED)[:, None]
    return (crosses_line & between_ends & red).any(-1) & forwards & present


def detect_wrong_way(
    lanes: Lanes, poses: Float[Tensor, "... 3"], present: Bool[Tensor, "..."]
) -> tuple[Bool[Tensor, "..."], Bool[Tensor, "..."]]:
    """Mark agents whose heading follows none of the one-way lanes that they are on."""
    safe = check_poses(poses, present).reshape(*lanes.points.shape[:-2], -1, 3)
    exact = "donot_use_mm_for_euclid_dist"  # matrix products are inexact far from the origin
    distances = torch.cdist(safe[..., :2], lanes.points.to(safe), compute_mode=exact)
    matches = distances < lanes.radii[..., None, :]  # (*B, n, M)
    turns = safe[..., 2:] - lanes.directions[..., None, :]
    follows = torch.cos(turns) > math.cos(WRONG_WAY_ANGLE_RAD)
    on_lane = matches.any(dim=-1)
    wrong = on_lane & ~(matches & follows).any(dim=-1)
    return wrong.view(present.shape) & present, on_lane.view(present.shape) & present


def _pixels_from_world(
    drivable: Drivable, points: Float[Tensor, "... 2"]
) -> tuple[Float[Tensor, "... 2"], tuple[Tensor, Tensor]]:
    """Map points to pixels; also gives the lowest and the highest corner of their raster."""
    matrix = _align(drivable.grid_from_world, 2, points)
    pixels = apply_matrix(matrix[..., :2], points) + matrix[..., 2]
    if drivable.regions is None:
        height, width = drivable.distance.shape
        regions = points.new_tensor([0, 0, width, height])
    else:
        regions = _align(drivable.regions, 1, points)
    return pixels, (regions[..., :2], regions[..., 2:])


def _align(values: Tensor, axes: int, points: Float[Tensor, "... 2"]) -> Tensor:
    """Let values of B scenes, with so many axes of their own, broadcast over (B, ..., 2) points."""
    if values.ndim > axes:
        values = values.view(len(values), *(1,) * (points.ndim - 2), *values.shape[1:])
    return values.to(points)


def _make_directions(headings: Float[Tensor, "..."]) -> Float[Tensor, "... 2"]:
    return torch.stack([headings.cos(), headings.sin()], dim=-1)


def _locate_fronts(
    poses: Float[Tensor, "... 3"], lengths: Float[Tensor, "..."]
) -> Float[Tensor, "... 2"]:
    return poses[..., :2] + _make_directions(poses[..., 2]) * lengths[..., None] / 2
