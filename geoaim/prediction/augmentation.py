"""Augmentation of a batch: the plane scaled and mirrored, the colours of the maps changed."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.prediction.config import TrainConfig
from geoaim.prediction.segments import Segments, scale
from geoaim.simulation.ground import Ground


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
        image = ground.image * gain.to(ground.image) + offset.to(ground.image)
        ground = replace(ground, image=image)
    return scale(segments, factors), scale_ground(ground, factors)


def scale_ground(ground: Ground, factors: Float[Tensor, "2"]) -> Ground:
    """Scale x and y of the planes in which maps lie, as `segments.scale` does with segments."""
    inverse = torch.cat([1 / factors, factors.new_ones(1)]).to(ground.image)
    return replace(ground, image_from_world=ground.image_from_world * inverse)
