"""Pixel coverage: the exact area of a polygon in a pixel, and its exact gradient."""

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.simulation.derivatives import forbid_second_derivatives

MIN_RUN_PX = 1e-3  # an edge whose ends differ by less in x counts as vertical
MIN_EDGE_PX = 1e-9  # avoids divisions by zero


def compute_pixel_coverage(corners: Float[Tensor, "n K 2"]) -> Float[Tensor, "n"]:
    """Compute the area that polygons share with the unit square.

    By Green's theorem, the area is the integral of x dy along the polygon, with x and y clamped to
    the square. Its gradient with respect to an end of an edge is the integral, over the part of the
    edge in the square, of how far each point moves along with that end.

    Polygons are convex, their K corners in the order that turns +x towards +y; areas of polygons in
    the opposite order are negative.

    >>> square = torch.tensor([[[0.5, 0.5], [9.0, 0.5], [9.0, 9.0], [0.5, 9.0]]])
    >>> compute_pixel_coverage(square).tolist()
    [0.25]
    """
    return _Coverage.apply(corners)  # type: ignore[no-untyped-call]


class _Coverage(torch.autograd.Function):
    @staticmethod
    def forward(ctx, corners):  # type: ignore[no-untyped-def]
        ctx.save_for_backward(corners)
        return _compute_area(corners)

    @staticmethod
    def backward(ctx, *grads):  # type: ignore[no-untyped-def]
        (corners,) = ctx.saved_tensors
        with torch.no_grad():
            grad_corners = _compute_area_gradient(corners) * grads[0][:, None, None]
        return forbid_second_derivatives((grad_corners,), (corners, grads[0]))[0]


def _compute_area(corners: Float[Tensor, "n K 2"]) -> Float[Tensor, "n"]:
    """Integrate x dy around each polygon, with both clamped to [0, 1]."""
    x, y = corners.unbind(-1)
    next_y = y.roll(-1, 1)
    run, rise = x.roll(-1, 1) - x, next_y - y
    slope = run / torch.where(rise == 0, 1.0, rise)
    # ends of the part of the edge in the square's rows
    start, end = y.clamp(0, 1), next_y.clamp(0, 1)
    first_x = x + (start - y) * slope
    last_x = x + (end - y) * slope
    width = last_x - first_x
    vertical = width.abs() < MIN_RUN_PX
    mean_x = _integrate_clamped(last_x) - _integrate_clamped(first_x)
    mean_x = mean_x / torch.where(vertical, 1.0, width)
    mean_x = torch.where(vertical, ((first_x + last_x) / 2).clamp(0, 1), mean_x)
    return ((end - start) * mean_x).sum(1)


def _integrate_clamped(x: Tensor) -> Tensor:
    """Integrate from 0 to x its value clamped to [0, 1]."""
    clamped = x.clamp(0, 1)
    return clamped * (x - clamped / 2)


def _compute_area_gradient(corners: Float[Tensor, "n K 2"]) -> Float[Tensor, "n K 2"]:
    edge = corners.roll(-1, 1) - corners
    safe = torch.where(edge.abs() < MIN_EDGE_PX, MIN_EDGE_PX, edge)
    enter, leave = -corners / safe, (1 - corners) / safe
    start = torch.minimum(enter, leave).amax(-1).clamp_min(0)
    end = torch.maximum(torch.maximum(enter, leave).amin(-1).clamp_max(1), start)
    by_end = (end * end - start * start) / 2  # integral of the share of the end's motion
    normal = torch.stack([edge[..., 1], -edge[..., 0]], dim=-1)
    grad_start = normal * (end - start - by_end)[..., None]
    grad_end = normal * by_end[..., None]
    return grad_start + grad_end.roll(1, 1)
