import numpy as np
import pytest

from benchmarks.georeference.tilts import draw_tilted_set, judge_set
from geoaim.mapping.georeference.model_choice import (
    Candidate,
    choose_model,
    compute_probabilities,
    fit_candidates,
)
from geoaim.mapping.georeference.posterior import PRIOR_SIGMA, fit_posterior
from geoaim.mapping.georeference.transform_models import (
    PointPairs,
    apply_terms,
    fit_terms,
    select_pairs,
)

NOISE = 1e-3


def make_pairs(count, terms=None):
    generator = np.random.default_rng(3)
    points = generator.uniform(-0.7, 0.7, (count, 2))
    ground = apply_terms(np.zeros(9) if terms is None else terms, points)
    return PointPairs(points, ground + NOISE * generator.normal(size=(count, 2)))


def fit(pairs):
    return fit_candidates(pairs, fit_posterior(pairs, NOISE, 0.0), NOISE)


def test_leave_one_out_agrees_with_a_true_refit():
    pairs = make_pairs(9)
    posterior = fit_posterior(pairs, NOISE, 0.0)
    ridge = posterior.precision * posterior.noise**2
    for candidate, size in zip(fit_candidates(pairs, posterior, NOISE), (4, 8), strict=True):
        keep = np.arange(9) != 4
        terms = fit_terms(select_pairs(pairs, keep), list(range(size)), ridge)
        assert candidate.terms[size:].tolist() == [0.0] * (9 - size)
        refit = pairs.ground[4] - apply_terms(terms, pairs.image[4:5])[0]
        np.testing.assert_allclose(candidate.leave_one_out[4], refit, rtol=0.02, atol=2e-6)


@pytest.mark.parametrize("count", [4, 8, 20])
def test_points_of_a_similarity_give_a_similarity(count):
    assert choose_model(fit(make_pairs(count))).model == "similarity"


def test_the_homography_is_the_more_probable_the_more_points_show_the_tilt():
    tilt = np.array([0, 0, 0, 0, 0, 0, 0.01, 0, 0])
    shares = [compute_probabilities(fit(make_pairs(n, tilt)))["homography"] for n in (4, 8, 40)]
    assert shares == sorted(shares)
    assert shares[0] < 0.5 < 0.99 < shares[-1]


def test_a_lens_is_fitted_where_the_points_show_one():
    bent = np.array([0, 0, 0, 0, 0, 0, 0, 0, 4 * PRIOR_SIGMA[4]])
    assert choose_model(fit(make_pairs(20, bent))).terms[8] == pytest.approx(bent[8], abs=0.005)


def test_probabilities_are_shares_of_the_evidence():
    one, other = (
        Candidate(model, np.zeros(9), np.zeros((4, 2)), evidence)
        for model, evidence in (("similarity", -1000.0), ("homography", -1000.0 - np.log(3.0)))
    )
    found = compute_probabilities([one, other])
    assert found == pytest.approx({"similarity": 0.75, "homography": 0.25})


@pytest.mark.filterwarnings("ignore::geoaim.base.errors.GeoaimWarning")
@pytest.mark.parametrize("tilt", [10.0, 20.0])
def test_four_right_points_of_a_tilted_camera_give_its_tilt(tilt):
    generator = np.random.default_rng(1)
    for _ in range(4):
        points, truth = draw_tilted_set(tilt, "corners", 4, False, generator)
        worse, inside, ratio, _ = judge_set(points, truth, slice(None))
        assert not worse
        assert ratio < 1.5 or inside > 0.9
