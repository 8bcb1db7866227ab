"""An atlas: the maps of several places in one plane, so that a batch can mix segments of them."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.simulation.birdview import render
from geoaim.simulation.ground import GREY, Ground, View, make_ground, prefilter_ground

PIXELS_PER_VIEW_PIXEL = 2  # of the atlas, before it is prefiltered for the view


def make_atlas(grounds: Sequence[Ground], view: View) -> tuple[Ground, Float[Tensor, "P 2"]]:
    """Place the maps of P places side by side, north up, further apart than a view reaches.

    Returns:
        One ground, prefiltered for the view, and the metres (x, y) by which each place has moved.
    """
    resolution = view.resolution / PIXELS_PER_VIEW_PIXEL
    margin = math.hypot(view.height, view.width) / 2 * view.resolution
    bounds = [ground.bounds.float() for ground in grounds]
    sizes = [(high - low + 2 * margin).clamp_min(resolution) for low, high in bounds]
    rows = math.ceil(max(float(size[1]) for size in sizes) / resolution)
    tiles, offsets, left = [], [], 0
    for ground, (low, high), size in zip(grounds, bounds, sizes, strict=True):
        columns = math.ceil(float(size[0]) / resolution)
        centre = (low + high) / 2
        camera = torch.cat([centre, centre.new_tensor([math.pi / 2])])[None]
        filtered = prefilter_ground(ground, resolution)
        tiles.append(render(View(rows, columns, resolution), camera, filtered)[0])
        offsets.append(centre.new_tensor([left + columns / 2, -rows / 2]) * resolution - centre)
        left += columns
    image = torch.cat(tiles, dim=2)
    matrix = image.new_tensor([[1 / resolution, 0.0, 0.0], [0.0, -1 / resolution, 0.0]])
    return prefilter_ground(make_ground(image, matrix), view.resolution), torch.stack(offsets)


def make_grey_ground() -> Ground:
    """Make a ground that is grey everywhere: no map."""
    ground = make_ground(torch.full((3, 1, 1), GREY), torch.eye(3)[:2])
    return replace(ground, averaged_over=math.inf)


def scale_ground(ground: Ground, factors: Float[Tensor, "2"]) -> Ground:
    """Scale x and y of the plane in which a ground lies, as `segments.scale` does with segments."""
    inverse = torch.cat([1 / factors, factors.new_ones(1)]).to(ground.image)
    return replace(ground, image_from_world=ground.image_from_world * inverse)
