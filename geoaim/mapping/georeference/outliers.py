"""Find a wrong control point: by how much the misfit falls when a point is left out."""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.special import fdtrc

from geoaim.base.errors import GeoreferenceError, warn
from geoaim.mapping.georeference.posterior import PRIOR_SIGMA, fit_posterior
from geoaim.mapping.georeference.transform_models import (
    PointPairs,
    Posterior,
    apply_terms,
    select_pairs,
)

SIGMA_DOF = 3.0  # degrees of freedom that the expected noise counts for
OUTLIER_SIGNIFICANCE = 0.005  # significance level of the test, after Bonferroni's correction
SKIP_REFITS_ABOVE = 0.3  # p-value of the first-order test; the test with refits is then skipped
MAX_REFITS = 64  # points of many that are left out in turn, the likeliest to first order
MIN_RELATIVE_LIKELIHOOD = 0.05  # likelihood of a further suspect, relative to that of the first one


def reject_outlier(names: tuple[str, ...], pairs: PointPairs, sigma: float) -> Bool[Array, "m"]:
    """Leave out one point that is clearly wrong, with a warning."""
    used = np.ones(len(names), bool)
    suspects = _find_suspects(pairs, sigma)
    if not suspects:
        return used
    if len(suspects) == 1 and len(names) > 4:
        used[suspects[0]] = False
        more = _find_suspects(select_pairs(pairs, used), sigma)
        suspects += np.flatnonzero(used)[more].tolist()
    if len(suspects) > 1 or used.all():
        raise GeoreferenceError(
            f"The control points contradict each other; may be wrong:"
            f" {', '.join(names[i] for i in suspects)}. Check these first, or add points so that"
            " the wrong ones can be told apart."
        )
    terms = fit_posterior(select_pairs(pairs, used), sigma, SIGMA_DOF).mean
    offset = (apply_terms(terms, pairs.image) - pairs.ground)[suspects[0]] / sigma
    warn(
        f"{names[suspects[0]]} is left out: it lies {np.linalg.norm(offset):.3g} times the picking"
        f" error from where the other {used.sum()} points put it. Check its pixel and its"
        " coordinates."
    )
    return used


def _find_suspects(pairs: PointPairs, sigma: float) -> list[int]:
    """Indices of points of which one must be wrong, the likeliest first.

    Leaving out a point is judged by an F test of the fall in misfit with 2 and n degrees of freedom
    (Cook and Weisberg 1982, 2.2.2), with Bonferroni's correction for the number of points.
    """
    count = len(pairs.image)
    posterior = fit_posterior(pairs, sigma, SIGMA_DOF)
    freedom = SIGMA_DOF + 2 * count - 6
    falls = _measure_falls(pairs, posterior)
    if _is_clearly_consistent(falls, posterior, freedom):
        return []
    likeliest = np.argsort(-falls)[:MAX_REFITS]
    misfits = np.full(count, np.inf)
    for one in likeliest:
        others = select_pairs(pairs, np.arange(count) != one)
        misfits[one] = fit_posterior(others, sigma, SIGMA_DOF).misfit
    if count * _fall_by_chance(posterior.misfit, misfits.min(), freedom) > OUTLIER_SIGNIFICANCE:
        return []
    likelihood = (misfits / misfits.min()) ** (-freedom / 2.0)
    return [int(i) for i in np.argsort(misfits) if likelihood[i] >= MIN_RELATIVE_LIKELIHOOD]


def _measure_falls(pairs: PointPairs, posterior: Posterior) -> Float[Array, "m"]:
    """By how much the misfit falls without each point, to first order."""
    error = pairs.compute_errors(posterior.mean)[:, :, None]
    jacobian = pairs.compute_design(posterior.mean)
    hat = jacobian @ posterior.covariance @ jacobian.transpose(0, 2, 1) / posterior.noise**2
    return np.sum(error * np.linalg.solve(np.eye(2) * (1.0 + 1e-9) - hat, error), axis=(1, 2))


def _is_clearly_consistent(falls: Float[Array, "m"], posterior: Posterior, freedom: float) -> bool:
    """Whether the same test to first order, without refits, finds nothing: the usual case."""
    lowest = max(posterior.misfit - float(falls.max()), 1e-30)
    usual = (np.abs(posterior.mean[4:]) <= 3.0 * PRIOR_SIGMA).all()
    chance = _fall_by_chance(posterior.misfit, lowest, freedom)
    return bool(usual and len(falls) * chance > SKIP_REFITS_ABOVE)


def _fall_by_chance(misfit: float, lowest: float, freedom: float) -> float:
    """Probability that chance lowers the misfit this far when one point is left out."""
    return float(fdtrc(2.0, freedom, max(misfit / lowest - 1.0, 0.0) * freedom / 2.0))
