"""Motion between two pictures of the ground: from a translation to a homography.

A small motion moves the point p by d(p) = B(p) theta, linear in its k parameters, in
coordinates normalised to the picture. One weighted least-squares fit serves all models,
and larger motions are composed of small ones (all are groups).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.geometry import transform_points

Model = Literal["translation", "rigid", "similarity", "affine", "homography"]
MATERIAL = 0.01  # px: a smaller gain in accuracy is not worth more parameters
MODELS: tuple[Model, ...] = ("translation", "similarity", "affine", "homography")
CURVED = ("rigid", "homography")  # not linear in their parameters: fitted step by step

# Columns: how the matrix I + Theta depends on theta. Rows of Theta in order.
_GENERATORS: dict[Model, list[list[float]]] = {
    "translation": [[0, 0, 1, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1, 0, 0]],
    "rigid": [
        [0, 0, 1, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 1, 0, 0],
        [0, -1, 0, 1, 0, 0, 0, 0],
    ],
    "similarity": [
        [0, 0, 1, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 1, 0, 0],
        [1, 0, 0, 0, 1, 0, 0, 0],
        [0, -1, 0, 1, 0, 0, 0, 0],
    ],
    "affine": np.eye(8)[[2, 5, 0, 1, 3, 4]].tolist(),
    "homography": np.eye(8)[[2, 5, 0, 1, 3, 4, 6, 7]].tolist(),
}


class Match(NamedTuple):
    """Points of a picture, their places in the reference, and the information of those."""

    source: Float[Array, "M 2"]
    target: Float[Array, "M 2"]
    information: Float[Array, "M 2 2"]


@dataclass(frozen=True)
class Motion:
    """A fitted motion.

    Attributes:
        matrix: (3, 3) the transform of pixels.
        covariance: (k, k) of its parameters in normalised coordinates.
        residuals: (M, 2) displacements left over, pixels.
        weights: (M,) robust weight of each point, 0 to 1.
        noise: robust standard deviation of a displacement, pixels.
    """

    model: Model
    matrix: Float[Array, "3 3"]
    covariance: Float[Array, "k k"]
    residuals: Float[Array, "M 2"]
    weights: Float[Array, " M"]
    noise: float


def normalisation(size: tuple[int, int]) -> Float[Array, "3 3"]:
    """Pixels to coordinates in about [-1, 1], the same scale on both axes."""
    height, width = size
    half = max(height, width) / 2
    return np.array(
        [[1 / half, 0, -width / 2 / half], [0, 1 / half, -height / 2 / half], [0, 0, 1]]
    )


def basis(
    points: Float[Array, "M 2"], model: Model, *, size: tuple[int, int]
) -> Float[Array, "M 2 k"]:
    """B(p): pixels moved by a unit of each parameter."""
    scale = normalisation(size)
    x, y = (points * scale[0, 0] + scale[:2, 2]).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    full = np.array(
        [
            [x, y, one, zero, zero, zero, -x * x, -x * y],
            [zero, zero, zero, x, y, one, -x * y, -y * y],
        ]
    )
    columns = np.einsum("ijm,kj->mik", full, np.array(_GENERATORS[model]))
    return columns / scale[0, 0]


def small_motion(
    parameters: Float[Array, " k"], model: Model, *, size: tuple[int, int]
) -> Float[Array, "3 3"]:
    """The pixel transform I + Theta of the given parameters."""
    small = np.eye(3) + np.append(parameters @ np.array(_GENERATORS[model]), 0.0).reshape(3, 3)
    if model == "rigid":
        small[:2, :2] /= np.hypot(*small[:2, 0])
    scale = normalisation(size)
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
    """Robust weighted least squares: iteratively reweighted with Tukey's biweight.

    The start is the median displacement, so that points which move on their own are outvoted
    from the first step.
    """
    columns = basis(points, model, size=size)
    projected = np.einsum("mik,mij->mkj", columns, information)
    normal_parts = projected @ columns
    right_parts = np.einsum("mkj,mj->mk", projected, displacements)
    residuals = displacements - np.median(displacements, axis=0)
    for _ in range(rounds):
        weights = _tukey(residuals, information)
        normal = np.tensordot(weights, normal_parts, 1)
        parameters = np.linalg.solve(normal, weights @ right_parts)
        residuals = displacements - columns @ parameters
    freedom = max(2 * weights.sum() - columns.shape[2], 1.0)
    variance = np.einsum("m,mi,mij,mj->", weights, residuals, information, residuals) / freedom
    inner = residuals[weights > 0]
    return Motion(
        model,
        small_motion(parameters, model, size=size),
        np.linalg.inv(normal) * variance,
        residuals,
        weights,
        float(np.sqrt((inner**2).mean())),
    )


def _tukey(
    residuals: Float[Array, "M 2"], information: Float[Array, "M 2 2"]
) -> Float[Array, " M"]:
    """Biweight of each whitened residual; the median of a Rayleigh variable is 1.1774 sigma."""
    squared = np.einsum("mi,mij,mj->m", residuals, information, residuals)
    scale = max(float(np.sqrt(np.median(squared)) / 1.1774), 1e-6)
    return np.clip(1 - squared / (4.685 * scale) ** 2, 0, None) ** 2


@dataclass(frozen=True)
class ModelChoice:
    """Which model a set of pictures needs, and what each would cost.

    Attributes:
        model: the simplest whose predicted error is within `MATERIAL` of the least.
        predicted_error: by model, the root mean square error over the image, pixels.
    """

    model: Model
    predicted_error: dict[Model, float]


def choose_model(
    matches: Sequence[Match],
    *,
    size: tuple[int, int],
    models: Sequence[Model] = MODELS,
    repeats: float = 1.0,
    material: float = MATERIAL,
) -> ModelChoice:
    """Choose by the smallest predicted error over the image: squared bias plus variance.

    The homography is taken as unbiased. A simpler model's bias is how far it lies from a richer
    one over a grid of image points, less what noise alone would make of that distance (the
    difference of the two variances, since the models are nested), by the richer one that shows
    most: the focused information criterion of Claeskens and Hjort (2003) with the position of a
    pixel as its focus. Unlike GRIC or BIC the answer is in pixels, so that what is immaterial can
    be left out.

    Args:
        matches: one for each picture.
        size: height and width of the reference, pixels.
        models: from the simplest to the homography.
        repeats: how many points say the same, as those of windows that overlap do.
        material: pixels; a smaller gain in accuracy is not worth more parameters.
    """
    risks = np.array([_risks(match, models, repeats, size=size) for match in matches])
    errors = np.sqrt(risks.mean(0))
    simplest = int(np.argmax(errors < errors.min() + material))
    return ModelChoice(models[simplest], dict(zip(models, errors.tolist(), strict=True)))


def fit_match(match: Match, model: Model, *, size: tuple[int, int]) -> Motion:
    """The motion from a match's points to their places, small or not."""
    matrix = np.eye(3) if model != "homography" else fit_match(match, "affine", size=size).matrix
    for _ in range(4 if model in CURVED else 1):
        moved = transform_points(matrix, match.source)
        motion = fit_motion(moved, match.target - moved, match.information, model, size=size)
        matrix = motion.matrix @ matrix
    return replace(motion, matrix=matrix)


def _risks(
    match: Match, models: Sequence[Model], repeats: float, *, size: tuple[int, int]
) -> list[float]:
    """Mean squared error over the image, predicted for each model."""
    height, width = size
    grid = np.stack(np.meshgrid(np.linspace(0, width, 7), np.linspace(0, height, 7)), -1)
    grid = grid.reshape(-1, 2)
    places, variances = [], []
    for model in models:
        motion = fit_match(match, model, size=size)
        columns = basis(grid, model, size=size)
        spread = np.einsum("mik,kl,mil->m", columns, motion.covariance, columns)
        variances.append(repeats * spread.mean())
        places.append(transform_points(motion.matrix, grid))
    risks = []
    for number, (place, variance) in enumerate(zip(places, variances, strict=True)):
        bias = 0.0
        for richer, spread in zip(places[number + 1 :], variances[number + 1 :], strict=True):
            apart = ((place - richer) ** 2).sum(-1).mean()
            bias = max(bias, float(apart - max(spread - variance, 0)))
        risks.append(bias + float(variance))
    return risks
