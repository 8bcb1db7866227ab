"""Paint triangles over pictures: the meshes of other simulators on an image map."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from geoaim.rendering.ground import View


def paint_triangles(
    view: View,
    cameras: Float[Tensor, "V 3"],
    pictures: Float[Tensor, "V C H W"],
    corners: Float[Tensor, "V F 3 2"],
    colours: Float[Tensor, "V F C"],
    levels: Float[Tensor, "V F"],
) -> Float[Tensor, "V C H W"]:
    """Paint triangles with exact coverage, those of higher levels first.

    >>> corners = torch.tensor([[[[0.0, 9.0], [0.0, -9.0], [9.0, 0.0]]]])
    >>> black = torch.zeros(1, 1, 2, 2)
    >>> given = black, corners, torch.ones(1, 1, 1), torch.zeros(1, 1)
    >>> paint_triangles(View(2, 2, 1.0), torch.zeros(1, 3), *given)[0, 0].tolist()
    [[1.0, 1.0], [0.0, 0.0]]
    """
    count, faces = levels.shape
    x, y = (corners - cameras[:, None, None, :2]).unbind(-1)
    cosine, sine = (f(cameras[:, 2, None, None]) / view.resolution for f in (torch.cos, torch.sin))
    columns, rows = x * sine - y * cosine + view.width / 2, view.height / 2 - x * cosine - y * sine
    pixels = torch.stack([columns, rows], dim=-1).view(count * faces, 3, 2)
    face, column, row = _find_pixels(view, pixels.detach())
    offset = torch.stack([column, row], dim=1).to(pixels)[:, None]
    areas = compute_pixel_coverage(pixels[face] - offset)
    alpha = areas.abs()  # corners come in both orders
    target = face // faces * (view.height * view.width) + row * view.width + column
    colour, level = colours.flatten(0, 1)[face], levels.flatten()[face]
    result = pictures.permute(0, 2, 3, 1).reshape(-1, pictures.shape[1])  # (V H W, C)
    for height in sorted(set(levels.detach().flatten().tolist()), reverse=True):
        part = level == height
        some, share = target[part], alpha[part]
        covered = result.new_zeros(len(result)).index_add(0, some, share)
        painted = torch.zeros_like(result).index_add(0, some, share[:, None] * colour[part])
        painted = painted / covered.clamp_min(1.0)[:, None]
        result = result * (1 - covered.clamp_max(1.0))[:, None] + painted
    return result.view(count, view.height, view.width, -1).permute(0, 3, 1, 2)


def _find_pixels(
    view: View, corners: Float[Tensor, "n 3 2"]
) -> tuple[Int[Tensor, "m"], Int[Tensor, "m"], Int[Tensor, "m"]]:
    """List the triangle, column and row of all pixels of the triangles' bounding boxes."""
    low, high = corners.amin(dim=1), corners.amax(dim=1)
    top, bottom = _span_pixels(low[:, 1] - 0.5, high[:, 1] + 0.5, view.height)
    face, row = _enumerate_spans(top, bottom)
    left, right = _span_pixels(low[face, 0] - 0.5, high[face, 0] + 0.5, view.width)
    line, column = _enumerate_spans(left, right)
    return face[line], column, row[line]


def _span_pixels(
    low: Float[Tensor, "n"], high: Float[Tensor, "n"], count: int
) -> tuple[Int[Tensor, "n"], Int[Tensor, "n"]]:
    """Find the first pixel whose centre lies in each interval, and the one after the last."""
    first, end = (low - 0.5).ceil().clamp(0, count), (high + 0.5).floor().clamp(0, count)
    return first.long(), end.long()


def _enumerate_spans(
    first: Int[Tensor, "N"], end: Int[Tensor, "N"]
) -> tuple[Int[Tensor, "n"], Int[Tensor, "n"]]:
    """List all numbers from `first` to before `end` of each span: index of the span, and number."""
    counts = (end - first).clamp_min(0)
    span = torch.repeat_interleave(counts)
    start = first - (counts.cumsum(0) - counts)
    return span, torch.arange(len(span), device=span.device) + start[span]


def compute_pixel_coverage(corners: Float[Tensor, "n K 2"]) -> Float[Tensor, "n"]:
    """Compute the area that polygons share with the unit square, by Green's theorem.

    It is the integral of x dy around each polygon, with both clamped to [0, 1].

    >>> square = torch.tensor([[[0.5, 0.5], [9.0, 0.5], [9.0, 9.0], [0.5, 9.0]]])
    >>> compute_pixel_coverage(square).tolist()
    [0.25]
    """
    x, y = corners.unbind(-1)
    next_y = y.roll(-1, 1)
    run, rise = x.roll(-1, 1) - x, next_y - y
    slope = run / torch.where(rise == 0, 1.0, rise)
    # ends of the part of the edge in the square's rows
    start, end = y.clamp(0, 1), next_y.clamp(0, 1)
    first_x = x + (start - y) * slope
    last_x = x + (end - y) * slope
    width = last_x - first_x
    vertical = width.abs() < 1e-3  # pixels
    mean_x = _integrate_within_limits(last_x) - _integrate_within_limits(first_x)
    mean_x = mean_x / torch.where(vertical, 1.0, width)
    mean_x = torch.where(vertical, ((first_x + last_x) / 2).clamp(0, 1), mean_x)
    return ((end - start) * mean_x).sum(1)


def _integrate_within_limits(x: Tensor) -> Tensor:
    """Integrate from 0 to x its value clamped to [0, 1]."""
    clamped = x.clamp(0, 1)
    return clamped * (x - clamped / 2)
