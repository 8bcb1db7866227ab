"""Posterior of the nine terms: how far any point of the image may be off on the ground.

All nine terms explain the points at once, the last five under a prior that expects them small
(`PRIOR_SIGMA`). The posterior holds for whichever transform model the map then uses. A textbook
covariance of the chosen model ignores the tilt that, say, eight clustered points do not show, and
is too small at the corners.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.special import fdtri, gammaln

from geoaim.mapping.georeference.transform_models import (
    PointPairs,
    Posterior,
    fit_terms,
    invert_normal_matrix,
)

# One sigma for a camera that looks down: stretch and shear 2 %, perspective 15 % over half the
# diagonal (a tilt of 8 degrees), a lens that moves the corners by 0.5 %. A narrower perspective
# pulled four right points at 20 to 30 degrees metres off (`benchmarks.georeference.tilts`).
PRIOR_SIGMA = np.array([0.02, 0.02, 0.15, 0.15, 0.005])
PRIOR_DOF = 3.0  # degrees of freedom of Student's t; clear evidence outweighs its heavy tails
PRIOR_GROUPS = ([4, 5], [6, 7], [8])  # terms that share a scale
# One sigma of the logarithm of the noise. With an unlimited noise, a similarity with metres of it
# beat the homography of four right points.
NOISE_SPREAD = 0.7
KNOWN = np.array([0.0] * 4 + [1e12] * 5)  # precision of terms of a similarity: the others are 0


def fit_posterior(
    pairs: PointPairs, sigma: float, sigma_dof: float, *, similarity: bool = False
) -> Posterior:
    """Estimate the transform's nine terms with their prior, and the noise, by reweighting.

    The terms are those of similarity (4), stretch and shear (2), perspective (2) and lens (1).
    The variance of the noise is the mean of the residuals' variance and the expected one, weighted
    by their degrees of freedom (a scaled inverse chi-square prior); with `sigma_dof` 0, the prior
    is log-normal (`compute_log_noise_prior`).
    """
    # Start with a wide prior, so that a strong lens is not suppressed.
    precision = 1.0 / np.concatenate([np.full(4, np.inf), 5.0 * PRIOR_SIGMA]) ** 2
    if similarity:
        precision = KNOWN
    variance, terms, start = sigma**2, np.full(9, np.nan), None
    for _ in range(30):
        previous = terms
        terms = fit_terms(pairs, list(range(9)), precision * variance, start)
        design = pairs.compute_design(terms).reshape(-1, 9)
        normal = design.T @ design
        inverse = invert_normal_matrix(normal + np.diag(precision * variance))
        squares = float(np.sum(pairs.compute_errors(terms) ** 2))
        freedom = float(2 * len(pairs.image) - np.trace(inverse @ normal))
        variance, dof = _estimate_noise(squares, freedom, sigma, sigma_dof)
        precision = KNOWN if similarity else _reweight_prior(terms)
        if np.abs(terms - previous).max() < 1e-7:
            break
        start = terms
    misfit = sigma_dof * sigma**2 + squares + variance * float(np.sum(precision * terms**2))
    noise = float(np.sqrt(variance))
    return Posterior(terms, inverse * variance, precision, noise, dof, misfit)


def _reweight_prior(terms: Float[Array, "9"]) -> Float[Array, "9"]:
    """Inverse variances of the normal prior that stands for Student's t at these terms."""
    precision = np.zeros(9)
    for group in PRIOR_GROUPS:
        scale = PRIOR_DOF * PRIOR_SIGMA[group[0] - 4] ** 2 + np.sum(terms[group] ** 2)
        precision[group] = (PRIOR_DOF + len(group)) / scale
    return precision


def compute_log_prior(terms: Float[Array, "9"], free: list[int]) -> float:
    """Compute the logarithm of the prior's density of the terms that a model frees."""
    density = 0.0
    for group in PRIOR_GROUPS:
        if group[0] in free:
            count, scale = len(group), PRIOR_DOF * PRIOR_SIGMA[group[0] - 4] ** 2
            half = (PRIOR_DOF + count) / 2.0
            density += gammaln(half) - gammaln(PRIOR_DOF / 2.0)
            density -= count / 2.0 * np.log(np.pi * scale)
            density -= half * np.log1p(np.sum(terms[group] ** 2) / scale)
    return float(density)


def compute_log_noise_prior(log_noise: Float[Array, "n"]) -> Float[Array, "n"]:
    """Compute the logarithm of the prior's density of the logarithm of noise over expected noise.

    It is normal, so that the noise is log-normal; its mean square is the expected one.
    """
    return -0.5 * (log_noise / NOISE_SPREAD + NOISE_SPREAD) ** 2


def _estimate_noise(
    squares: float, freedom: float, sigma: float, sigma_dof: float
) -> tuple[float, float]:
    """Variance of the noise and its degrees of freedom, from squared residuals and the prior.

    For `sigma_dof` 0 the prior of sigma is log-normal. Its posterior, integrated numerically, is
    matched by the scaled inverse chi-square of the same mean and variance (Gelman et al. 2013,
    Bayesian Data Analysis, 2.6).
    """
    if sigma_dof > 0:
        dof = sigma_dof + freedom
        return (sigma_dof * sigma**2 + squares) / dof, dof
    largest = max(3.0 * sigma, 3.0 * float(np.sqrt(squares / max(freedom, 1.0))))
    sigmas = np.geomspace(0.01 * sigma, largest, 100)
    logarithm = -freedom * np.log(sigmas) - squares / (2.0 * sigmas**2)
    logarithm += compute_log_noise_prior(np.log(sigmas / sigma))
    weight = np.exp(logarithm - logarithm.max())
    weight /= weight.sum()
    mean = float(weight @ sigmas**2)
    spread = float(weight @ (sigmas**2 - mean) ** 2)
    dof = 4.0 + 2.0 * mean**2 / max(spread, 1e-12 * mean**2)
    return mean * (dof - 2.0) / dof, dof


def ellipse_factor(dof: float) -> float:
    """Compute the semi-axes, in standard deviations, of the ellipse that holds 95 % of errors.

    sqrt(2 F), with F the quantile of the F distribution with 2 and `dof` degrees of freedom.

    >>> round(ellipse_factor(np.inf), 3)  # Gaussian: sqrt(-2 ln 0.05)
    2.448
    """
    return float(np.sqrt(2.0 * fdtri(2.0, min(dof, 1e9), 0.95)))
