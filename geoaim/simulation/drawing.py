"""What the renderer draws, and how torch draws it: the ground, then fragments of boxes."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.simulation.boxes import OrientedBoxes, StackedBoxes
from geoaim.simulation.compositing import composite
from geoaim.simulation.ground import Ground, View
from geoaim.simulation.rasterization import PixelBoxes, project_poses, rasterize
from geoaim.simulation.sampling import flatten_cameras, sample_ground

BAD_BOX = (
    "a box that is present has a pose that is not finite, or a size that is not a positive number; "
    "mask absent ones by `present`"
)


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
    """Bring cameras of (3,) or (*S, A, 3), and the boxes of the scenes *S, to one axis of scenes.

    What broadcasts over all scenes, such as one colour, stays as it is.
    """
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


def draw_with_torch(drawing: Drawing, boxes: StackedBoxes | None) -> Float[Tensor, "V C H W"]:
    """Draw all views, and the boxes of their scenes, by torch, on any device.

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
        raise ValueError(BAD_BOX)
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
