"""How far views are from those that a model was trained on, so that unknown ground is said.

The distance is that of Mahalanobis (1936) between features of the view's encoder and those of
training views, as Lee et al. 2018 use it to find what a network does not know.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.prediction.itra import ITRA
from geoaim.prediction.segments import Segments, move_to, pick
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground

MAX_SEGMENTS = 512  # whose views are measured
KNOWN_SHARE = 0.95  # share of views in validation that count as known
SHRINKAGE = 0.01  # of the covariance towards its mean variance, so that it can be inverted


@dataclass(frozen=True, eq=False)
class KnownViews:
    """Features of the views that a model knows (F features)."""

    mean: Float[Tensor, "F"]  # mean over training views
    whitening: Float[Tensor, "F F"]  # features minus the mean, times this, have unit covariance
    limit: float  # the distance within which `KNOWN_SHARE` of the views in validation lie

    def measure(self, features: Float[Tensor, "E F"]) -> Float[Tensor, "E"]:
        """Measure the distance of views: below 1, known; the larger, the stranger."""
        offsets = (features - self.mean) @ self.whitening
        return offsets.square().mean(dim=1).sqrt() / self.limit


def learn_known_views(
    model: ITRA, train: Segments, val: Segments, ground: Ground, *, step: int
) -> KnownViews:
    """Learn what views a model knows.

    Args:
        model: a trained model with observations.
        train: the segments that it was trained on.
        val: segments that set the limit.
        ground: the maps of both, prefiltered.
        step: index of the step whose views are taken.

    Returns:
        Mean, covariance and limit.
    """
    known, held_out = (_encode_some(model, segments, ground, step) for segments in (train, val))
    mean = known.mean(dim=0)
    covariance = torch.cov(known.double().T)
    scale = covariance.diagonal().mean().clamp_min(1e-12)
    identity = torch.eye(len(mean)).to(covariance)
    covariance = (1 - SHRINKAGE) * covariance + SHRINKAGE * scale * identity
    whitening = torch.linalg.cholesky(torch.linalg.inv(covariance)).float()
    distances = KnownViews(mean, whitening, 1.0).measure(held_out)
    return KnownViews(mean, whitening, max(float(distances.quantile(KNOWN_SHARE)), 1e-6))


def measure_strangeness(
    model: ITRA, segments: Segments, ground: Ground, *, step: int
) -> Float[Tensor, "E"] | None:
    """Measure how strange the views of all controlled agents are to a model.

    Args:
        model: a model.
        segments: segments with E controlled agents that are present at the step.
        ground: the map.
        step: index of the step.

    Returns:
        Distances, of which 95 % were below 1 in validation; None if the model does not tell.
    """
    if model.known_views is None:
        return None
    return model.known_views.measure(_encode_some(model, segments, ground, step))


@torch.no_grad()
def _encode_some(
    model: ITRA, segments: Segments, ground: Ground, step: int
) -> Float[Tensor, "E F"]:
    stride = -(-len(segments) // MAX_SEGMENTS)
    some = move_to(pick(segments, slice(None, None, stride)), ground.image.device)
    return model.encode_views(some, prefilter_ground(ground, model.config.resolution), step).float()
