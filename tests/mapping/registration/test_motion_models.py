import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoaim.base.geometry import transform_points
from geoaim.mapping.registration.motion_models import (
    MODELS,
    PointMatches,
    _build_matrix,
    choose_model,
    compute_basis,
    fit_motion,
)

SIZE = {"size": (1080, 1920)}


def scattered(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([0, 0], [1920, 1080], (count, 2))


def identities(count: int) -> np.ndarray:
    return np.repeat(np.eye(2)[None], count, 0)


@pytest.mark.parametrize("model", MODELS)
def test_basis_is_the_derivative_of_the_small_motion(model):
    points = scattered(5)
    columns = compute_basis(points, model, **SIZE)
    for number in range(columns.shape[2]):
        step = np.zeros(columns.shape[2])
        step[number] = 1e-6
        forward = transform_points(_build_matrix(step, model, **SIZE), points)
        backward = transform_points(_build_matrix(-step, model, **SIZE), points)
        np.testing.assert_allclose(columns[..., number], (forward - backward) / 2e-6, atol=1e-3)


@given(st.lists(st.floats(-1e-3, 1e-3), min_size=4, max_size=4))
def test_fit_recovers_a_similarity_exactly(parameters):
    points = scattered(30)
    truth = _build_matrix(np.array(parameters), "similarity", **SIZE)
    moved = transform_points(truth, points) - points
    motion = fit_motion(points, moved, identities(30), "similarity", **SIZE)
    np.testing.assert_allclose(motion.matrix, truth, atol=1e-9)


def test_fit_outvotes_a_third_of_points_that_move_together():
    points = scattered(90)
    displacements = np.random.default_rng(1).normal(0, 0.05, (90, 2))
    displacements[:30] += [4.0, 1.0]
    motion = fit_motion(points, displacements, identities(90), "similarity", **SIZE)
    assert np.abs(transform_points(motion.matrix, points) - points).max() < 0.1
    assert (motion.weights[:30] == 0).all()


def test_predicted_covariance_holds_the_spread_of_fits():
    points, generator = scattered(60), np.random.default_rng(2)
    columns = compute_basis(np.array([[0.0, 0.0]]), "homography", **SIZE)[0]
    corner, predicted = [], []
    for _ in range(200):
        noise = generator.normal(0, 0.1, (60, 2))
        motion = fit_motion(points, noise, identities(60), "homography", **SIZE)
        corner.append(transform_points(motion.matrix, np.zeros((1, 2)))[0])
        predicted.append(np.trace(columns @ motion.covariance @ columns.T))
    assert np.mean(predicted) == pytest.approx(np.var(corner, axis=0).sum(), rel=0.25)


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("translation", [0.01, 0.02]),
        ("similarity", [0.01, 0.0, 0.01, 0.02]),
        ("affine", [0.01, 0.0, 0.01, 0.004, 0.0, 0.01]),
        ("homography", [0.01, 0.0, 0.01, 0.0, 0.0, 0.01, 0.002, 0.001]),
    ],
)
def test_the_least_model_that_explains_the_motion_is_chosen(model, parameters):
    generator, matches = np.random.default_rng(3), []
    for seed in range(3):
        source = scattered(200, seed)
        truth = _build_matrix(np.array(parameters), model, **SIZE)
        target = transform_points(truth, source) + generator.normal(0, 0.1, (200, 2))
        matches.append(PointMatches(source, target, identities(200)))
    assert choose_model(matches, **SIZE).model == model


def test_points_without_information_do_not_choose_the_model():
    """As in a still, compressed video: most patches lie off the motion by next to nothing."""
    source = scattered(100)
    noise = 1e-4 * np.random.default_rng(1).standard_normal(source.shape)
    information = identities(100) * (np.arange(100) < 40)[:, None, None]
    choice = choose_model([PointMatches(source, source + noise, information)], **SIZE)
    assert choice.model == "translation"
