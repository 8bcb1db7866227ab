"""Likelihoods by histograms, with the ranges and weights of the WOSAC challenge.

They are those of challenge_2023_config.textproto and challenge_2024_config.textproto in
github.com/waymo-research/waymo-open-dataset.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Estimator:
    """How the likelihood of a feature is estimated, and its weight in the meta-metric."""

    low: float  # range of the histogram; values beyond it count at its ends
    high: float
    bins: int
    weight: float
    pseudocount: float = 0.1  # added to each bin


# limits, bins and weights of the challenge's year
CONFIG_2024 = {
    "linear speed": Estimator(0.0, 25.0, 10, 0.05),
    "linear acceleration": Estimator(-12.0, 12.0, 11, 0.05),
    "angular speed": Estimator(-0.628, 0.628, 11, 0.05),
    "angular acceleration": Estimator(-3.14, 3.14, 11, 0.05),
    "distance to nearest object": Estimator(-5.0, 40.0, 10, 0.1),
    "time to collision": Estimator(0.0, 5.0, 10, 0.1),
    "distance to road edge": Estimator(-20.0, 40.0, 10, 0.1),
    "collision": Estimator(-0.5, 1.5, 2, 0.25, pseudocount=0.001),
    "off-road": Estimator(-0.5, 1.5, 2, 0.25, pseudocount=0.001),
}


def estimate_log_likelihood(
    logged: Float[Tensor, "E T"],
    simulated: Float[Tensor, "K E S"],
    estimator: Estimator,
    counted: Bool[Tensor, "E S"] | None = None,
) -> Float[Tensor, "E T"]:
    """Estimate the log-likelihood of logged values under a histogram of simulated ones.

    Each agent has its own histogram, of all samples and steps. As in the challenge's code, values
    that do not exist, in the first and last steps, count in the last bin.

    Args:
        logged: values of E agents at T steps.
        simulated: values of the same agents in K samples of S steps.
        estimator: the histogram.
        counted: the simulated steps that count; None: all.

    Returns:
        For each logged value, the logarithm of the share of simulated values in its bin.

    >>> simulated = torch.tensor([[[0.1, 0.2, 0.3, 0.9]]])
    >>> estimator = Estimator(0.0, 1.0, bins=2, weight=1.0, pseudocount=0.0)
    >>> estimate_log_likelihood(torch.tensor([[0.4, 2.0]]), simulated, estimator).exp().tolist()
    [[0.75, 0.25]]
    """
    samples = simulated.transpose(0, 1).flatten(1)  # (E, K * S)
    bins = _find_bins(samples, estimator)
    counts = samples.new_full((len(samples), estimator.bins), estimator.pseudocount)
    weights = torch.ones_like(samples)
    if counted is not None:
        weights = weights * counted.repeat(1, len(simulated))
    counts.scatter_add_(1, bins, weights)
    shares = counts / counts.sum(dim=1, keepdim=True)
    return shares.log().gather(1, _find_bins(logged, estimator))


def _find_bins(values: Float[Tensor, "E M"], estimator: Estimator) -> Int[Tensor, "E M"]:
    """The bin of each value; the last one for NaN."""
    edges = torch.linspace(estimator.low, estimator.high, estimator.bins + 1).to(values)
    clamped = values.clamp(estimator.low, estimator.high).contiguous()
    bins = torch.bucketize(clamped, edges[1:-1], right=True)
    return torch.where(values.isnan(), estimator.bins - 1, bins)
