"""Augmentation of a batch: the plane scaled and mirrored; maps recoloured, misplaced, resized."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.prediction.config import TrainConfig
from geoaim.prediction.segments import Segments, scale
from geoaim.rendering.ground import Ground


def augment(
    config: TrainConfig, segments: Segments, ground: Ground, draws: torch.Generator
) -> tuple[Segments, Ground]:
    """Augment the segments of a batch and their maps, all in the same way.

    Args:
        config: strengths of the augmentation.
        segments: the segments of the batch.
        ground: the maps.
        draws: source of randomness.

    Returns:
        The segments and the maps, changed.
    """
    size, side = torch.rand(2, generator=draws)
    factors = (1 + config.scale_jitter * (2 * size - 1)).repeat(2)
    if config.mirror and side > 0.5:
        factors = factors * factors.new_tensor([1.0, -1.0])
    if config.colour_jitter:
        gain = 1 + config.colour_jitter * (2 * torch.rand(3, 1, 1, generator=draws) - 1)
        offset = config.colour_jitter * (torch.rand(3, 1, 1, generator=draws) - 0.5)
        image = torch.addcmul(offset.to(ground.image), ground.image, gain.to(ground.image))
        ground = replace(ground, image=image)
    if config.map_shift or config.map_scale:
        ground = misplace_ground(ground, config.map_shift, config.map_scale, draws)
    return scale(segments, factors), scale_ground(ground, factors)


def misplace_ground(ground: Ground, shift: float, scale: float, draws: torch.Generator) -> Ground:
    """Shift each map by up to `shift` metres, and scale it about its middle by up to 1 + `scale`.

    Args:
        ground: M maps.
        shift: most metres.
        scale: largest share.
        draws: source of randomness.

    Returns:
        The maps as an erroneous georeference would place them.
    """
    matrix = ground.image_from_world.cpu()  # (M, 2, 3)
    size, length, angle = torch.rand(3, len(matrix), 1, 1, generator=draws).to(matrix)
    factor = 1 + scale * (2 * size - 1)  # (M, 1, 1)
    angle = 2 * torch.pi * angle
    offset = shift * length * torch.cat([angle.cos(), angle.sin()], dim=1)  # (M, 2, 1)
    middle = ground.bounds.cpu().mean(dim=1)[..., None].to(matrix)  # (M, 2, 1)
    linear = matrix[..., :2] / factor
    # the ground of a world point x is taken from middle + (x - offset - middle) / factor
    moved = matrix[..., :2] @ middle + matrix[..., 2:] - linear @ (middle + offset)
    changed = torch.cat([linear, moved], dim=2).to(ground.image_from_world)
    return replace(ground, image_from_world=changed)


def scale_ground(ground: Ground, factors: Float[Tensor, "2"]) -> Ground:
    """Scale x and y of the planes in which maps lie, as `segments.scale` does with segments."""
    inverse = torch.cat([1 / factors, factors.new_ones(1)]).to(ground.image)
    return replace(ground, image_from_world=ground.image_from_world * inverse)
