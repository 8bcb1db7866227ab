"""Average textures over the pixels of a view, so that views do not alias."""

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from geoaim.rendering.atlas import stack_grounds, unstack_ground
from geoaim.rendering.ground import Ground, compute_resolutions


def prefilter_ground(ground: Ground, resolution: float, *, density: float = 4) -> Ground:
    """Average a ground over pixels of `resolution` metres, so that views of it do not alias.

    Each pixel becomes the mean of the texture, interpolated by cubic convolution (Keys 1981), over
    a square as large as a pixel of the view. One bilinear lookup is then close to the mean over
    that pixel, however the view is turned. A texture much finer than the view is subsampled; its
    square is smaller, since bilinear lookup among fewer pixels blurs too. The texture's pixels must
    be about square. A ground that was averaged over as large a square before is returned as it is.

    Args:
        ground: one map or several.
        resolution: resolution of the views, metres per pixel.
        density: least number of texture pixels per side of a view's pixel that subsampling keeps;
            up to twice as many are kept.

    Returns:
        The averaged ground, with the same maps.

    >>> from geoaim.rendering.ground import make_ground
    >>> fine = make_ground(torch.rand(3, 64, 64), torch.eye(3))  # a metre per pixel
    >>> prefilter_ground(fine, 8.0).averaged_over
    8.0
    """
    if ground.averaged_over >= resolution:
        return ground
    parts = [_prefilter_map(part, resolution, density) for part in unstack_ground(ground)]
    return stack_grounds(parts)


def _prefilter_map(ground: Ground, resolution: float, density: float) -> Ground:
    """Average a ground of one map."""
    ratio = resolution / float(compute_resolutions(ground.image_from_world))
    stride = max(1, int(ratio / density + 1e-3))
    weights = _compute_weights(math.sqrt(ratio**2 - 2 * (stride**2 - 1)))
    margin = math.ceil(len(weights) / 2 / stride) * stride  # the filter spreads beyond the edges
    matrix = _shift_origin(_shift_origin(ground.image_from_world, margin - 1.5) / stride, 0.5 + 1)
    image, coverage = (
        _filter(plane, weights, stride, margin) for plane in (ground.image, ground.coverage)
    )
    height, width = image.shape[1:]
    regions = ground.regions.new_tensor([[0, 0, width, height]])
    image = image.permute(1, 2, 0).contiguous().permute(2, 0, 1)
    return replace(
        ground,
        image=image,
        coverage=coverage,
        image_from_world=matrix,
        regions=regions,
        averaged_over=resolution,
    )


def _filter(
    image: Float[Tensor, "C h w"], weights: list[float], stride: int, margin: int
) -> Float[Tensor, "C H W"]:
    """Filter an image with a border, and a margin around it, by a separable filter."""
    outside, radius = image[:, 0, 0], len(weights) // 2
    result = _surround(image[:, 1:-1, 1:-1], outside, margin + radius)
    for _ in range(2):  # rows, then columns; a convolution takes many times the texture's memory
        end = result.shape[1] - 2 * radius
        shifts = (result[:, k : k + end : stride] for k in range(len(weights)))
        result = _sum_weighted(shifts, weights).transpose(1, 2)
    return _surround(result, outside, 1)


def _sum_weighted(images: Iterator[Tensor], weights: list[float]) -> Tensor:
    total = next(images) * weights[0]
    for image, weight in zip(images, weights[1:], strict=True):
        total = total + image * weight if image.requires_grad else total.add_(image, alpha=weight)
    return total


def _compute_weights(side: float) -> list[float]:
    """Compute the filter of a mean over `side` pixels of the cubic convolution (Keys 1981)."""
    radius = math.ceil(side / 2 + 1.5)
    ends = torch.arange(-radius, radius + 1)[:, None] + torch.tensor([-side, side]).double() / 2
    x = ends.abs().clamp(max=2)
    near = x * (1 + x**2 * (3 / 8 * x - 5 / 6))  # the kernel's integral from 0 to x, to 1
    far = 2 * x - 2 * x**2 + 5 / 6 * x**3 - x**4 / 8 - 1 / 6  # the same from 1 to 2
    weights = (torch.where(x < 1, near, far) * ends.sign()).diff(dim=1)[:, 0]
    return (weights / weights.sum()).tolist()


def _surround(
    image: Float[Tensor, "C h w"], colour: Float[Tensor, "C"], width: int
) -> Float[Tensor, "C H W"]:
    """Surround an image by a border of so many pixels in a colour."""
    _, rows, columns = image.shape
    result = colour[:, None, None].expand(-1, rows + 2 * width, columns + 2 * width).clone()
    result[:, width:-width, width:-width] = image
    return result


def _shift_origin(
    image_from_world: Float[Tensor, "M 2 3"], pixels: float
) -> Float[Tensor, "M 2 3"]:
    """Move an image's origin by `pixels` up and to the left."""
    return image_from_world + F.pad(image_from_world.new_full((2, 1), pixels), (2, 0))
