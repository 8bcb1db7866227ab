"""Render bird's-eye pictures of an image map with boxes on it, by torch, on any device.

Pictures are batched and differentiable. A scene seen from above is one textured plane and boxes in
layers: no depth, no lighting. A box is evaluated only at the pixels it touches, of which it takes
the share of `coverage`; gradients are those of what is drawn. The ground of all views is one call
of `grid_sample`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from geoaim.rendering.boxes import OrientedBoxes, stack_layers
from geoaim.rendering.drawing import Drawing, draw, flatten_scenes
from geoaim.rendering.ground import Ground, View
from geoaim.rendering.input_checks import check_cameras, check_layers, warn_of_aliasing
from geoaim.rendering.prefiltering import prefilter_ground


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
    >>> from geoaim.rendering.ground import make_ground
    >>> ground = make_ground(torch.zeros(1, 4, 4), torch.eye(3))
    >>> car = OrientedBoxes(torch.zeros(1, 1, 3), torch.tensor([2.0, 1.0]), torch.ones(1))
    >>> picture = render(View(4, 4, 1.0), torch.zeros(1, 3), ground, [car])
    >>> picture[0, 0, :, 1].tolist()
    [0.0, 0.5, 0.75, 0.5]
    """
    layers = list(boxes)
    for layer in layers:
        for colours in (layer.colours, layer.heading_colours):
            if colours is not None and colours.shape[-1] != ground.image.shape[0]:
                channels = colours.shape[-1]
                raise ValueError(
                    f"colours have {channels} channels and the ground has {ground.image.shape[0]}; "
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
    >>> from geoaim.rendering.ground import make_ground
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
    """Check what is drawn, and draw it."""
    shape = drawing.cameras.shape[:-1]
    drawing, layers = flatten_scenes(drawing, layers)
    check_cameras(drawing.cameras, drawing.ground, drawing.present)
    check_layers(layers, drawing.cameras)
    warn_of_aliasing(drawing.view, drawing.ground)
    pictures = draw(drawing, stack_layers(layers) if layers else None)
    return pictures.view(*shape, *pictures.shape[1:])


TENSORS = ("image", "coverage", "image_from_world", "regions")


class Renderer(nn.Module):
    """Renders views of one size of fixed maps.

    Args:
        view: size and resolution of the pictures.
        ground: one map or several; it is prefiltered here, and moves with the module.
        planes: whether boxes get a plane for each layer, as in `render_layers`, instead of colours.

    >>> import torch
    >>> from geoaim.rendering.ground import make_ground
    >>> ground = make_ground(torch.rand(3, 32, 32), torch.eye(3))
    >>> Renderer(View(8, 8, 1.0), ground)(torch.zeros(2, 3)).shape
    torch.Size([2, 3, 8, 8])
    """

    image: Tensor
    coverage: Tensor
    image_from_world: Tensor
    regions: Tensor

    def __init__(self, view: View, ground: Ground, *, planes: bool = False) -> None:
        super().__init__()
        ground = prefilter_ground(ground, view.resolution)
        self.view, self.planes = view, planes
        self._rest = ground.averaged_over, ground.finest, ground.world
        for name in TENSORS:
            self.register_buffer(name, getattr(ground, name), persistent=False)

    @property
    def ground(self) -> Ground:
        """The maps, prefiltered for the view."""
        averaged_over, finest, world = self._rest
        image, coverage, image_from_world, regions = (getattr(self, name) for name in TENSORS)
        return Ground(image, coverage, image_from_world, regions, averaged_over, finest, world)

    def forward(
        self,
        cameras: Float[Tensor, "*B 3"],
        boxes: Iterable[OrientedBoxes] = (),
        *,
        maps: Int[Tensor, "B"] | None = None,
        present: Bool[Tensor, "*B"] | None = None,
    ) -> Float[Tensor, "*B C H W"]:
        """Render the pictures of all cameras.

        Args:
            cameras: (B, 3) or (B, A, 3) x and y, metres, and heading, radians.
            boxes: layers in paint order.
            maps: (B,) number of the map for each view or scene; None: there is one map.
            present: (B, A) which cameras exist; None: all.

        Returns:
            The pictures of `render`, or of `render_layers` if the module has planes.

        Raises:
            ValueError: as in these functions.
        """
        ground = self.ground if maps is None else self.ground.select(maps)
        paint = render_layers if self.planes else render
        return paint(self.view, cameras, ground, boxes, present=present)
