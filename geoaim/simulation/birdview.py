"""Render bird's-eye pictures of an image map with boxes, by compiled loops or by torch.

Pictures are batched and differentiable. A scene seen from above is one textured plane and boxes in
a fixed paint order: no depth, no lighting. A box is evaluated only at the pixels it touches, whose
coverage is exact, so that gradients with respect to its pose and size are exact too. On CPUs,
compiled loops do this where numba is installed (the extra `fast`); elsewhere torch does, and all
views are one call of `grid_sample`.
"""

import importlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache

from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.base.errors import warn
from geoaim.simulation.boxes import OrientedBoxes, stack_layers
from geoaim.simulation.drawing import Drawing, draw_with_torch, flatten_scenes
from geoaim.simulation.ground import Ground, View
from geoaim.simulation.input_checks import check_cameras, check_layers, warn_of_aliasing


def render(
    view: View,
    cameras: Float[Tensor, "*B 3"],
    ground: Ground,
    boxes: Iterable[OrientedBoxes] = (),
    *,
    present: Bool[Tensor, "*B"] | None = None,
) -> Float[Tensor, "*B C H W"]:
    """Render the pictures of all cameras.

    Gradients flow to cameras, poses, sizes, colours, and the ground's image and place. They cannot
    be differentiated again.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x and y, metres, and heading, radians; or (B, A, 3) of A views of each of B
            scenes. There may be more axes of scenes before A, which the boxes then have before
            theirs, or none: (3,) is one view.
        ground: one map for all views, or one for each of the B views or scenes (see
            `Ground.select`); call `prefilter_ground` first where its pixels are smaller than the
            view's.
        boxes: layers of agents, lights, ... in paint order, each in B scenes.
        present: (B, A) which cameras of (B, A, 3) exist; the others may hold any numbers, and their
            pictures are 0. None: all.

    Returns:
        (B, C, H, W) or (B, A, C, H, W) colours, contiguous; the cameras' axes come first.

    Raises:
        ValueError: shapes or dtypes do not match, the pose of a camera or of a present box is not
            finite, or a box's size is not positive.

    Warns:
        GeoaimWarning: the ground's pixels, averaged or not, are smaller than half of the view's, so
            that the view aliases.

    >>> import torch
    >>> from geoaim.simulation.ground import make_ground
    >>> ground = make_ground(torch.zeros(1, 4, 4), torch.eye(3))
    >>> car = OrientedBoxes(torch.zeros(1, 1, 3), torch.tensor([2.0, 1.0]), torch.ones(1))
    >>> picture = render(View(4, 4, 1.0), torch.zeros(1, 3), ground, [car])
    >>> picture[0, 0, :, 1].tolist()
    [0.0, 0.5, 0.75, 0.5]
    """
    layers = list(boxes)
    for layer in layers:
        for colours in (layer.colours, layer.heading_colours):
            if colours is not None and colours.shape[-1] != len(ground.image):
                channels = colours.shape[-1]
                raise ValueError(
                    f"colours have {channels} channels and the ground has {len(ground.image)}; "
                    "give as many"
                )
    return _draw(Drawing(view, cameras, ground, present), layers)


def render_layers(
    view: View,
    cameras: Float[Tensor, "*B 3"],
    ground: Ground,
    boxes: Iterable[OrientedBoxes] = (),
    *,
    present: Bool[Tensor, "*B"] | None = None,
) -> Float[Tensor, "*B K H W"]:
    """Render channels for models: the ground's colours, then a plane for each layer of boxes.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3), (B, A, 3) or more axes, as in `render`.
        ground: the map or maps, as in `render`.
        boxes: layers, whose colours are not used.
        present: which cameras exist, as in `render`.

    Returns:
        (B, C + layers, H, W) or (B, A, C + layers, H, W); a plane is 1 in boxes, 0.5 in the
        triangles that show headings.

    Raises:
        ValueError: as in `render`.

    >>> import torch
    >>> from geoaim.simulation.ground import make_ground
    >>> ground = make_ground(torch.zeros(3, 4, 4), torch.eye(3))
    >>> car = OrientedBoxes(torch.zeros(1, 1, 3), torch.tensor([2.0, 1.0]), torch.ones(3))
    >>> render_layers(View(4, 4, 1.0), torch.zeros(1, 3), ground, [car, car]).shape
    torch.Size([1, 5, 4, 4])
    """
    planes = [_set_plane_colours(layer) for layer in boxes]
    return _draw(Drawing(view, cameras, ground, present, planes=len(planes)), planes)


def _set_plane_colours(layer: OrientedBoxes) -> OrientedBoxes:
    """Set the colours of a plane: 1, and 0.5 in triangles."""
    one = layer.poses.new_ones(1)
    triangles = None if layer.heading_colours is None else one / 2
    return replace(layer, colours=one, heading_colours=triangles)


def _draw(drawing: Drawing, layers: Sequence[OrientedBoxes]) -> Float[Tensor, "*B C H W"]:
    """Draw by the compiled loops on CPUs, where numba is installed; else by torch."""
    shape = drawing.cameras.shape[:-1]
    drawing, layers = flatten_scenes(drawing, layers)
    check_cameras(drawing.cameras, drawing.ground, drawing.present)
    check_layers(layers, drawing.cameras)
    warn_of_aliasing(drawing.view, drawing.ground)
    boxes = stack_layers(layers) if layers else None
    compiled = drawing.cameras.device.type == "cpu" and _has_kernel()
    if compiled:
        from geoaim.simulation.kernel.function import draw_with_kernel as draw
    else:
        draw = draw_with_torch
    pictures = draw(drawing, boxes)
    return pictures.view(*shape, *pictures.shape[1:])


@cache
def _has_kernel() -> bool:
    """Whether numba can be imported, and is not turned off by GEOAIM_RENDERER=torch."""
    if os.environ.get("GEOAIM_RENDERER") == "torch":
        return False
    try:
        importlib.import_module("numba")
    except ModuleNotFoundError:
        return False
    except ImportError as error:  # such as of a numba for another numpy
        warn(f"numba cannot be imported ({error}); torch draws the same views, more slowly")
        return False
    return True
