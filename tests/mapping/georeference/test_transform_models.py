import numpy as np

from geoaim.mapping.georeference.posterior import fit_posterior
from geoaim.mapping.georeference.transform_models import (
    PointPairs,
    apply_terms,
    fit_candidates,
    fit_terms,
    select_pairs,
)


def test_leave_one_out_agrees_with_a_true_refit():
    generator = np.random.default_rng(3)
    points = generator.uniform(-0.7, 0.7, (9, 2))
    targets = points + 1e-3 * generator.normal(size=(9, 2))
    pairs = PointPairs(points, targets)
    posterior = fit_posterior(pairs, 1e-3, 2.0)
    ridge = posterior.precision * posterior.noise**2
    for candidate, size in zip(fit_candidates(pairs, posterior), (4, 6, 8), strict=True):
        keep = np.arange(9) != 4
        terms = fit_terms(select_pairs(pairs, keep), list(range(size)), ridge)
        assert candidate.terms[size:].tolist() == [0.0] * (9 - size)
        refit = targets[4] - apply_terms(terms, points[4:5])[0]
        np.testing.assert_allclose(candidate.leave_one_out[4], refit, rtol=0.02, atol=2e-6)
