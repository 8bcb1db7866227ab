"""Sample the ground at the pixels of views, by torch alone."""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.simulation.ground import Ground, View, apply_matrix
from geoaim.simulation.input_checks import check_cameras

BAD_CAMERA = "a camera's pose is not finite; mask absent cameras by `present`"


def render_coverage(
    view: View,
    cameras: Float[Tensor, "*B 3"],
    ground: Ground,
    *,
    present: Bool[Tensor, "B A"] | None = None,
) -> Float[Tensor, "*B 1 H W"]:
    """Render how much of each pixel the map covers.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) or (B, A, 3) x, y, heading of the pictures' centres.
        ground: one map for all views, or one for each of the B scenes.
        present: (B, A) which cameras exist; the coverage of the others is 0. None: all.

    Returns:
        (B, 1, H, W) or (B, A, 1, H, W) from 0, beyond the map and in its gaps, to 1; without
        gradients.

    Raises:
        ValueError: shapes or dtypes do not match, or the pose of a camera is not finite.
    """
    check_cameras(cameras, ground, present)
    with torch.no_grad():
        flat, absent = flatten_cameras(cameras, present)
        share = sample_ground(view, flat, ground, ground.coverage).clamp(0, 1)
        if absent is not None:
            share = torch.where(absent[..., None, None], 0.0, share)
    return share.view(*cameras.shape[:-1], 1, view.height, view.width)


def flatten_cameras(
    cameras: Float[Tensor, "*B 3"], present: Bool[Tensor, "*B"] | None
) -> tuple[Float[Tensor, "V 3"], Bool[Tensor, "V 1"] | None]:
    """Flatten cameras to (V, 3), with absent ones at 0, and get the mask of the absent ones.

    Raises:
        ValueError: the pose of one that is present is not finite.
    """
    flat, absent = cameras.reshape(-1, 3), None
    if present is not None:
        absent = ~present.reshape(-1, 1)
        flat = torch.where(absent, 0.0, flat)
    if not torch.isfinite(flat).all():
        raise ValueError(BAD_CAMERA)
    return flat, absent


def sample_ground(
    view: View, cameras: Float[Tensor, "V 3"], ground: Ground, image: Float[Tensor, "C h w"]
) -> Float[Tensor, "V C H W"]:
    """Sample textures bilinearly at the centres of all pixels of all views, in one call.

    Args:
        view: size and resolution of the pictures.
        cameras: (V, 3) x, y, heading.
        ground: one map, or M maps, each for V / M consecutive views.
        image: (C, h, w) the ground's image or coverage.

    Returns:
        (V, C, H, W) colours; beyond a texture, those of its border.
    """
    height, width = image.shape[-2:]
    scale = image.new_tensor([2 / width, 2 / height])  # grid_sample: -1 to 1
    maps = len(ground.regions)
    matrices = ground.image_from_world
    if maps > 1:
        matrices = matrices.repeat_interleave(len(cameras) // maps, dim=0)
    linear, offset = matrices[..., :2] * scale[:, None], matrices[..., 2] * scale - 1
    cosine, sine = cameras[:, 2].cos(), cameras[:, 2].sin()
    right = apply_matrix(linear, torch.stack([sine, -cosine], dim=1))  # (V, 2) step for one metre
    down = apply_matrix(linear, torch.stack([-cosine, -sine], dim=1))
    centre = apply_matrix(linear, cameras[:, :2])
    columns, rows = (
        (torch.arange(count).to(cameras) + 0.5 - count / 2) * view.resolution
        for count in (view.width, view.height)
    )
    # (V, 2 W) both coordinates of each column in turn, the layout that grid_sample reads
    across = (columns[:, None] * right[:, None] + (centre + offset)[:, None]).flatten(1)
    grid = torch.addcmul(across[:, None], rows[None, :, None], down.repeat(1, view.width)[:, None])
    grid = grid.view(len(cameras), view.height, view.width, 2)
    if maps > 1:
        edges = ground.regions.repeat_interleave(len(cameras) // maps, dim=0).to(cameras)
        low, high = (edges[:, :2] + 0.5) * scale - 1, (edges[:, 2:] - 0.5) * scale - 1
        grid = torch.minimum(torch.maximum(grid, low[:, None, None]), high[:, None, None])
    options: dict[str, Any] = {"padding_mode": "border", "align_corners": False}
    if not image.requires_grad:  # the texture is shared, not copied
        return F.grid_sample(image.expand(len(cameras), *image.shape), grid, **options)
    # its gradient would be copied for each view: all views are one image
    flat = F.grid_sample(image[None], grid.view(1, -1, view.width, 2), **options)
    pictures = flat.view(len(image), len(cameras), view.height, view.width)
    return pictures.transpose(0, 1).contiguous()
