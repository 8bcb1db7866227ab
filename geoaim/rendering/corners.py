"""The ground of an image whose four corners are known in the world, as in Liu et al. 2023."""

import os
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from torch import Tensor

from geoaim.aim.aim import AIM
from geoaim.aim.texture_files import fit_corners, read_texture
from geoaim.rendering.ground import Ground, make_ground
from geoaim.rendering.input_checks import DTYPES

# factor by which the number of pixels may grow, where an image in perspective is resampled
MAX_GROWTH = 4.0


def make_ground_from_aim(aim: AIM) -> Ground:
    """Make the ground of an AIM, not prefiltered; a tilted view is rectified to north up first."""
    if not aim.is_affine:
        from geoaim.aim.rectification import rectify  # which needs OpenCV

        aim = rectify(aim)
    image = torch.tensor(aim.image).permute(2, 0, 1) / 255
    image_from_world = torch.tensor(np.linalg.inv(aim.world_from_image)[:2], dtype=torch.float32)
    ground = make_ground(image, image_from_world, coverage=torch.tensor(aim.coverage > 0))
    return replace(ground, world=aim.world)


def read_ground(folder: str | os.PathLike[str]) -> Ground:
    """Read the ground of a texture, without rasterio or OpenCV; see `geoaim.read_texture`.

    Args:
        folder: a folder written by `geoaim.export_texture` or `geoaim texture`.

    Returns:
        The ground, in float32 on the CPU, not prefiltered.

    Raises:
        AimError: a file is damaged, or the JSON does not follow the schema.
    """
    aim = read_texture(folder)
    if aim.is_affine:
        return make_ground_from_aim(aim)
    image = torch.tensor(aim.image).permute(2, 0, 1) / 255
    coverage = torch.tensor(aim.coverage > 0)
    ground = ground_from_corners(image, torch.tensor(aim.corners), coverage=coverage)
    return replace(ground, world=aim.world)


def ground_from_corners(
    image: Float[Tensor, "C h w"],
    corners: Float[Tensor, "4 2"],
    *,
    coverage: Bool[Tensor, "h w"] | None = None,
    outside: Float[Tensor, "C"] | None = None,
) -> Ground:
    """Make the ground of an image from the places of its four outer corners.

    Where the corners are a parallelogram, the image is kept as it is. Any other quadrilateral is
    resampled once by the homography that leads to the corners, by cubic convolution (Keys 1981),
    which leaves straight ramps straight. The new pixels are square, along the image's rows, and as
    fine as its finest, but at most `MAX_GROWTH` times as many.

    Args:
        image: (C, h, w) 0 to 1, in float32 or float64.
        corners: (4, 2) x and y, metres, of its top-left, top-right, bottom-right and bottom-left
            corner.
        coverage: (h, w) whether a pixel shows the ground; None: all do.
        outside: (C,) colour of all other pixels, and beyond the image; None: mid-grey.

    Returns:
        The ground, of the image's dtype and on its device.

    Raises:
        AimError: the corners are not those of a convex quadrilateral in this order.
        ValueError: as in `make_ground`.

    >>> corners = torch.tensor([[0.0, 8.0], [16.0, 8.0], [16.0, 0.0], [0.0, 0.0]])
    >>> ground_from_corners(torch.rand(3, 4, 8), corners).image_from_world
    tensor([[[ 0.5000,  0.0000,  1.0000],
             [ 0.0000, -0.5000,  5.0000]]])
    """
    height, width = image.shape[1:]
    points = corners.double().cpu().numpy()
    world_from_image = fit_corners(points, height, width)
    if np.array_equal(world_from_image[2], [0.0, 0.0, 1.0]):
        matrix = torch.from_numpy(np.linalg.inv(world_from_image))
        return make_ground(image, matrix, coverage=coverage, outside=outside)
    if image.dtype not in DTYPES:
        raise ValueError(f"a texture of {image.dtype}; float32 or float64 is needed")
    size, world_from_grid = _make_grid(points, world_from_image, (height, width))
    places = _map_pixels(size, np.linalg.inv(world_from_image) @ world_from_grid).to(image.device)
    u, v = places.unbind(-1)
    inside = (u > 0) & (u < width) & (v > 0) & (v < height)
    if coverage is not None:
        inside = inside & coverage[v.long().clamp(0, height - 1), u.long().clamp(0, width - 1)]
    matrix = torch.from_numpy(np.linalg.inv(world_from_grid))
    sampled = _sample_cubic(image, places)
    return make_ground(sampled, matrix, coverage=inside, outside=outside)


def _make_grid(
    corners: Float[Array, "4 2"], world_from_image: Float[Array, "3 3"], shape: tuple[int, int]
) -> tuple[tuple[int, int], Float[Array, "3 3"]]:
    """Make a grid of square pixels around the corners, along the image's rows."""
    height, width = shape
    right = corners[1] - corners[0] + corners[2] - corners[3]  # along the top and bottom edge
    right = right / np.linalg.norm(right)
    turn = np.column_stack([right, [-right[1], right[0]]])  # right and up
    turned = corners @ turn
    low, high = turned.min(axis=0), turned.max(axis=0)
    # the area of a pixel at each corner: the determinant over the cube of its depth
    depths = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]])
    areas = np.abs(np.linalg.det(world_from_image) / (depths @ world_from_image[2]) ** 3)
    fewest = np.prod(high - low) / (MAX_GROWTH * height * width)
    resolution = float(np.sqrt(max(areas.min(), fewest)))
    columns, rows = np.ceil((high - low) / resolution).astype(int)
    matrix = np.eye(3)
    matrix[:2] = turn @ [[resolution, 0, low[0]], [0, -resolution, high[1]]]
    return (int(rows), int(columns)), matrix


def _map_pixels(size: tuple[int, int], matrix: Float[Array, "3 3"]) -> Float[Tensor, "H W 2"]:
    """Map the centres of a grid's pixels by a homography, in float64."""
    v, u = torch.meshgrid(*(torch.arange(n).double() + 0.5 for n in size), indexing="ij")
    x, y, depth = (a * u + b * v + c for a, b, c in matrix.tolist())
    return torch.stack([x / depth, y / depth], dim=-1)


def _sample_cubic(
    image: Float[Tensor, "C h w"], places: Float[Tensor, "H W 2"]
) -> Float[Tensor, "C H W"]:
    """Sample an image by cubic convolution, with its edges continued, within its range."""
    _, height, width = image.shape
    u, v = (places - 0.5).unbind(-1)
    columns, rows = u.floor(), v.floor()
    sampled: Tensor | float = 0.0
    for i, along_v in enumerate(_weigh_cubic(v - rows), -1):
        row = (rows.long() + i).clamp(0, height - 1)
        for j, along_u in enumerate(_weigh_cubic(u - columns), -1):
            column = (columns.long() + j).clamp(0, width - 1)
            sampled = sampled + (along_v * along_u).to(image) * image[:, row, column]
    assert isinstance(sampled, Tensor)
    low, high = (f(image, dim=(1, 2), keepdim=True) for f in (torch.amin, torch.amax))
    return torch.minimum(torch.maximum(sampled, low), high)


def _weigh_cubic(x: Tensor) -> tuple[Tensor, ...]:
    """Weigh the four pixels around a place by cubic convolution; `x`: after the second one."""
    return (
        x * (-0.5 + x * (1 - 0.5 * x)),
        1 + x * x * (1.5 * x - 2.5),
        x * (0.5 + x * (2 - 1.5 * x)),
        x * x * (0.5 * x - 0.5),
    )
