"""Parts of the evidence lower bound that a training maximizes."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.prediction.config import Config
from geoaim.simulation.kinematics import wrap_angle

SPEED_SCALE_S = 0.5  # an error of 1 m/s counts as this many metres in the likelihood


@dataclass(frozen=True, eq=False)
class Losses:
    """Means over controlled agents and predicted steps."""

    # negative log-likelihood of the ground-truth states, without its constant
    nll: Float[Tensor, ""]
    kl: Float[Tensor, ""]  # Kullback-Leibler divergence of the posterior from the prior, nats
    anchor: Float[Tensor, ""]  # `compute_anchor_loss` of the proposals, metres; 0 without proposals


def compute_nll(
    config: Config, predicted: Float[Tensor, "E t 4"], truth: Float[Tensor, "E t 4"]
) -> Float[Tensor, ""]:
    """Compute the negative log-likelihood of true states, without its constant.

    Args:
        config: the model's `sigma` and `heading_scale`.
        predicted: states of the controlled agents.
        truth: their true states.

    Returns:
        The mean over agents and steps.
    """
    scales = truth.new_tensor([1.0, 1.0, config.heading_scale, SPEED_SCALE_S])
    error = _subtract(predicted, truth) * (scales / config.sigma)
    return 0.5 * error.square().sum(dim=2).mean()


def _subtract(states: Float[Tensor, "E t 4"], truth: Float[Tensor, "E t 4"]) -> Tensor:
    """Difference of states, headings wrapped to [-pi, pi)."""
    x, y, heading, speed = (states - truth).unbind(-1)
    return torch.stack([x, y, wrap_angle(heading), speed], dim=-1)


def draw_posterior(
    parameters: Float[Tensor, "E _"], generator: torch.Generator
) -> tuple[Float[Tensor, "E Z"], Float[Tensor, "E"]]:
    """Draw latents of a posterior from its means and log scales, which are clamped.

    Returns:
        The latents, and the divergence of the posterior from the prior, nats.
    """
    mean, log_scale = parameters.chunk(2, 1)
    log_scale = log_scale.clamp(-5, 3)
    scale = log_scale.exp()
    divergence = (0.5 * (mean**2 + scale**2 - 1) - log_scale).sum(dim=1)
    noise = torch.randn(mean.shape, generator=generator, device=mean.device)
    return mean + scale * noise, divergence
