"""Motion models between two images of the ground, from a translation to a homography.

A small motion displaces the point p by d(p) = B(p) theta, linear in its k parameters, in
coordinates normalised to the image. One weighted least-squares fit serves all models. Larger
motions are compositions of small ones, since each model is a group.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.geometry import transform_points

# "rest" has no parameter; `registration.rest` chooses it
Model = Literal["rest", "translation", "rigid", "similarity", "affine", "homography"]
MIN_ACCURACY_GAIN_PX = 0.01  # a model with more parameters is chosen for a greater gain in accuracy
BLOCK_COLUMNS, BLOCK_ROWS = 4, 3  # blocks of the jackknife
MODELS: tuple[Model, ...] = ("translation", "similarity", "affine", "homography")
NONLINEAR_MODELS = ("rigid", "homography")  # fitted iteratively

# Columns: how the matrix I + Theta depends on theta. Rows of Theta in order.
_UNIT = np.eye(8)
_SHIFTS, _SCALING, _ROTATION = _UNIT[[2, 5]], _UNIT[[0]] + _UNIT[[4]], _UNIT[[3]] - _UNIT[[1]]
_GENERATORS: dict[Model, Float[Array, "k 8"]] = {
    "translation": _SHIFTS,
    "rigid": np.concatenate([_SHIFTS, _ROTATION]),
    "similarity": np.concatenate([_SHIFTS, _SCALING, _ROTATION]),
    "affine": _UNIT[[2, 5, 0, 1, 3, 4]],
    "homography": _UNIT[[2, 5, 0, 1, 3, 4, 6, 7]],
}


class PointMatches(NamedTuple):
    """Points of an image and where they lie in the reference."""

    source: Float[Array, "M 2"]  # pixels of the image
    target: Float[Array, "M 2"]  # the same points in pixels of the reference
    information: Float[Array, "M 2 2"]  # inverse covariance of each target, 1/px^2


@dataclass(frozen=True)
class Motion:
    """A fitted motion."""

    model: Model  # the motion model
    matrix: Float[Array, "3 3"]  # the transform of pixels
    covariance: Float[Array, "k k"]  # covariance of the parameters, in normalised coordinates
    residuals: Float[Array, "M 2"]  # measured minus fitted displacements, pixels
    weights: Float[Array, " M"]  # robust weight of each point, 0 to 1
    noise: float  # standard deviation of the residuals of the inliers, pixels


def _compute_normalisation(size: tuple[int, int]) -> Float[Array, "3 3"]:
    """Transform of pixels to about [-1, 1], with the same scale on both axes."""
    height, width = size
    half = max(height, width) / 2
    return np.array(
        [[1 / half, 0, -width / 2 / half], [0, 1 / half, -height / 2 / half], [0, 0, 1]]
    )


def compute_basis(
    points: Float[Array, "M 2"], model: Model, *, size: tuple[int, int]
) -> Float[Array, "M 2 k"]:
    """Compute derivatives of the points' displacements with respect to a motion's parameters.

    Args:
        points: (M, 2) x, y in pixels, corner origin.
        model: the motion model, with k parameters.
        size: (height, width) of the image in pixels, which normalises the coordinates.

    Returns:
        (M, 2, k) pixels per unit of a parameter; parameters are in normalised coordinates.
    """
    scale = _compute_normalisation(size)
    x, y = (points * scale[0, 0] + scale[:2, 2]).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    full = np.array(
        [
            [x, y, one, zero, zero, zero, -x * x, -x * y],
            [zero, zero, zero, x, y, one, -x * y, -y * y],
        ]
    )
    columns = np.einsum("ijm,kj->mik", full, _GENERATORS[model])
    return columns / scale[0, 0]


def _build_matrix(
    parameters: Float[Array, " k"], model: Model, *, size: tuple[int, int]
) -> Float[Array, "3 3"]:
    """The pixel transform I + Theta of a small motion theta in normalised coordinates."""
    small = np.eye(3) + np.append(parameters @ _GENERATORS[model], 0.0).reshape(3, 3)
    if model == "rigid":
        small[:2, :2] /= np.hypot(*small[:2, 0])
    scale = _compute_normalisation(size)
    matrix = np.linalg.inv(scale) @ small @ scale
    return matrix / matrix[2, 2]


def fit_motion(
    points: Float[Array, "M 2"],
    displacements: Float[Array, "M 2"],
    information: Float[Array, "M 2 2"],
    model: Model,
    *,
    size: tuple[int, int],
    rounds: int = 6,
) -> Motion:
    """Fit a small motion by least squares, iteratively reweighted with Tukey's biweight."""
    columns = compute_basis(points, model, size=size)
    projected = np.einsum("mik,mij->mkj", columns, information)
    normal_parts = projected @ columns
    right_parts = np.einsum("mkj,mj->mk", projected, displacements)
    residuals = displacements - np.median(displacements, axis=0)
    for _ in range(rounds):
        weights = _compute_tukey_weights(residuals, information)
        normal = np.tensordot(weights, normal_parts, 1)
        parameters = np.linalg.solve(normal, weights @ right_parts)
        residuals = displacements - columns @ parameters
    freedom = max(2 * weights.sum() - columns.shape[2], 1.0)
    variance = np.einsum("m,mi,mij,mj->", weights, residuals, information, residuals) / freedom
    inliers = residuals[weights > 0]
    return Motion(
        model,
        _build_matrix(parameters, model, size=size),
        np.linalg.inv(normal) * variance,
        residuals,
        weights,
        float(np.sqrt((inliers**2).mean())),
    )


def jackknife_covariance(
    points: Float[Array, "M 2"],
    information: Float[Array, "M 2 2"],
    motion: Motion,
    *,
    size: tuple[int, int],
) -> Float[Array, "k k"]:
    """Estimate a motion's covariance by how much it changes without a part of the image.

    Residuals that neighbours share (parallax, lens, rolling shutter, slow traffic) enlarge it,
    whereas the covariance of the fit takes the points for independent. Delete-a-group jackknife:
    Kott (2001), "The delete-a-group jackknife".
    """
    height, width = size
    column = (points[:, 0] * BLOCK_COLUMNS / width).astype(int).clip(0, BLOCK_COLUMNS - 1)
    row = (points[:, 1] * BLOCK_ROWS / height).astype(int).clip(0, BLOCK_ROWS - 1)
    member = np.arange(BLOCK_COLUMNS * BLOCK_ROWS)[:, None] == row * BLOCK_COLUMNS + column
    columns = compute_basis(points, motion.model, size=size)
    projected = np.einsum("m,mik,mij->mkj", motion.weights, columns, information)
    normal = np.tensordot(member, projected @ columns, 1)
    right = np.tensordot(member, np.einsum("mkj,mj->mk", projected, motion.residuals), 1)
    used = member.any(1)
    rest = normal.sum(0) - normal[used]
    try:
        change = np.linalg.solve(rest, (right.sum(0) - right[used])[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return np.full(normal.shape[1:], np.inf)
    return (1 - 1 / used.sum()) * change.T @ change


def _compute_tukey_weights(
    residuals: Float[Array, "M 2"], information: Float[Array, "M 2 2"]
) -> Float[Array, " M"]:
    """Biweight of each whitened residual; a Rayleigh variable has its median at 1.1774 sigma."""
    squared = np.einsum("mi,mij,mj->m", residuals, information, residuals)
    scale = max(float(np.sqrt(np.median(squared)) / 1.1774), 1e-6)
    return np.clip(1 - squared / (4.685 * scale) ** 2, 0, None) ** 2


@dataclass(frozen=True)
class ModelChoice:
    """The motion model chosen for a set of images."""

    model: Model  # the simplest one whose predicted error is near the smallest
    # root mean square error over the image of each model, pixels
    predicted_error: dict[Model, float]


def choose_model(
    matches: Sequence[PointMatches],
    *,
    size: tuple[int, int],
    models: Sequence[Model] = MODELS,
    redundancy: float = 1.0,
    min_gain: float = MIN_ACCURACY_GAIN_PX,
) -> ModelChoice:
    """Choose the motion model with the smallest predicted error over the image.

    The squared error is squared bias plus variance; the homography is taken as unbiased. The bias
    of a simpler model is its distance from a richer one over a grid of image points, minus the part
    that noise explains (the difference of the variances, since the models are nested); of the
    richer models the one that shows most bias counts. This is the focused information criterion of
    Claeskens and Hjort (2003) with the position of a pixel as its focus. Unlike GRIC and BIC it is
    in pixels, so that immaterial gains can be ignored.

    Args:
        matches: matches of each image.
        size: (height, width) of the reference, pixels.
        models: models, from the simplest to the homography.
        redundancy: number of points with the same information, as in overlapping windows.
        min_gain: pixels of accuracy for which a richer model is chosen.

    Returns:
        The chosen model and the predicted error of each.
    """
    # a majority of points without information would leave no scale for the robust weights
    known = [match.information.any((1, 2)) for match in matches]
    matches = [
        PointMatches(*(part[used] for part in match))
        for match, used in zip(matches, known, strict=True)
    ]
    squared = [_predict_squared_errors(match, models, redundancy, size=size) for match in matches]
    errors = np.sqrt(np.array(squared).mean(0))
    simplest = int(np.argmax(errors < errors.min() + min_gain))
    return ModelChoice(models[simplest], dict(zip(models, errors.tolist(), strict=True)))


def fit_matches(matches: PointMatches, model: Model, *, size: tuple[int, int]) -> Motion:
    """Fit the motion, small or large, from an image's points to their targets.

    Args:
        matches: the points.
        model: the model to fit.
        size: (height, width) of the reference, pixels.

    Returns:
        The motion; its matrix is reference_from_image.
    """
    matrix = np.eye(3)
    if model == "homography":
        matrix = fit_matches(matches, "affine", size=size).matrix
    for _ in range(4 if model in NONLINEAR_MODELS else 1):
        moved = transform_points(matrix, matches.source)
        motion = fit_motion(moved, matches.target - moved, matches.information, model, size=size)
        matrix = motion.matrix @ matrix
    return replace(motion, matrix=matrix)


def _predict_squared_errors(
    matches: PointMatches, models: Sequence[Model], redundancy: float, *, size: tuple[int, int]
) -> list[float]:
    """Mean squared error over the image that is predicted for each model."""
    height, width = size
    grid = np.stack(np.meshgrid(np.linspace(0, width, 7), np.linspace(0, height, 7)), -1)
    grid, fitted, variances = grid.reshape(-1, 2), [], []
    for model in models:
        motion = fit_matches(matches, model, size=size)
        columns = compute_basis(grid, model, size=size)
        spread = np.einsum("mik,kl,mil->m", columns, motion.covariance, columns)
        variances.append(redundancy * spread.mean())
        fitted.append(transform_points(motion.matrix, grid))
    errors = []
    for number, (points, variance) in enumerate(zip(fitted, variances, strict=True)):
        bias = 0.0
        for richer, spread in zip(fitted[number + 1 :], variances[number + 1 :], strict=True):
            distance = ((points - richer) ** 2).sum(-1).mean()
            bias = max(bias, float(distance - max(spread - variance, 0)))
        errors.append(bias + float(variance))
    return errors
