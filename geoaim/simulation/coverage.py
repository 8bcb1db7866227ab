"""How much of a pixel a polygon covers: the exact area, and its exact gradient."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

STEEP = 1e-3  # px: an edge that runs less far to the side is taken as straight down


def pixel_coverage(corners: Float[Tensor, "n K 2"]) -> Float[Tensor, "n"]:
    """The area that each polygon shares with the unit square, where both have that corner origin.

    By Green's theorem, edge by edge: the area is the integral of x dy along the polygon, with x and
    y held to the square. The gradient by an end of an edge is the integral, over the part of the
    edge in the square, of how far each point moves along with it.

    Args:
        corners: of convex polygons, in the order that turns +x towards +y; in the other one the
            area is negative.

    >>> square = torch.tensor([[[0.5, 0.5], [9.0, 0.5], [9.0, 9.0], [0.5, 9.0]]])
    >>> pixel_coverage(square).tolist()
    [0.25]
    """
    return _Coverage.apply(corners)  # type: ignore[no-untyped-call]


class _Coverage(torch.autograd.Function):
    @staticmethod
    def forward(ctx, corners):  # type: ignore[no-untyped-def]
        ctx.save_for_backward(corners)
        return _area(corners)

    @staticmethod
    @once_differentiable
    def backward(ctx, *grads):  # type: ignore[no-untyped-def]
        return _area_gradient(*ctx.saved_tensors) * grads[0][:, None, None]


def _area(corners: Float[Tensor, "n K 2"]) -> Float[Tensor, "n"]:
    """The integral of x dy around each polygon, with both held to [0, 1]."""
    x, y = corners.unbind(-1)
    below = y.roll(-1, 1)
    run, rise = x.roll(-1, 1) - x, below - y
    slope = run / torch.where(rise == 0, 1.0, rise)
    start, end = y.clamp(0, 1), below.clamp(0, 1)
    left = x + (start - y) * slope
    right = x + (end - y) * slope
    across = right - left
    flat = across.abs() < STEEP
    mean = (_held(right) - _held(left)) / torch.where(flat, 1.0, across)
    mean = torch.where(flat, ((left + right) / 2).clamp(0, 1), mean)
    return ((end - start) * mean).sum(1)


def _held(x: Tensor) -> Tensor:
    """The integral from 0 of x held to [0, 1]."""
    held = x.clamp(0, 1)
    return held * (x - held / 2)


def _area_gradient(corners: Float[Tensor, "n K 2"]) -> Float[Tensor, "n K 2"]:
    """The gradient of the area by each corner."""
    edge = corners.roll(-1, 1) - corners
    safe = torch.where(edge.abs() < 1e-9, 1e-9, edge)
    enter, leave = -corners / safe, (1 - corners) / safe
    start = torch.minimum(enter, leave).amax(-1).clamp_min(0)
    end = torch.maximum(torch.maximum(enter, leave).amin(-1).clamp_max(1), start)
    later = (end * end - start * start) / 2
    normal = torch.stack([edge[..., 1], -edge[..., 0]], dim=-1)
    of_start = normal * (end - start - later)[..., None]
    of_end = normal * later[..., None]
    return of_start + of_end.roll(1, 1)
