"""Worlds of tensors: what lies in another plane is moved where that is exact, else refused."""

from dataclasses import replace

import torch
import torch.nn.functional as F

from geoaim.base.errors import MapError
from geoaim.base.world import World, describe_world
from geoaim.simulation.ground import Ground


def find_offset(source: World | None, target: World | None, name: str) -> tuple[float, float]:
    """Find what has to be added to x and y of one world to have them in another.

    Args:
        source: the world of the data; None: not known, taken to be the target.
        target: the world to move to; None: not known, taken to be the source.
        name: what the data are called in the message.

    Returns:
        Metres east and north.

    Raises:
        MapError: the two have different CRSs, between which no shift is exact, or are two local
            planes with different origins.

    >>> find_offset(World("EPSG:32635", (10.0, 0.0)), World("EPSG:32635", (4.0, 1.0)), "lanes")
    (6.0, -1.0)
    """
    if source is None or target is None or source == target:
        return 0.0, 0.0
    if source.crs != target.crs or source.crs is None:
        raise MapError(
            f"the {name} lie in {describe_world(source)}, and are needed in "
            f"{describe_world(target)}; read or make them in that world, such as by "
            "read_hdmap(path, aim.world)"
        )
    (east, north), (there_east, there_north) = source.origin, target.origin
    return east - there_east, north - there_north


def move_transform(pixels_from_world: torch.Tensor, offset: tuple[float, float]) -> torch.Tensor:
    """Change transforms (..., 2, 3) from a world to those from a world moved by an offset."""
    matrix = pixels_from_world.double()
    shift = (matrix[..., :2] * matrix.new_tensor(offset)).sum(-1, keepdim=True)
    return (matrix - F.pad(shift, (2, 0))).to(pixels_from_world)


def move_ground(ground: Ground, world: World | None) -> Ground:
    """Move a ground to a world of the same CRS; one whose world is not known stays where it is.

    Raises:
        MapError: the move would not be exact.
    """
    offset = find_offset(ground.world, world, "maps")
    if offset == (0.0, 0.0):
        return ground
    return replace(
        ground, image_from_world=move_transform(ground.image_from_world, offset), world=world
    )
