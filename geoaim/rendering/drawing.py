"""What is drawn, and how: the ground is sampled, then fragments of boxes are painted on it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.rendering.boxes import OrientedBoxes, StackedBoxes
from geoaim.rendering.ground import Ground, View, apply_matrix
from geoaim.rendering.input_checks import check_cameras
from geoaim.rendering.rasterization import PixelBoxes, composite, project_poses, rasterize


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
    """Flatten cameras to (V, 3), with absent ones at 0, and get the mask of the absent ones."""
    flat, absent = cameras.reshape(-1, 3), None
    if present is not None:
        absent = ~present.reshape(-1, 1)
        flat = torch.where(absent, 0.0, flat)
    if not torch.isfinite(flat).all():
        raise ValueError("a camera's pose is not finite; mask absent cameras by `present`")
    return flat, absent


def sample_ground(
    view: View, cameras: Float[Tensor, "V 3"], ground: Ground, image: Float[Tensor, "C h w"]
) -> Float[Tensor, "V C H W"]:
    """Sample textures bilinearly at all pixels; each of M maps has V / M consecutive views."""
    height, width = image.shape[-2:]
    scale = image.new_tensor([2 / width, 2 / height])  # grid_sample: -1 to 1
    maps, views = len(ground.regions), len(cameras)
    gradients = cameras.requires_grad or image.requires_grad
    if maps == 1 and views > 1 and cameras.stride(0) == 0 and not gradients:  # one, expanded
        one = sample_ground(view, cameras[:1], ground, image)
        return one.expand(views, -1, -1, -1).contiguous()
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


@dataclass(frozen=True, eq=False)
class Drawing:
    """What is drawn: the views of B scenes, one or A views of each."""

    view: View
    cameras: Float[Tensor, "*B 3"]  # (B, 3) or (B, A, 3)
    ground: Ground  # one map, or B
    present: Bool[Tensor, "*B"] | None  # which cameras exist; None: all
    planes: int = 0  # one for each layer of boxes, after the ground's channels; 0: boxes in colour


def flatten_scenes(
    drawing: Drawing, layers: Sequence[OrientedBoxes]
) -> tuple[Drawing, Sequence[OrientedBoxes]]:
    """Bring cameras of (3,) or (*S, A, 3) and boxes of the scenes *S to one axis of scenes."""
    cameras, present = drawing.cameras, drawing.present
    if cameras.ndim in (2, 3):
        return drawing, layers
    if cameras.ndim == 1:
        present = None if present is None else present[None]
        return replace(drawing, cameras=cameras[None], present=present), [
            replace(layer, poses=layer.poses[None]) if layer.poses.ndim == 2 else layer
            for layer in layers
        ]
    scenes = cameras.shape[:-2]
    flat = replace(
        drawing,
        cameras=cameras.flatten(0, -3),
        present=present if present is None else present.flatten(0, -2),
    )
    return flat, [_flatten_layer(layer, scenes) for layer in layers]


def _flatten_layer(layer: OrientedBoxes, scenes: torch.Size) -> OrientedBoxes:
    flat = {
        field.name: value.flatten(0, len(scenes) - 1)
        for field in fields(layer)
        if (value := getattr(layer, field.name)) is not None
        and value.shape[:-1][: len(scenes)] == scenes
    }
    return replace(layer, **flat)


def draw(drawing: Drawing, boxes: StackedBoxes | None) -> Float[Tensor, "V C H W"]:
    """Draw all views, and the boxes of their scenes.

    Raises:
        ValueError: the pose of a camera or of a present box is not finite, or a box's size is not
            positive.
    """
    view = drawing.view
    cameras, absent = flatten_cameras(drawing.cameras, drawing.present)
    pictures = sample_ground(view, cameras, drawing.ground, drawing.ground.image)
    if drawing.planes:
        pictures = F.pad(pictures, (0, 0, 0, 0, 0, drawing.planes))
    if boxes is not None:
        projected = _project_boxes(drawing, boxes, cameras, pictures.shape[1])
        pictures = composite(pictures.contiguous(), rasterize(view, projected))
    return pictures if absent is None else torch.where(absent[..., None, None], 0.0, pictures)


def _project_boxes(
    drawing: Drawing, boxes: StackedBoxes, cameras: Float[Tensor, "V 3"], channels: int
) -> PixelBoxes:
    """Project the present boxes, view by view in paint order; absent ones get no gradient."""
    view, count = drawing.view, boxes.poses.shape[1]
    views_a_scene = len(cameras) // max(1, len(boxes.poses))
    present = boxes.present
    if present is None:
        present = torch.ones_like(boxes.poses[..., 0], dtype=torch.bool)
    present = present.repeat_interleave(views_a_scene, dim=0)  # (V, N)
    if drawing.present is not None:
        present = present & drawing.present.reshape(-1, 1)
    camera, column = present.nonzero().unbind(1)
    index = camera // max(1, views_a_scene) * count + column
    poses, sizes, colours, triangle_colours = (
        values.expand(len(boxes.poses), -1, -1).flatten(0, 1).index_select(0, index)
        for values in (boxes.poses, boxes.sizes, boxes.colours, boxes.triangle_colours)
    )
    if not (torch.isfinite(torch.cat([poses, sizes], dim=1)).all() and (sizes > 0).all()):
        raise ValueError(
            "a box that is present has a pose that is not finite, or a size that is not a positive "
            "number; mask absent ones by `present`"
        )
    centre, axis = project_poses(view, cameras.index_select(0, camera), poses)
    counts = torch.tensor(boxes.counts, device=index.device)
    layer = torch.repeat_interleave(counts)[column]
    plane = camera * channels
    if drawing.planes:
        plane = plane + channels - drawing.planes + layer
    return PixelBoxes(
        first_pixel=plane * view.height * view.width,
        centre=centre,
        axis=axis,
        sizes=sizes / view.resolution,
        colours=colours,
        triangle_colours=triangle_colours,
        has_triangle=torch.tensor(boxes.has_triangles, device=index.device)[layer],
    )
