"""Rasterize boxes: the pixels that each one touches, how much of them it covers, and painting them.

Most pixels of a box lie inside it. Exact coverage is computed only where an edge may pass, so that
a box costs about as much as its area in pixels.
"""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.rendering.ground import View

MIN_RUN_PX = 1e-3  # an edge whose ends differ by less in x counts as vertical
MIN_EDGE_PX = 1e-9  # avoids divisions by zero
HALF_DIAGONAL_PX = 0.71  # a pixel whose centre is further from all edges is all in or all out
TRIANGLE_SHARE = 0.35  # share of a box's length that the triangle at its front takes
MIN_SLOPE = 1e-6  # avoids divisions by zero


def forbid_second_derivatives(
    grads: tuple[Tensor | None, ...], inputs: tuple[Tensor, ...]
) -> tuple[Tensor | None, ...]:
    """Make gradients that were computed outside of autograd raise if they are differentiated."""
    if not torch.is_grad_enabled():  # they have no graph without `create_graph`
        return grads
    return tuple(None if grad is None else _FirstDerivative.apply(grad, *inputs) for grad in grads)  # type: ignore[no-untyped-call]


class _FirstDerivative(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, grad: Tensor, *inputs: Tensor) -> Tensor:
        return grad.view_as(grad)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> None:
        raise RuntimeError(
            "the renderer has first derivatives only, and a second one was asked for; take it by "
            "finite differences of the first"
        )


def compute_pixel_coverage(corners: Float[Tensor, "n K 2"]) -> Float[Tensor, "n"]:
    """Compute the area that polygons share with the unit square.

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


# By Green's theorem: the integral of x dy along the polygon, with both clamped to the square.
# Its gradient by an end of an edge is how far each point of the edge in the square moves with it.
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
    mean_x = _integrate_within_limits(last_x) - _integrate_within_limits(first_x)
    mean_x = mean_x / torch.where(vertical, 1.0, width)
    mean_x = torch.where(vertical, ((first_x + last_x) / 2).clamp(0, 1), mean_x)
    return ((end - start) * mean_x).sum(1)


def _integrate_within_limits(x: Tensor) -> Tensor:
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


@dataclass(frozen=True, eq=False)
class PixelBoxes:
    """The N present boxes of all views, in paint order, in pixels."""

    # index, in the flat pictures, of the first pixel of the first channel that it is painted in
    first_pixel: Int[Tensor, "N"]
    centre: Float[Tensor, "N 2"]  # column and row, corner origin
    axis: Float[Tensor, "N 2"]  # unit vector of its heading, right and down
    sizes: Float[Tensor, "N 2"]  # length and width
    colours: Float[Tensor, "N K"]  # colours of the boxes
    # colours of the triangles at their fronts; a box without a triangle repeats its own
    triangle_colours: Float[Tensor, "N K"]
    has_triangle: Bool[Tensor, "N"]


@dataclass(frozen=True, eq=False)
class Fragments:
    """What the boxes contribute to n pixels, in paint order; a pixel may occur several times."""

    pixel: Int[Tensor, "n"]  # index, in the flat pictures, in the first channel that is painted
    colour: Float[Tensor, "K n"]  # values in the channels that are painted, multiplied by alpha
    alpha: Float[Tensor, "n"]  # share of the pixel that the box covers


def project_poses(
    view: View, cameras: Float[Tensor, "N 3"], poses: Float[Tensor, "N 3"]
) -> tuple[Float[Tensor, "N 2"], Float[Tensor, "N 2"]]:
    """Compute columns and rows of poses in views, and unit vectors of headings, right and down."""
    x, y, turn = (poses - cameras).unbind(1)
    cosine, sine = cameras[:, 2].cos(), cameras[:, 2].sin()
    column = view.width / 2 + (x * sine - y * cosine) / view.resolution
    row = view.height / 2 - (x * cosine + y * sine) / view.resolution
    return torch.stack([column, row], dim=1), torch.stack([-turn.sin(), -turn.cos()], dim=1)


def rasterize(view: View, boxes: PixelBoxes) -> Fragments:
    """Rasterize boxes, in paint order, to fragments, box by box.

    Only the size of the view counts. The result is differentiable with respect to centre, axis,
    sizes and colours.
    """
    with torch.no_grad():
        owner, place = find_pixels(view, boxes.centre, boxes.axis, boxes.sizes)
        on_edge, on_triangle = _select_partial(boxes, owner, place)
        edges, tips = on_edge.nonzero()[:, 0], on_triangle.nonzero()[:, 0]
        column, row = place.unbind(1)
        pixel = boxes.first_pixel[owner] + row * view.width + column
        place = place.to(boxes.centre)
    polygon = torch.cat([owner[edges], owner[tips] + len(boxes.centre)])
    corners = _compute_polygons(boxes).flatten(1).index_select(0, polygon)  # (m, 8)
    corners = corners - place.index_select(0, torch.cat([edges, tips])).repeat(1, 4)
    shares = compute_pixel_coverage(corners.view(-1, 4, 2))
    alpha = place.new_ones(len(owner)).index_copy(0, edges, shares[: len(edges)])
    colour = alpha * boxes.colours.t().index_select(1, owner)  # (K, n)
    change = (boxes.triangle_colours - boxes.colours).t().index_select(1, owner[tips])
    colour = colour.index_add(1, tips, shares[len(edges) :] * change)
    return Fragments(pixel, colour, alpha)


def _compute_polygons(boxes: PixelBoxes) -> Float[Tensor, "M 4 2"]:
    """Compute the corners of N boxes, then of N triangles, whose tips count twice."""
    side = torch.stack([boxes.axis[:, 1], -boxes.axis[:, 0]], dim=1)
    forward, left = boxes.sizes[:, :1] / 2 * boxes.axis, boxes.sizes[:, 1:] / 2 * side
    quads = torch.stack([forward + left, forward - left, -forward - left, left - forward], dim=1)
    base = (1 - 2 * TRIANGLE_SHARE) * forward
    triangles = torch.stack([forward, forward, base - left, base + left], dim=1)
    return torch.cat([quads, triangles]) + boxes.centre.repeat(2, 1)[:, None]


def find_pixels(
    view: View,
    centre: Float[Tensor, "N 2"],
    axis: Float[Tensor, "N 2"],
    sizes: Float[Tensor, "N 2"],
) -> tuple[Int[Tensor, "n"], Int[Tensor, "n 2"]]:
    """Find the pixels in or near each box by scan conversion, row by row."""
    half = sizes / 2 + HALF_DIAGONAL_PX
    v, reach = centre[:, 1], (axis.abs().flip(1) * half).sum(1)
    top, bottom = span_pixels(v - reach, v + reach, view.height)
    box, row = enumerate_spans(top, bottom)
    table = torch.cat([centre, axis, half], dim=1).index_select(0, box)
    u, v, right, down, length, width = table.unbind(1)
    y = row + 0.5 - v
    intervals = []  # intervals of columns x in which |x slope + offset| <= limit, along and across
    for slope, offset, limit in ((right, y * down, length), (down, -y * right, width)):
        safe = torch.where(slope.abs() < MIN_SLOPE, MIN_SLOPE, slope)
        ends = torch.stack([(-limit - offset) / safe, (limit - offset) / safe])
        intervals.append(ends.sort(0).values)
    (low, high), (left, far) = intervals
    low, high = u + torch.maximum(low, left), u + torch.minimum(high, far)
    line, column = enumerate_spans(*span_pixels(low, high, view.width))
    return box[line], torch.stack([column, row[line]], dim=1)


def span_pixels(
    low: Float[Tensor, "n"], high: Float[Tensor, "n"], count: int
) -> tuple[Int[Tensor, "n"], Int[Tensor, "n"]]:
    """Find the first pixel whose centre lies in each interval, and the one after the last."""
    first, end = (low - 0.5).ceil().clamp(0, count), (high + 0.5).floor().clamp(0, count)
    return first.long(), end.long()


def enumerate_spans(
    first: Int[Tensor, "N"], end: Int[Tensor, "N"]
) -> tuple[Int[Tensor, "n"], Int[Tensor, "n"]]:
    """List all numbers from `first` to before `end` of each span: index of the span, and number."""
    counts = (end - first).clamp_min(0)
    span = torch.repeat_interleave(counts)
    start = first - (counts.cumsum(0) - counts)
    return span, torch.arange(len(span), device=span.device) + start[span]


def _select_partial(
    boxes: PixelBoxes, owner: Int[Tensor, "n"], place: Int[Tensor, "n 2"]
) -> tuple[Bool[Tensor, "n"], Bool[Tensor, "n"]]:
    """Mark pixels where an edge of the box may pass, and those that its triangle may touch."""
    table = torch.cat([boxes.centre - 0.5, boxes.axis, boxes.sizes / 2], dim=1)
    table = table.index_select(0, owner)
    u, v, right, down, length, width = table.unbind(1)
    x, y = place[:, 0] - u, place[:, 1] - v
    along = x * right + y * down
    inside = torch.minimum(length - along.abs(), width - (x * down - y * right).abs())
    front = along > (1 - 2 * TRIANGLE_SHARE) * length - HALF_DIAGONAL_PX
    return inside < HALF_DIAGONAL_PX, front & boxes.has_triangle[owner]


def composite(pictures: Float[Tensor, "V C H W"], fragments: Fragments) -> Float[Tensor, "V C H W"]:
    """Paint fragments over contiguous pictures, in place, one after the other."""
    stride = pictures.shape[2:].numel()
    channels = torch.arange(len(fragments.colour), device=pictures.device)[:, None]
    index = fragments.pixel + stride * channels  # (K, n) indices into the flat pictures
    return _Composite.apply(pictures, fragments.colour, fragments.alpha, index)  # type: ignore[no-untyped-call]


class _Composite(torch.autograd.Function):
    """Paint in passes in which no pixel occurs twice; saves what each fragment is painted over."""

    @staticmethod
    def forward(ctx: Any, pictures: Tensor, colour: Tensor, alpha: Tensor, index: Tensor) -> Tensor:
        ctx.mark_dirty(pictures)
        canvas, below = pictures.view(-1), torch.empty_like(colour)
        passes = _split_into_passes(index[0])
        for some in passes:
            place = index[:, some]
            below[:, some] = last = canvas[place]
            canvas[place] = colour[:, some] + (1 - alpha[some]) * last
        ctx.save_for_backward(colour, alpha, index, below, *passes)
        return pictures

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        colour, alpha, index, below, *passes = ctx.saved_tensors
        with torch.no_grad():
            painted = grads[0].clone(memory_format=torch.contiguous_format)
            canvas, grad_colour = painted.view(-1), torch.empty_like(below)
            for some in reversed(passes):
                place = index[:, some]
                grad_colour[:, some] = grad = canvas[place]
                canvas[place] = (1 - alpha[some]) * grad
            grad_alpha = -(grad_colour * below).sum(0)
        inputs = grads[0], colour, alpha
        return forbid_second_derivatives((painted, grad_colour, grad_alpha, None), inputs)


def _split_into_passes(pixel: Int[Tensor, "n"]) -> list[Int[Tensor, "m"]]:
    """Split fragments, in paint order, into passes in which no pixel occurs twice.

    >>> [some.tolist() for some in _split_into_passes(torch.tensor([7, 5, 7, 7, 5]))]
    [[1, 0], [4, 2], [3]]
    """
    if len(pixel) == 0:
        return []
    order = pixel.argsort(stable=True)
    _, counts = torch.unique_consecutive(pixel[order], return_counts=True)
    starts = torch.repeat_interleave(counts.cumsum(0) - counts, counts)
    depth = torch.arange(len(pixel), device=pixel.device) - starts
    by_depth = depth.argsort(stable=True)
    return list(torch.split(order[by_depth], depth.bincount().tolist()))
