"""Overlap of oriented boxes, exact and differentiable, and signed distances between them."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))  # forward, left; counter-clockwise


def compute_box_corners(
    poses: Float[Tensor, "... 3"], sizes: Float[Tensor, "... 2"]
) -> Float[Tensor, "... 4 2"]:
    """Compute the corners of boxes, counter-clockwise from front left.

    Poses are x, y, heading of the centres, sizes length and width; leading axes are broadcast.

    >>> compute_box_corners(torch.zeros(3), torch.tensor([4.0, 2.0])).tolist()
    [[2.0, 1.0], [-2.0, 1.0], [-2.0, -1.0], [2.0, -1.0]]
    """
    forward, left = (poses.new_tensor(CORNERS) * sizes[..., None, :] / 2).unbind(-1)
    cosine, sine = poses[..., 2:3].cos(), poses[..., 2:3].sin()
    corners = torch.stack([forward * cosine - left * sine, forward * sine + left * cosine], dim=-1)
    return corners + poses[..., None, :2]


def compute_intersection_area(
    poses: Float[Tensor, "n 2 3"], sizes: Float[Tensor, "n 2 2"]
) -> Float[Tensor, "n"]:
    """Compute the area of the intersection of each pair of boxes.

    >>> poses = torch.tensor([[[0.0, 0.0, 0.0], [3.0, 0.5, 0.0]]])
    >>> round(float(compute_intersection_area(poses, torch.tensor([[[4.0, 2.0], [4.0, 2.0]]]))), 3)
    1.5
    """
    dtype, poses, sizes = poses.dtype, poses.double(), sizes.double()
    # one box of a pair is smaller, so that edges never coincide
    sizes = sizes * sizes.new_tensor([[1.0], [1.0 - 2e-6]])
    origin = poses[:, :1, :2]  # cross products are small, and so exact, near the origin
    local = torch.cat([poses[..., :2] - origin, poses[..., 2:]], dim=-1)
    start = compute_box_corners(local, sizes)  # (n, 2, 4, 2)
    end = start.roll(-1, dims=2)
    enter, leave = _clip_edges(start, end, local.flip(1), sizes.flip(1))
    twice = cross(start, end - start) * (leave - enter)
    return (twice.sum((1, 2)).clamp_min(0) / 2).to(dtype)


def box_iou(
    poses: Float[Tensor, "B A 3"], sizes: Float[Tensor, "B A 2"], present: Bool[Tensor, "B A"]
) -> Float[Tensor, "B A A"]:
    """Compute the intersection over union of all pairs of boxes in each scene."""
    count = poses.shape[1]
    safe = check_poses(poses, present)
    radius = torch.where(present, sizes.norm(dim=-1), -torch.inf) / 2
    with torch.no_grad():
        row, column = torch.triu_indices(count, count, offset=1, device=poses.device)
        offset = safe[:, row, :2] - safe[:, column, :2]
        reach = (radius[:, row] + radius[:, column]).clamp_min(0)
        scene, pair = (offset.square().sum(-1) < reach.square()).nonzero().unbind(1)
    both = torch.stack([row[pair], column[pair]], dim=1)  # (n, 2)
    boxes = sizes[scene[:, None], both]
    intersection = compute_intersection_area(safe[scene[:, None], both], boxes)
    union = boxes.prod(dim=-1).sum(dim=1) - intersection
    iou = poses.new_zeros(len(poses), count, count)
    iou[scene, both[:, 0], both[:, 1]] = intersection / union
    return iou + iou.transpose(1, 2)


def check_poses(
    poses: Float[Tensor, "... 3"], present: Bool[Tensor, "..."]
) -> Float[Tensor, "... 3"]:
    """Replace the poses of absent boxes by zeros, and refuse others that are not finite."""
    safe = torch.where(present[..., None], poses, 0.0)
    if not torch.isfinite(safe).all():
        wrong = int((~torch.isfinite(safe)).any(dim=-1).sum())
        raise ValueError(
            f"{wrong} of {int(present.sum())} present boxes have a pose that is not finite; mark "
            "them as absent"
        )
    return safe


def cross(a: Float[Tensor, "... 2"], b: Float[Tensor, "... 2"]) -> Float[Tensor, "..."]:
    """Compute the cross product in the plane: positive where b points to the left of a."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _clip_edges(
    start: Float[Tensor, "n 2 4 2"],
    end: Float[Tensor, "n 2 4 2"],
    poses: Float[Tensor, "n 2 3"],
    sizes: Float[Tensor, "n 2 2"],
) -> tuple[Float[Tensor, "n 2 4"], Float[Tensor, "n 2 4"]]:
    """Clip edges at boxes: the shares of each edge at which it enters and leaves its box."""
    forward = torch.stack([poses[..., 2:].cos(), poses[..., 2:].sin()], dim=-1)
    origin, direction = (  # forward and left in the box's frame
        torch.stack([(forward * vector).sum(-1), cross(forward, vector)], dim=-1)
        for vector in (start - poses[..., None, :2], end - start)
    )
    half = sizes[..., None, :] / 2
    parallel = direction.abs() < 1e-9
    safe = torch.where(parallel, 1.0, direction)
    low, high = (-half - origin) / safe, (half - origin) / safe
    always = torch.where(origin.abs() < half, torch.inf, -torch.inf)  # inside, or outside
    enter = torch.where(parallel, -always, torch.minimum(low, high)).amax(-1).clamp(0, 1)
    leave = torch.where(parallel, always, torch.maximum(low, high)).amin(-1).clamp(0, 1)
    return enter, torch.maximum(leave, enter)


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
