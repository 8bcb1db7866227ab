"""Signed distances between oriented boxes: positive between them, negative where they overlap."""

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.simulation.overlap import compute_box_corners


def compute_box_distance(
    poses: Float[Tensor, "*#m 3"],
    sizes: Float[Tensor, "*#m 2"],
    other_poses: Float[Tensor, "*#m 3"],
    other_sizes: Float[Tensor, "*#m 2"],
) -> Float[Tensor, "*m"]:
    """Compute the signed distance between the boxes of each pair.

    Between separate boxes it is the distance from a corner of one to the other. Of boxes that
    overlap it is minus the shortest way that parts them, along an axis of either (the separating
    axis theorem): the distance of the origin from the edge of their Minkowski difference.

    Args:
        poses: (..., 3) x, y, heading.
        sizes: (..., 2) length and width, metres.
        other_poses: (..., 3) the other boxes' poses; the leading axes are broadcast.
        other_sizes: (..., 2).

    Returns:
        (...) metres.

    >>> box = torch.tensor([4.0, 2.0])
    >>> poses = torch.tensor([[6.0, 0.0, 0.0], [3.5, 0.0, 0.0]])
    >>> compute_box_distance(torch.zeros(3), box, poses, box).tolist()
    [2.0, -0.5]
    """
    there, back = locate_from(poses, other_poses), locate_from(other_poses, poses)
    gap = torch.maximum(
        _measure_gap(there, sizes, other_sizes), _measure_gap(back, other_sizes, sizes)
    )
    distance = torch.minimum(
        _measure_corners(there, sizes, other_sizes), _measure_corners(back, other_sizes, sizes)
    )
    return torch.where(gap > 0, distance, gap)


def locate_from(
    poses: Float[Tensor, "*#m 3"], other_poses: Float[Tensor, "*#m 3"]
) -> Float[Tensor, "*m 3"]:
    """Express poses in the frames of others: x forward, y left, heading (not wrapped)."""
    x, y, heading = (other_poses - poses).unbind(-1)
    cosine, sine = poses[..., 2].cos(), poses[..., 2].sin()
    return torch.stack([x * cosine + y * sine, y * cosine - x * sine, heading], dim=-1)


def measure_extents(
    headings: Float[Tensor, "*#m"], sizes: Float[Tensor, "*#m 2"]
) -> Float[Tensor, "*m 2"]:
    """Measure how far turned boxes reach from their centres along x and y, in metres."""
    cosine, sine = headings.cos().abs(), headings.sin().abs()
    length, width = (sizes / 2).unbind(-1)
    return torch.stack([cosine * length + sine * width, sine * length + cosine * width], dim=-1)


def _measure_gap(
    located: Float[Tensor, "*m 3"], sizes: Float[Tensor, "*#m 2"], other: Float[Tensor, "*#m 2"]
) -> Float[Tensor, "*m"]:
    """The larger gap along the axes of a box to another, which is located in its frame."""
    reach = sizes / 2 + measure_extents(located[..., 2], other)
    return (located[..., :2].abs() - reach).amax(dim=-1)


def _measure_corners(
    located: Float[Tensor, "*m 3"], sizes: Float[Tensor, "*#m 2"], other: Float[Tensor, "*#m 2"]
) -> Float[Tensor, "*m"]:
    """Distance from a box to the nearest corner of another, which is located in its frame."""
    corners = compute_box_corners(located, other)
    return (corners.abs() - sizes[..., None, :] / 2).clamp_min(0).norm(dim=-1).amin(dim=-1)
