"""Predictions that need no training: what every model must beat."""

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.prediction.segments import PERSON, Segments, repeated
from geoaim.simulation.policies import constant_turn_rate, constant_velocity
from geoaim.simulation.simulator import Policy, Recording, rollout

ANGLE, SPEED = 0.3, 0.3  # rad, and share: usual spread of where people go and how fast
BASELINES = ("constant velocity", "constant velocity with noise", "constant turn rate")


def predict_plainly(
    name: str,
    segments: Segments,
    *,
    observed: int,
    samples: int,
    generator: torch.Generator,
) -> Float[Tensor, "S K T A 4"]:
    """Futures by one of `BASELINES`; only the noisy one has samples that differ.

    Noise turns and quickens each agent once, at the last observed step (Schöller et al. 2020).

    Raises:
        ValueError: there is no such baseline.
    """
    if name not in BASELINES:
        raise ValueError(f"there is no baseline {name!r}; there are {', '.join(BASELINES)}")
    noisy = name == BASELINES[1]
    many = repeated(segments, samples if noisy else 1)
    states = many.states
    if noisy:
        shape = len(many), states.shape[2], 2
        noise = torch.randn(shape, generator=generator, device=states.device)
        noise = torch.where(many.controlled[..., None], noise, 0.0)
        now = states[:, observed - 1]
        turned = now[..., 2] + ANGLE * noise[..., 0]
        faster = now[..., 3] * (1 + SPEED * noise[..., 1])
        now = torch.stack([now[..., 0], now[..., 1], turned, faster], dim=-1)
        states = torch.cat([states[:, : observed - 1], now[:, None], states[:, observed:]], dim=1)
    recording = Recording(states, many.present, many.sizes, many.planes == PERSON, many.seconds)
    policy: Policy = constant_turn_rate if name == BASELINES[2] else constant_velocity
    found = rollout(recording, policy, many.controlled, observed=observed).states
    found = found.view(len(segments), -1, *found.shape[1:])
    return found if noisy else found.expand(-1, samples, -1, -1, -1)
