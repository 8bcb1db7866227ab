"""An atlas: the textures of several maps of any size in one image, for batches of their views."""

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F

from geoaim.rendering.ground import Ground


def stack_grounds(grounds: Sequence[Ground]) -> Ground:
    """Put maps into one ground, of which `Ground.select` then chooses a map for each view.

    Their textures are copied into one image, in rows of similar heights ("shelves"), so that views
    of different maps are one call of `grid_sample`. `prefilter_ground` them first, all for the
    same resolution.

    Args:
        grounds: the maps' grounds, all of one dtype, device and number of channels.

    Returns:
        The ground of all of their maps, in the order given.

    Raises:
        ValueError: there are none, or they differ in dtype, device, channels or `averaged_over`.

    >>> from geoaim.rendering.ground import make_ground
    >>> small, large = (make_ground(torch.zeros(3, n, n), torch.eye(3)) for n in (4, 8))
    >>> both = stack_grounds([small, large])
    >>> both.regions.tolist()
    [[0, 10, 6, 16], [0, 0, 10, 10]]
    >>> views = both.select(torch.tensor([0, 0, 1]))  # two views of the small map, one of the other
    """
    first = grounds[0] if grounds else None
    for ground in grounds:
        if _describe(ground) != _describe(first):
            raise ValueError(
                f"the grounds differ: one has {_describe(first)}, one {_describe(ground)} (dtype, "
                "device, channels, metres averaged over)"
            )
    if first is None:
        raise ValueError("no ground was given; one or more are needed")
    if len(grounds) == 1:
        return first
    places, (height, width) = pack_rectangles([_get_size(ground) for ground in grounds])
    image = first.image.new_zeros(height, width, len(first.image))
    coverage = first.coverage.new_zeros(1, height, width)
    matrices, regions = [], []
    for ground, (row, column) in zip(grounds, places, strict=True):
        rows, columns = _get_size(ground)
        area = slice(row, row + rows), slice(column, column + columns)
        image[area] = ground.image.permute(1, 2, 0)
        coverage[:, area[0], area[1]] = ground.coverage
        offset = ground.image_from_world.new_tensor([column, row])
        matrices.append(ground.image_from_world + F.pad(offset[:, None], (2, 0)))
        regions.append(ground.regions + ground.regions.new_tensor([column, row] * 2))
    return Ground(
        image.permute(2, 0, 1),
        coverage,
        torch.cat(matrices),
        torch.cat(regions),
        first.averaged_over,
        min(ground.finest for ground in grounds),
        first.world if all(ground.world == first.world for ground in grounds) else None,
    )


def unstack_ground(ground: Ground) -> list[Ground]:
    """Take a ground of several maps apart into those of one map each."""
    if len(ground.regions) == 1:
        return [ground]
    parts = []
    for matrix, region in zip(ground.image_from_world, ground.regions, strict=True):
        left, top, right, bottom = region.tolist()
        offset = F.pad(matrix.new_tensor([left, top])[:, None], (2, 0))
        parts.append(
            Ground(
                ground.image[:, top:bottom, left:right],
                ground.coverage[:, top:bottom, left:right],
                (matrix - offset)[None],
                (region - region.new_tensor([left, top, left, top]))[None],
                ground.averaged_over,
                ground.finest,
                ground.world,
            )
        )
    return parts


def _describe(ground: Ground | None) -> tuple[object, ...]:
    if ground is None:
        return ()
    image = ground.image
    return image.dtype, image.device, len(image), ground.averaged_over


def _get_size(ground: Ground) -> tuple[int, int]:
    _, height, width = ground.image.shape
    return height, width


def pack_rectangles(
    sizes: Sequence[tuple[int, int]],
) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Place rectangles (height, width) on shelves, the highest first; also gives their size."""
    order = sorted(range(len(sizes)), key=lambda k: sizes[k], reverse=True)
    area = sum(height * width for height, width in sizes)
    limit = max(math.isqrt(area), max(width for _, width in sizes))
    places = [(0, 0)] * len(sizes)
    top, left, bottom, right = 0, 0, 0, 0
    for k in order:
        height, width = sizes[k]
        if left + width > limit:  # the next shelf
            top, left = bottom, 0
        places[k] = top, left
        left, bottom = left + width, max(bottom, top + height)
        right = max(right, left)
    return places, (bottom, right)
