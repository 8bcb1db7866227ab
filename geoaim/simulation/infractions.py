"""What went wrong: off the road, collisions, red lights, the wrong way. All batched.

States are (..., A, 4) x, y, heading and speed of A agents in some scenes and steps, sizes
(..., A, 2), and `present` says who is there: absent agents do nothing wrong.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.lights import RED
from geoaim.simulation.ground import applied
from geoaim.simulation.overlap import box_corners, box_iou, cross

WRONG = 2.0  # radians: a heading further from every lane's direction is the wrong way


@dataclass(frozen=True, eq=False)
class Drivable:
    """How far points are from the edge of where vehicles may drive.

    Attributes:
        metres: (H, W) at the middles of cells: positive outside, negative inside.
        image_from_world: (2, 3) metres to cells (corner origin).
    """

    metres: Float[Tensor, "H W"]
    image_from_world: Float[Tensor, "2 3"]


@dataclass(frozen=True, eq=False)
class Lanes:
    """Places along the middles of one-way lanes: (M, 2) metres, (M,) directions, (M,) half widths.

    Attributes:
        places: metres.
        directions: radians.
        reaches: metres within which a place speaks for its lane.
    """

    places: Float[Tensor, "M 2"]
    directions: Float[Tensor, "M"]
    reaches: Float[Tensor, "M"]


def offroad_distance(
    drivable: Drivable,
    poses: Float[Tensor, "... 3"],
    sizes: Float[Tensor, "... 2"],
    present: Bool[Tensor, "..."],
) -> Float[Tensor, "..."]:
    """Metres by which the corner furthest out is off the road; 0 on it. Differentiable.

    Beyond the raster the way to it is added. An agent is off the road when any corner is, as in
    the paper (Liu et al. 2023): where this is positive.
    """
    safe = torch.where(present[..., None], poses, 0.0)
    corners = box_corners(safe, sizes)
    outside = distance_at(drivable, corners).amax(dim=-1).clamp_min(0)
    return torch.where(present, outside, 0.0)


def distance_at(drivable: Drivable, points: Float[Tensor, "... 2"]) -> Float[Tensor, "..."]:
    """The signed distance at points, linear between the cells."""
    height, width = drivable.metres.shape
    matrix = drivable.image_from_world
    pixels = applied(matrix[:, :2].to(points), points) + matrix[:, 2].to(points)
    size = pixels.new_tensor([width, height])
    grid = (pixels * (2 / size) - 1).reshape(1, 1, -1, 2)
    raster = drivable.metres[None, None]
    found = F.grid_sample(raster, grid.to(raster), padding_mode="border", align_corners=False)
    held = torch.minimum(pixels.clamp_min(0), size)
    scale = torch.linalg.det(matrix[:, :2].double()).abs().sqrt().to(points)
    beyond = (pixels - held).abs().sum(-1) > 0
    away = torch.where(beyond[..., None], pixels - held, 1.0).norm(dim=-1) / scale
    return found.to(points).view(points.shape[:-1]) + torch.where(beyond, away, 0.0)


def collisions(
    poses: Float[Tensor, "B A 3"], sizes: Float[Tensor, "B A 2"], present: Bool[Tensor, "B A"]
) -> Float[Tensor, "B A"]:
    """The largest intersection over union of each agent's box with another's; 0: it hits nobody."""
    if poses.shape[1] == 0:
        return poses.new_zeros(poses.shape[:2])
    return box_iou(poses, sizes, present).amax(dim=-1)


def ran_red(
    before: Float[Tensor, "B A 3"],
    after: Float[Tensor, "B A 3"],
    lengths: Float[Tensor, "B A"],
    present: Bool[Tensor, "B A"],
    stop_lines: Float[Tensor, "... L 2 2"],
    states: Int[Tensor, "B L"],
) -> Bool[Tensor, "B A"]:
    """Whose front crossed a stop line in the step while its light was red.

    Args:
        before: poses at the step's start.
        after: poses at its end.
        lengths: of the agents, metres.
        present: who is there at both.
        stop_lines: both ends of each line; the same in all scenes, or each scene's own.
        states: of each light, as in `geoaim.lights`.
    """
    start, end = _front(before, lengths)[:, :, None], _front(after, lengths)[:, :, None]
    lines = stop_lines.expand(len(states), *stop_lines.shape[-3:])[:, None]
    one, two = lines[..., 0, :], lines[..., 1, :]
    was, now = cross(two - one, start - one), cross(two - one, end - one)
    crossed = (was * now <= 0) & (was != now)
    between = cross(end - start, one - start) * cross(end - start, two - start) <= 0
    red = (states == RED)[:, None]
    return (crossed & between & red).any(-1) & present


def wrong_way(
    lanes: Lanes, poses: Float[Tensor, "... 3"], present: Bool[Tensor, "..."]
) -> Bool[Tensor, "..."]:
    """Who is on one-way lanes and heads along none of them."""
    safe = torch.where(present[..., None], poses, 0.0)
    flat = safe.reshape(-1, 3)
    on = _on_lanes(lanes, flat[:, :2])
    apart = flat[:, 2:] - lanes.directions
    along = torch.cos(apart) > math.cos(WRONG)
    wrong = on.any(dim=1) & ~(on & along).any(dim=1)
    return wrong.view(present.shape) & present


def on_lanes(
    lanes: Lanes, poses: Float[Tensor, "... 3"], present: Bool[Tensor, "..."]
) -> Bool[Tensor, "..."]:
    """Who is on one-way lanes, and can go the wrong way."""
    safe = torch.where(present[..., None], poses, 0.0)
    on = _on_lanes(lanes, safe.reshape(-1, 3)[:, :2]).any(dim=1)
    return on.view(present.shape) & present


def rate(wrong: Bool[Tensor, "..."], present: Bool[Tensor, "..."]) -> Float[Tensor, ""]:
    """The share of agents, samples and steps in which something was wrong, of those present.

    Where nobody is present it is 0, and says nothing.
    """
    return (wrong & present).sum() / present.sum().clamp_min(1)


def _on_lanes(lanes: Lanes, points: Float[Tensor, "n 2"]) -> Bool[Tensor, "n M"]:
    """Which places of lanes speak for each point; not by products, which are inexact far away."""
    exact = "donot_use_mm_for_euclid_dist"
    return torch.cdist(points, lanes.places.to(points), compute_mode=exact) < lanes.reaches


def _front(poses: Float[Tensor, "... 3"], lengths: Float[Tensor, "..."]) -> Float[Tensor, "... 2"]:
    ahead = torch.stack([poses[..., 2].cos(), poses[..., 2].sin()], dim=-1)
    return poses[..., :2] + ahead * lengths[..., None] / 2
