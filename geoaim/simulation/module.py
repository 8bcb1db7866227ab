"""The renderer as a module of torch, for models that keep their map among their buffers."""

from collections.abc import Iterable

from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from geoaim.simulation.birdview import render, render_layers
from geoaim.simulation.boxes import OrientedBoxes
from geoaim.simulation.ground import Ground, View
from geoaim.simulation.prefiltering import prefilter_ground

TENSORS = ("image", "coverage", "image_from_world", "regions")


class Renderer(nn.Module):
    """Renders views of one size of fixed maps.

    Args:
        view: size and resolution of the pictures.
        ground: one map or several; it is prefiltered here, and moves with the module.
        planes: whether boxes get a plane for each layer, as in `render_layers`, instead of colours.

    >>> import torch
    >>> from geoaim.simulation.ground import make_ground
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
        draw = render_layers if self.planes else render
        return draw(self.view, cameras, ground, boxes, present=present)
