"""Transform models from the image to the ground: similarity and homography.

They are fitted in the normalised plane p (`normalised_plane`), to ground points that the best
similarity has brought onto it. Every parameter is then small. There are nine, called terms: shift
and similarity (tx, ty, s, r), stretch and shear (a, b), perspective (c), one radial lens term (k):

    q = (A p' + t) / (1 + c . p'),   p' = p (1 + k |p|^2),   A = [[1+s+a, b-r], [b+r, 1+s-a]]

A similarity frees the first 4 terms, a homography the first 8, each with or without the lens term
(`model_choice`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.optimize import least_squares

from geoaim.mapping.georeference.normalised_plane import Points, plane_from_image

Terms = Float[Array, "9"]  # the nine terms in the order above

TERM_COUNTS = {"similarity": 4, "homography": 8}  # free terms without the lens
MAX_EVALUATIONS = 30  # evaluations of a fit; 6 are usual, and only grossly wrong points take more


@dataclass(frozen=True)
class PointPairs:
    """Control points in the normalised plane: their pixels, and their ground by a similarity."""

    image: Points
    ground: Points


@dataclass(frozen=True)
class Posterior:
    """All nine terms with their uncertainty, and the noise of the control points."""

    mean: Terms  # most probable terms
    covariance: Float[Array, "9 9"]  # covariance at the estimated noise
    precision: Terms  # inverse variances of the prior, zero for the free similarity terms
    noise: float  # standard deviation of one coordinate of one point
    dof: float  # degrees of freedom of the noise estimate
    misfit: float  # squared residuals, and terms over their prior, in the plane; outliers raise it


def select_pairs(pairs: PointPairs, keep: Bool[Array, "m"]) -> PointPairs:
    """Keep the pairs where the mask `keep` is True."""
    return PointPairs(pairs.image[keep], pairs.ground[keep])


def apply_terms(terms: Terms, points: Points) -> Points:
    """Map points of the normalised plane by the nine terms."""
    undistorted = points * (1.0 + terms[8] * np.sum(points**2, axis=1, keepdims=True))
    denominator = 1.0 + undistorted @ terms[6:8]
    return (undistorted @ _linear_part(terms).T + terms[:2]) / denominator[:, None]


def term_jacobian(terms: Terms, points: Points) -> Float[Array, "m 2 9"]:
    """Differentiate `apply_terms`: [:, i, k] is the derivative of x or y to term k."""
    square = np.sum(points**2, axis=1, keepdims=True)
    undistorted = points * (1.0 + terms[8] * square)
    denominator = 1.0 + undistorted @ terms[6:8]
    mapped = apply_terms(terms, points)
    x, y = undistorted.T
    jacobian = np.zeros((len(points), 2, 9))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2:6] = np.stack([x, -y, x, y], axis=1)
    jacobian[:, 1, 2:6] = np.stack([y, x, -y, x], axis=1)
    jacobian[:, :, 6:8] = -mapped[:, :, None] * undistorted[:, None, :]
    radial = points * square
    jacobian[:, :, 8] = radial @ _linear_part(terms).T - mapped * (radial @ terms[6:8])[:, None]
    return jacobian / denominator[:, None, None]


def _linear_part(terms: Array) -> Array:
    """The matrix A."""
    s, r, a, b = terms[2:6]
    return np.array([[1.0 + s + a, b - r], [b + r, 1.0 + s - a]])


def compose_world_from_image(
    world_from_plane: Float[Array, "3 3"], terms: Terms, size: tuple[int, int]
) -> Float[Array, "3 3"]:
    """Compose the homography from undistorted pixels to world metres.

    Args:
        world_from_plane: similarity from the normalised plane to world metres.
        terms: the nine terms; the lens term is not part of a homography.
        size: height and width of the image, pixels.

    Returns:
        The homography, scaled to 1 in its last element.
    """
    plane = np.eye(3)
    plane[:2, :2], plane[:2, 2], plane[2, :2] = _linear_part(terms), terms[:2], terms[6:8]
    matrix = world_from_plane @ plane @ plane_from_image(*size)
    return np.asarray(matrix / matrix[2, 2])


def fit_terms(
    pairs: PointPairs, free: list[int], ridge: Terms, start: Terms | None = None
) -> Terms:
    """Fit some of the nine terms by regularised least squares (Levenberg-Marquardt)."""
    terms = np.zeros(9)
    root = np.sqrt(ridge[free])

    def residuals(values: Array) -> Array:
        terms[free] = values
        error = apply_terms(terms, pairs.image) - pairs.ground
        return np.concatenate([error.ravel(), root * values])

    def jacobian(values: Array) -> Array:
        terms[free] = values
        design = term_jacobian(terms, pairs.image).reshape(-1, 9)[:, free]
        return np.concatenate([design, np.diag(root)])

    first = np.zeros(len(free)) if start is None else start[free]
    limits = {"xtol": 1e-9, "ftol": 1e-12, "gtol": 1e-15, "max_nfev": MAX_EVALUATIONS}
    terms[free] = least_squares(residuals, first, jacobian, method="lm", **limits).x
    return terms


def invert_normal_matrix(normal: Float[Array, "k k"]) -> Float[Array, "k k"]:
    """Invert a normal matrix J^T J; a tiny ridge keeps variances of undetermined terms finite."""
    scale = 1.0 / np.sqrt(np.diag(normal) + 1e-30)
    even = normal * scale * scale[:, None] + 1e-12 * np.eye(len(normal))
    return np.asarray(np.linalg.inv(even) * scale * scale[:, None])
