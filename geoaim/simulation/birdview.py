"""Bird's-eye pictures of an image map with boxes painted on it, batched and differentiable.

A scene seen from above is one textured plane and boxes in a fixed paint order: no depth, no
lighting. All views of one texture are sampled by one `grid_sample`. A box is evaluated only at the
pixels it touches, whose coverage is exact, so that gradients by its pose and size are exact too.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.simulation.compositing import composite
from geoaim.simulation.ground import Ground, View, sample_ground, unflatten_views
from geoaim.simulation.rasterization import PixelBoxes, project_poses, rasterize


@dataclass(frozen=True, eq=False)
class OrientedBoxes:
    """Oriented boxes in B views; later ones are painted over earlier ones."""

    poses: Float[Tensor, "B A 3"]  # x and y of the centre, metres, and heading, radians
    sizes: Float[Tensor, "... A 2"]  # (B, A, 2) or (A, 2) length and width, metres
    colours: Float[Tensor, "... A C"]  # (B, A, C) or (A, C)
    present: Bool[Tensor, "B A"] | None = None  # (B, A); None: all are present
    # (B, A, C) or (A, C) of the triangle on each box that shows its heading; None: no triangles
    heading_colours: Float[Tensor, "... A C"] | None = None


def render(
    view: View, cameras: Float[Tensor, "B 3"], ground: Ground, boxes: Sequence[OrientedBoxes] = ()
) -> Float[Tensor, "B C H W"]:
    """Render the pictures of all cameras.

    Gradients flow to cameras, poses, sizes, colours and the ground's image.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x and y, metres, and heading, radians.
        ground: from `make_ground`; `prefilter_ground` it first where it is finer than the view.
        boxes: agents, lights, ... in paint order.

    Returns:
        (B, C, H, W) colours.

    Raises:
        ValueError: shapes do not match, the pose of a present box is not finite, or its size is not
            positive.

    >>> from geoaim.simulation.ground import make_ground
    >>> ground = make_ground(torch.zeros(1, 4, 4), torch.eye(3)[:2])
    >>> car = OrientedBoxes(torch.zeros(1, 1, 3), torch.tensor([[2.0, 1.0]]), torch.ones(1, 1))
    >>> picture = render(View(4, 4, 1.0), torch.zeros(1, 3), ground, [car])
    >>> picture[0, 0, :, 1].tolist()
    [0.0, 0.5, 0.75, 0.5]
    """
    _check_inputs(cameras, ground, boxes)
    for layer in boxes:
        for colours in (layer.colours, layer.heading_colours):
            if colours is not None and colours.shape[-1] != len(ground.image):
                channels = colours.shape[-1]
                raise ValueError(
                    f"colours have {channels} channels and the ground has {len(ground.image)}; "
                    "give as many"
                )
    pixels = sample_ground(view, cameras, ground.image, ground.image_from_world)
    if boxes:
        pixels = composite(pixels, rasterize(view, _collect_boxes(view, cameras, boxes)))
    return unflatten_views(pixels, view)


def render_layers(
    view: View, cameras: Float[Tensor, "B 3"], ground: Ground, boxes: Sequence[OrientedBoxes] = ()
) -> Float[Tensor, "B K H W"]:
    """Render channels for models: the ground's colours, then a plane for each layer of boxes.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x and y, metres, and heading, radians.
        ground: as for `render`.
        boxes: layers, whose colours are not used.

    Returns:
        (B, C + layers, H, W); a plane is 1 in boxes, 0.5 in the triangles that show headings.

    Raises:
        ValueError: as by `render`.

    >>> from geoaim.simulation.ground import make_ground
    >>> ground = make_ground(torch.zeros(3, 4, 4), torch.eye(3)[:2])
    >>> car = OrientedBoxes(torch.zeros(1, 1, 3), torch.tensor([[2.0, 1.0]]), torch.ones(1, 3))
    >>> render_layers(View(4, 4, 1.0), torch.zeros(1, 3), ground, [car, car]).shape
    torch.Size([1, 5, 4, 4])
    """
    _check_inputs(cameras, ground, boxes)
    pixels = sample_ground(view, cameras, ground.image, ground.image_from_world)
    if boxes:
        planes = [_set_plane_colours(layer) for layer in boxes]
        collected = _collect_boxes(view, cameras, planes, separate=True)
        pixels = composite(pixels, rasterize(view, collected), len(boxes))
    return unflatten_views(pixels, view)


def _set_plane_colours(layer: OrientedBoxes) -> OrientedBoxes:
    """Set the colours of a plane: 1, and 0.5 in triangles."""
    one = torch.ones_like(layer.poses[..., :1])
    triangles = None if layer.heading_colours is None else one / 2
    return replace(layer, colours=one, heading_colours=triangles)


def _collect_boxes(
    view: View,
    cameras: Float[Tensor, "B 3"],
    layers: Sequence[OrientedBoxes],
    *,
    separate: bool = False,
) -> PixelBoxes:
    """Collect the present boxes picture by picture, in paint order; absent ones get no gradient.

    With `separate`, each layer has pictures of its own, which follow those of the last layer.
    """
    present = torch.cat([_get_present(layer) for layer in layers], dim=1)  # (B, all A)
    camera, column = present.nonzero().unbind(1)
    index = camera * present.shape[1] + column
    poses = _gather((layer.poses for layer in layers), len(cameras), index)
    sizes = _gather((layer.sizes for layer in layers), len(cameras), index)
    if not (torch.isfinite(torch.cat([poses, sizes], dim=1)).all() and (sizes > 0).all()):
        raise ValueError(
            "a box that is present has a pose that is not finite, or a size that is not "
            "a positive number; mask absent ones by `present`"
        )
    centre, axis = project_poses(view, cameras.index_select(0, camera), poses)
    counts = torch.tensor([layer.poses.shape[1] for layer in layers], device=index.device)
    layer_of = torch.repeat_interleave(counts)[column]
    triangles = [layer.heading_colours for layer in layers]
    has_triangle = torch.tensor([colour is not None for colour in triangles], device=index.device)
    colours = [layer.colours for layer in layers]
    filled = (c if t is None else t for c, t in zip(colours, triangles, strict=True))
    return PixelBoxes(
        picture=camera + len(cameras) * layer_of if separate else camera,
        centre=centre,
        axis=axis,
        sizes=sizes / view.resolution,
        colours=_gather(colours, len(cameras), index),
        triangle_colours=_gather(filled, len(cameras), index),
        has_triangle=has_triangle[layer_of],
    )


def _get_present(layer: OrientedBoxes) -> Bool[Tensor, "B A"]:
    if layer.present is None:
        return layer.poses.new_ones(layer.poses.shape[:2], dtype=torch.bool)
    return layer.present


def _gather(values: Iterable[Tensor], views: int, index: Int[Tensor, "N"]) -> Float[Tensor, "N C"]:
    """Gather values of some boxes from those of all layers: (B, A, C) or (A, C) each."""
    table = torch.cat([value.expand(views, *value.shape[-2:]) for value in values], dim=1)
    return table.flatten(0, 1).index_select(0, index)


def _check_inputs(
    cameras: Float[Tensor, "B 3"], ground: Ground, boxes: Sequence[OrientedBoxes]
) -> None:
    """Refuse inputs that would give a wrong picture."""
    dtypes = {cameras.dtype, ground.image.dtype, ground.image_from_world.dtype}
    for layer in boxes:
        dtypes |= {layer.poses.dtype, layer.sizes.dtype, layer.colours.dtype}
    if len(dtypes) > 1:
        names = ", ".join(sorted(map(str, dtypes)))
        raise ValueError(f"tensors have dtypes {names}; convert them to one dtype")
    if not torch.isfinite(cameras).all():
        raise ValueError("a camera's pose is not finite")
    for layer in boxes:
        _check_shapes(layer, len(cameras))


def _check_shapes(layer: OrientedBoxes, cameras: int) -> None:
    """Refuse boxes whose number of views or shapes do not match."""
    views, count = layer.poses.shape[:2]
    if views != cameras:
        raise ValueError(f"boxes are given for {views} views and {cameras} cameras; one each")
    per_box, per_view = (count,), (views, count)
    triangles = layer.heading_colours
    for name, shape, allowed in (
        ("sizes", layer.sizes.shape[:-1], (per_view, per_box)),
        ("colours", layer.colours.shape[:-1], (per_view, per_box)),
        ("present", per_view if layer.present is None else layer.present.shape, (per_view,)),
        (
            "heading_colours",
            per_box if triangles is None else triangles.shape[:-1],
            (per_view, per_box),
        ),
    ):
        if tuple(shape) not in allowed:
            raise ValueError(
                f"{name} has shape {tuple(shape)}; expected (views, boxes) = {per_view}"
            )
