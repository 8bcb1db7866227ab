"""Many maps in one plane: a batch of segments of all places is then drawn at once."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.simulation.birdview import render
from geoaim.simulation.ground import Ground, View, bounds_of, fit_ground, make_ground

FINER = 2  # pixels of the atlas for one of a view


def make_atlas(grounds: Sequence[Ground], view: View) -> tuple[Ground, Float[Tensor, "P 2"]]:
    """Lay grounds side by side, north up, further apart than a view reaches.

    Args:
        grounds: maps of any places.
        view: what will be drawn of them; its resolution decides that of the atlas.

    Returns:
        One ground, and what to add to x and y of each place.
    """
    metres = view.resolution / FINER
    margin = math.hypot(view.height, view.width) / 2 * view.resolution
    boxes = [bounds_of(ground).float() for ground in grounds]
    sizes = [(box[1] - box[0] + 2 * margin).clamp_min(metres) for box in boxes]
    rows = math.ceil(max(float(size[1]) for size in sizes) / metres)
    tiles, offsets, column = [], [], 0
    for ground, box, size in zip(grounds, boxes, sizes, strict=True):
        columns = math.ceil(float(size[0]) / metres)
        middle = (box[0] + box[1]) / 2
        camera = torch.cat([middle, middle.new_tensor([math.pi / 2])])[None]
        tiles.append(render(View(rows, columns, metres), camera, fit_ground(ground, metres))[0])
        place = middle.new_tensor([column + columns / 2, -rows / 2]) * metres
        offsets.append(place - middle)
        column += columns
    image = torch.cat(tiles, dim=2)
    matrix = image.new_tensor([[1 / metres, 0.0, 0.0], [0.0, -1 / metres, 0.0]])
    return fit_ground(make_ground(image, matrix), view.resolution), torch.stack(offsets)


def no_map() -> Ground:
    """Grey everywhere."""
    return make_ground(torch.full((3, 1, 1), 0.5), torch.eye(3)[:2])


def ground_scaled(ground: Ground, sides: Float[Tensor, "2"]) -> Ground:
    """The ground in a plane whose x and y are so many times as long."""
    smaller = torch.cat([1 / sides, sides.new_ones(1)]).to(ground.image)
    return replace(ground, image_from_world=ground.image_from_world * smaller)
