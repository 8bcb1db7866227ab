"""What is drawn, and how: the ground is sampled, then fragments of boxes are painted on it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from torch import Tensor
from torch.autograd.function import once_differentiable

from geoaim.rendering.boxes import OrientedBoxes, StackedBoxes
from geoaim.rendering.fragments import Canvas
from geoaim.rendering.ground import Ground, View
from geoaim.rendering.input_checks import check_cameras
from geoaim.rendering.painting import paint_boxes


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
    if not math.isfinite(flat.numpy(force=True).sum()):  # a sum is where all numbers are
        raise ValueError("a camera's pose is not finite; mask absent cameras by `present`")
    return flat, absent


def sample_ground(
    view: View, cameras: Float[Tensor, "V 3"], ground: Ground, image: Float[Tensor, "C h w"]
) -> Float[Tensor, "V C H W"]:
    """Sample textures bilinearly at all pixels; each of M maps has V / M consecutive views."""
    height, width = image.shape[-2:]
    maps, views = ground.regions.shape[0], cameras.shape[0]
    gradients = cameras.requires_grad or image.requires_grad
    if maps == 1 and views > 1 and cameras.stride(0) == 0 and not gradients:  # one, expanded
        one = sample_ground(view, cameras[:1], ground, image)
        return one.expand(views, -1, -1, -1).contiguous()
    given = view, (height, width), cameras, ground.image_from_world
    # without gradients a call of `apply` would take longer than the sums
    make = _Grid.apply if torch.is_grad_enabled() else partial(_Grid.forward, None)
    grid = make(*given)  # type: ignore[no-untyped-call]
    if maps > 1:
        scale = image.new_tensor([2 / width, 2 / height])  # grid_sample: -1 to 1
        edges = ground.regions.repeat_interleave(views // maps, dim=0).to(cameras)
        low, high = (edges[:, :2] + 0.5) * scale - 1, (edges[:, 2:] - 0.5) * scale - 1
        grid = torch.minimum(torch.maximum(grid, low[:, None, None]), high[:, None, None])
    if not image.requires_grad:  # the texture is shared, not copied
        return torch.grid_sampler(image.expand(views, *image.shape), grid, 0, 1, False)
    # its gradient would be copied for each view: all views are one image
    flat = torch.grid_sampler(image[None], grid.reshape(1, -1, view.width, 2), 0, 1, False)
    pictures = flat.view(-1, views, view.height, view.width)
    return pictures.transpose(0, 1).contiguous()


class _Grid(torch.autograd.Function):
    """The places of all pixels in a texture, from -1 to 1, for `grid_sampler`."""

    @staticmethod
    def forward(ctx: Any, view: View, size: tuple[int, int], cameras: Any, matrices: Any) -> Any:
        poses, maps = cameras.numpy(force=True), matrices.numpy(force=True)
        scale = np.array([[2 / size[1]], [2 / size[0]]], maps.dtype)
        turn = np.empty((len(poses), 2, 3), maps.dtype)  # right, down and place, metres
        turn[:, 0, 0], turn[:, 1, 0] = np.sin(poses[:, 2]), -np.cos(poses[:, 2])
        turn[:, 0, 1], turn[:, 1, 1] = turn[:, 1, 0], -turn[:, 0, 0]
        turn[:, :, 2] = poses[:, :2]
        maps = maps * scale
        if 1 < len(maps) < len(poses):
            maps = np.repeat(maps, len(poses) // len(maps), axis=0)
        places = maps[:, :, :2] @ turn
        places[:, :, 2] += maps[:, :, 2] - 1
        columns, rows = (_count(n, view.resolution, maps.dtype) for n in (view.width, view.height))
        across = places[:, :, 0:1, None] * columns + places[:, :, 2:3, None]
        down = places[:, :, 1:2, None] * rows[:, None]
        if ctx is not None:
            ctx.kept = columns, rows, turn, maps, scale, matrices.shape, cameras.device
        parts = (torch.from_numpy(part).to(cameras.device) for part in (across, down))
        return torch.add(*parts).permute(0, 2, 3, 1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Any) -> Any:
        columns, rows, turn, maps, scale, shape, device = ctx.kept
        by_column, by_row = (grad.sum(dim).numpy(force=True) for dim in (1, 2))  # (V, W or H, 2)
        by_place = np.stack([columns @ by_column, rows @ by_row, by_column.sum(1)], axis=-1)
        by_turn = maps[:, :, :2].swapaxes(1, 2) @ by_place
        by_maps = by_place @ turn.swapaxes(1, 2)
        by_maps = np.concatenate([by_maps, by_place[:, :, 2:]], axis=2) * scale
        by_maps = by_maps.reshape(shape[0], -1, 2, 3).sum(1) if shape[0] else by_maps
        sine, cosine = turn[:, 0, 0], -turn[:, 1, 0]
        heading = cosine * (by_turn[:, 0, 0] - by_turn[:, 1, 1])
        heading += sine * (by_turn[:, 1, 0] + by_turn[:, 0, 1])
        by_camera = np.concatenate([by_turn[:, :, 2], heading[:, None]], axis=1)
        return None, None, *(torch.from_numpy(a).to(device) for a in (by_camera, by_maps))


@lru_cache(maxsize=64)
def _count(count: int, step: float, dtype: Any) -> Float[Array, "n"]:
    """Count the places of a picture's columns or rows from its middle."""
    return ((np.arange(count) + 0.5 - count / 2) * step).astype(dtype)


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
    cameras, absent = flatten_cameras(drawing.cameras, drawing.present)
    pictures = sample_ground(drawing.view, cameras, drawing.ground, drawing.ground.image)
    if drawing.planes:
        pictures = F.pad(pictures, (0, 0, 0, 0, 0, drawing.planes))
    if boxes is not None:
        present = None if absent is None else ~absent.numpy(force=True)
        canvas = Canvas(drawing.view, cameras.numpy(force=True), present, drawing.planes)
        pictures = paint_boxes(canvas, boxes, pictures.contiguous(), cameras)
    return pictures if absent is None else torch.where(absent[..., None, None], 0.0, pictures)
