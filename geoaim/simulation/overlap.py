"""How much oriented boxes overlap: the exact shared area, batched and differentiable."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

SHRINK = 2e-6  # share by which the second box is smaller, so that edges never lie on each other
CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))  # ahead and left, counter-clockwise


def box_corners(
    poses: Float[Tensor, "... 3"], sizes: Float[Tensor, "... 2"]
) -> Float[Tensor, "... 4 2"]:
    """Corners of boxes, counter-clockwise from the front left, metres.

    Args:
        poses: x, y and heading of their middles.
        sizes: length and width.

    >>> box_corners(torch.zeros(3), torch.tensor([4.0, 2.0])).tolist()
    [[2.0, 1.0], [-2.0, 1.0], [-2.0, -1.0], [2.0, -1.0]]
    """
    ahead, left = (poses.new_tensor(CORNERS) * sizes[..., None, :] / 2).unbind(-1)
    cosine, sine = poses[..., 2:3].cos(), poses[..., 2:3].sin()
    corners = torch.stack([ahead * cosine - left * sine, ahead * sine + left * cosine], dim=-1)
    return corners + poses[..., None, :2]


def shared_area(poses: Float[Tensor, "n 2 3"], sizes: Float[Tensor, "n 2 2"]) -> Float[Tensor, "n"]:
    """The area that both boxes of each pair share, m².

    Its outline is what of either box's edges lies in the other, so that the area is half the sum
    of the cross products of these pieces' ends (Green's theorem). Edges that nearly lie on each
    other cancel only in float64, in which it is computed.

    >>> poses = torch.tensor([[[0.0, 0.0, 0.0], [3.0, 0.5, 0.0]]])
    >>> round(float(shared_area(poses, torch.tensor([[[4.0, 2.0], [4.0, 2.0]]]))), 3)
    1.5
    """
    dtype, poses, sizes = poses.dtype, poses.double(), sizes.double()
    sizes = sizes * sizes.new_tensor([[1.0], [1.0 - SHRINK]])
    middle = poses[:, :1, :2]  # near the origin, where cross products are small
    near = torch.cat([poses[..., :2] - middle, poses[..., 2:]], dim=-1)
    corners = box_corners(near, sizes)
    other = near.flip(1), sizes.flip(1)
    start, end = corners, corners.roll(-1, dims=2)
    first, last = _inside(start, end, *other)
    twice = cross(start, end - start) * (last - first)
    return (twice.sum((1, 2)).clamp_min(0) / 2).to(dtype)


def box_iou(
    poses: Float[Tensor, "B A 3"], sizes: Float[Tensor, "B A 2"], present: Bool[Tensor, "B A"]
) -> Float[Tensor, "B A A"]:
    """Shared over joint area of all boxes of each scene with each other; 0 with oneself and absent.

    Only pairs whose circles meet are looked at.
    """
    count = poses.shape[1]
    safe = torch.where(present[..., None], poses, 0.0)
    reach = torch.where(present, sizes.norm(dim=-1), -torch.inf) / 2
    with torch.no_grad():
        row, column = torch.triu_indices(count, count, offset=1, device=poses.device)
        apart = safe[:, row, :2] - safe[:, column, :2]
        meet = apart.square().sum(-1) < (reach[:, row] + reach[:, column]).clamp_min(0).square()
        scene, pair = meet.nonzero().unbind(1)
    both = torch.stack([row[pair], column[pair]], dim=1)
    boxes = sizes[scene[:, None], both]
    shared = shared_area(safe[scene[:, None], both], boxes)
    joint = boxes.prod(dim=-1).sum(dim=1) - shared
    iou = poses.new_zeros(len(poses), count, count)
    iou[scene, both[:, 0], both[:, 1]] = shared / joint
    return iou + iou.transpose(1, 2)


def cross(a: Float[Tensor, "... 2"], b: Float[Tensor, "... 2"]) -> Float[Tensor, "..."]:
    """The cross product in the plane: positive where b points to the left of a."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _inside(
    start: Float[Tensor, "n 2 4 2"],
    end: Float[Tensor, "n 2 4 2"],
    poses: Float[Tensor, "n 2 3"],
    sizes: Float[Tensor, "n 2 2"],
) -> tuple[Float[Tensor, "n 2 4"], Float[Tensor, "n 2 4"]]:
    """From which to which share of itself each edge lies in a box (Liang and Barsky 1984)."""
    ahead = torch.stack([poses[..., 2:].cos(), poses[..., 2:].sin()], dim=-1)
    apart, way = start - poses[..., None, :2], end - start
    begin, edge = (
        torch.stack([(ahead * line).sum(-1), cross(ahead, line)], dim=-1) for line in (apart, way)
    )
    half = sizes[..., None, :] / 2
    still = edge.abs() < 1e-9
    safe = torch.where(still, 1.0, edge)
    one, two = (-half - begin) / safe, (half - begin) / safe
    within = begin.abs() < half
    enter = torch.where(still, torch.where(within, -torch.inf, torch.inf), torch.minimum(one, two))
    leave = torch.where(still, torch.where(within, torch.inf, -torch.inf), torch.maximum(one, two))
    first = enter.amax(-1).clamp(0, 1)
    last = torch.maximum(leave.amin(-1).clamp(0, 1), first)
    return first, last
