"""Paint triangles over pictures: the meshes of other simulators on an image map."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from geoaim.rendering.ground import View
from geoaim.rendering.rasterization import (
    compute_pixel_coverage,
    enumerate_spans,
    project_poses,
    span_pixels,
)


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
    flat = cameras[:, None, None].expand(count, faces, 3, 3).reshape(-1, 3)
    poses = torch.nn.functional.pad(corners.reshape(-1, 2), (0, 1))
    pixels, _ = project_poses(view, flat, poses)
    pixels = pixels.view(count * faces, 3, 2)  # columns and rows
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
    top, bottom = span_pixels(low[:, 1] - 0.5, high[:, 1] + 0.5, view.height)
    face, row = enumerate_spans(top, bottom)
    left, right = span_pixels(low[face, 0] - 0.5, high[face, 0] + 0.5, view.width)
    line, column = enumerate_spans(left, right)
    return face[line], column, row[line]
