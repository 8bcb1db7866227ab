"""Rasterize boxes: find the pixels that each one touches, and how much of them it covers.

Most pixels of a box lie inside it. Exact coverage (see `coverage`) is computed only where an edge
may pass, so that a box costs about as much as its area in pixels.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.simulation.coverage import compute_pixel_coverage
from geoaim.simulation.ground import View

HALF_DIAGONAL_PX = 0.71  # a pixel whose centre is further from all edges is all in or all out
TRIANGLE_SHARE = 0.35  # share of a box's length that the triangle at its front takes
MIN_SLOPE = 1e-6  # avoids divisions by zero


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
    """Compute where poses lie in the views of their cameras.

    Args:
        view: size and resolution of the views.
        cameras: (N, 3) x, y, heading of each pose's camera.
        poses: (N, 3) x, y, heading.

    Returns:
        (N, 2) columns and rows; (N, 2) unit vectors of the headings, right and down.
    """
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
    colour = alpha * boxes.colours.t()[:, owner]  # (K, n)
    change = (boxes.triangle_colours - boxes.colours).t()[:, owner[tips]]
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
    """Find the pixels in or near each box by scan conversion, row by row.

    Args:
        view: size of the pictures.
        centre: (N, 2) column and row, pixels (corner origin).
        axis: (N, 2) unit vector of the heading, right and down.
        sizes: (N, 2) length and width, pixels.

    Returns:
        (n,) index of the box of each pixel; (n, 2) column and row of the pixel.
    """
    half = sizes / 2 + HALF_DIAGONAL_PX
    v, reach = centre[:, 1], (axis.abs().flip(1) * half).sum(1)
    top, bottom = span_pixels(v - reach, v + reach, view.height)
    box, row = enumerate_spans(top, bottom)
    u, v, right, down, length, width = torch.cat([centre, axis, half], dim=1)[box].unbind(1)
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
    """Find the pixels whose centres lie in intervals.

    Args:
        low: (n,) begin of each interval, pixels.
        high: (n,) end of each interval, pixels.
        count: pixels that there are.

    Returns:
        The first pixel, and the one after the last.
    """
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
    table = torch.cat([boxes.centre - 0.5, boxes.axis, boxes.sizes / 2], dim=1)[owner]
    u, v, right, down, length, width = table.unbind(1)
    x, y = place[:, 0] - u, place[:, 1] - v
    along = x * right + y * down
    inside = torch.minimum(length - along.abs(), width - (x * down - y * right).abs())
    front = along > (1 - 2 * TRIANGLE_SHARE) * length - HALF_DIAGONAL_PX
    return inside < HALF_DIAGONAL_PX, front & boxes.has_triangle[owner]
