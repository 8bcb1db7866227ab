"""Choose the transform model that the control points make most probable, by its evidence."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy import ndarray as Array
from scipy.special import logsumexp, softmax

from geoaim.mapping.georeference.posterior import compute_log_noise_prior, compute_log_prior
from geoaim.mapping.georeference.transform_models import (
    TERM_COUNTS,
    PointPairs,
    Points,
    Posterior,
    Terms,
    fit_terms,
    invert_normal_matrix,
)

# logarithms of candidates for the noise, over the expected one
LOG_NOISES = np.linspace(-np.log(100.0), np.log(100.0), 200)


@dataclass(frozen=True)
class Candidate:
    """One transform model fitted to the points."""

    model: str  # "similarity" or "homography"
    terms: Terms  # zero where the model has no such term
    leave_one_out: Points  # residual of each point from a fit without it
    evidence: float  # logarithm of the points' probability density, up to the same constant for all


def fit_candidates(pairs: PointPairs, posterior: Posterior, sigma: float) -> list[Candidate]:
    """Fit each transform model with and without the lens term, and keep the more probable fit."""
    fits = [
        _fit_candidate(model, pairs, [*range(TERM_COUNTS[model]), *lens], posterior, sigma)
        for model, lens in product(TERM_COUNTS, ([], [8]))
    ]
    return [choose_model([fit for fit in fits if fit.model == model]) for model in TERM_COUNTS]


def fit_similarity_candidate(pairs: PointPairs, posterior: Posterior, sigma: float) -> Candidate:
    """Fit the model of a transform that is known to be a similarity."""
    return _fit_candidate("similarity", pairs, list(range(4)), posterior, sigma)


def choose_model(candidates: Sequence[Candidate]) -> Candidate:
    """Choose the model of the highest evidence.

    Leave-one-out errors choose worse where there are few points
    (`benchmarks.georeference.methods`).
    """
    return max(candidates, key=lambda candidate: candidate.evidence)


def compute_probabilities(candidates: Sequence[Candidate]) -> dict[str, float]:
    """Compute the probability of each model given the points; the prior is equal for all."""
    shares = softmax([candidate.evidence for candidate in candidates]).tolist()
    return {one.model: share for one, share in zip(candidates, shares, strict=True)}


def _fit_candidate(
    model: str, pairs: PointPairs, free: list[int], posterior: Posterior, sigma: float
) -> Candidate:
    """Fit one model; a leave-one-out residual is (I - H)^-1 e, H the point's hat matrix block."""
    ridge = posterior.precision * posterior.noise**2
    terms = fit_terms(pairs, free, ridge)
    error = pairs.compute_errors(terms)
    design = pairs.compute_design(terms)[:, :, free]
    flat = design.reshape(-1, len(free))
    inverse = invert_normal_matrix(flat.T @ flat + np.diag(ridge[free]))
    leverage = np.eye(2) * (1.0 + 1e-12) - design @ inverse @ design.transpose(0, 2, 1)
    leave_one_out = np.linalg.solve(leverage, error[:, :, None])
    if pairs.whitening is not None:
        leave_one_out = np.linalg.solve(pairs.whitening, leave_one_out)
    evidence = _integrate_noise(error, flat, posterior.precision[free], sigma)
    evidence += compute_log_prior(terms, free)
    return Candidate(model, terms, leave_one_out[:, :, 0], evidence)


def _integrate_noise(error: Points, design: Array, precision: Array, sigma: float) -> float:
    """Logarithm of the likelihood, integrated over the terms and over the unknown noise.

    Laplace's approximation at the fitted terms (Kass and Raftery 1995, Bayes Factors, 4.1).
    """
    variance = (sigma * np.exp(LOG_NOISES)) ** 2
    information = design.T @ design / variance[:, None, None] + np.diag(precision)
    volume = len(precision) * np.log(2.0 * np.pi) - np.linalg.slogdet(information)[1]
    squares = np.sum(error**2) / variance + error.size * np.log(variance)
    return float(logsumexp((volume - squares) / 2.0 + compute_log_noise_prior(LOG_NOISES)))
