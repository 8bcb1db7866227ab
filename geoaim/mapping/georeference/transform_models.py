"""Transform models from the image to the ground: similarity, affine and homography.

They are fitted in the normalised plane p (`normalised_plane`), to ground points that the best
similarity has brought onto it. Every parameter is then small. There are nine, called terms: shift
and similarity (tx, ty, s, r), stretch and shear (a, b), perspective (c), one radial lens term (k):

    q = (A p' + t) / (1 + c . p'),   p' = p (1 + k |p|^2),   A = [[1+s+a, b-r], [b+r, 1+s-a]]

Each model frees the first 4, 6 or 8 terms, and the lens term where the points show one. The model
for the map is chosen by leave-one-out error (`choose_model`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.optimize import least_squares

from geoaim.mapping.georeference.normalised_plane import Points, plane_from_image

Terms = Float[Array, "9"]  # in the order above

TERM_COUNTS = {"similarity": 4, "affine": 6, "homography": 8}  # free terms, simplest model first
MIN_POINTS_LENS = 6  # fewer points cannot carry the radial term
MIN_LENS_SIGMAS = 3.0  # standard deviations of the radial term that count as a lens
MIN_MISFIT_DROP = 5.0  # noise variances by which each further term must lower the misfit
MAX_EVALUATIONS = 30  # of a fit; 6 are usual, and only grossly wrong points take more
LEAVE_ONE_OUT_MARGIN = 2.0  # a simpler model's error may exceed the best by this / M, as a share


@dataclass(frozen=True)
class PointPairs:
    """Control points in the normalised plane: in the image, and on the ground by a similarity."""

    image: Points
    ground: Points


@dataclass(frozen=True)
class Posterior:
    """All nine terms with their uncertainty, and the noise of the control points."""

    mean: Terms  # most probable terms
    covariance: Float[Array, "9 9"]  # at the estimated noise
    precision: Terms  # inverse variances of the prior, zero for the free similarity terms
    noise: float  # standard deviation of one coordinate of one point
    dof: float  # degrees of freedom of the noise estimate
    misfit: float  # squared residuals, and terms over their prior, in the plane; outliers raise it


@dataclass(frozen=True)
class Candidate:
    """One transform model fitted to the points."""

    model: str  # "similarity", "affine" or "homography"
    terms: Terms  # zero where the model has no such term
    leave_one_out: Points  # residual of each point from a fit without it
    misfit: float  # squared residuals, and terms over their prior, in noise variances


def select_pairs(pairs: PointPairs, keep: Bool[Array, "m"]) -> PointPairs:
    """Keep the pairs where the mask `keep` is True."""
    return PointPairs(pairs.image[keep], pairs.ground[keep])


def apply_terms(terms: Terms, points: Points) -> Points:
    """Map points of the normalised plane by the nine terms."""
    undistorted = points * (1.0 + terms[8] * np.sum(points**2, axis=1, keepdims=True))
    denominator = 1.0 + undistorted @ terms[6:8]
    return (undistorted @ _linear_part(terms).T + terms[:2]) / denominator[:, None]


def term_jacobian(terms: Terms, points: Points) -> Float[Array, "m 2 9"]:
    """Differentiate `apply_terms`: [:, i, k] is the derivative of x (i = 0) or y by term k."""
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
        terms: of which the lens term is not part of a homography.
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
    """Fit some of the nine terms by regularised least squares (Levenberg-Marquardt).

    Args:
        pairs: control points.
        free: indices of the terms to fit; the others stay zero.
        ridge: inverse variances of the terms' prior times the variance of the noise.
        start: first values; None starts at zero, the similarity that normalised the points.

    Returns:
        All nine terms.
    """
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


def fit_candidates(pairs: PointPairs, posterior: Posterior) -> list[Candidate]:
    """Fit similarity, affine and homography, each with its leave-one-out residuals."""
    sigmas = abs(posterior.mean[8]) / np.sqrt(posterior.covariance[8, 8])
    lens = [8] if len(pairs.image) >= MIN_POINTS_LENS and sigmas > MIN_LENS_SIGMAS else []
    return [
        _fit_candidate(model, pairs, [*range(count), *lens], posterior)
        for model, count in TERM_COUNTS.items()
    ]


def _fit_candidate(
    model: str, pairs: PointPairs, free: list[int], posterior: Posterior
) -> Candidate:
    """Fit one model; a leave-one-out residual is (I - H)^-1 e, H the point's hat matrix block."""
    ridge = posterior.precision * posterior.noise**2
    terms = fit_terms(pairs, free, ridge)
    error = pairs.ground - apply_terms(terms, pairs.image)
    misfit = np.sum(error**2) + np.sum(ridge * terms**2)
    design = term_jacobian(terms, pairs.image)[:, :, free]
    flat = design.reshape(-1, len(free))
    inverse = invert_normal_matrix(flat.T @ flat + np.diag(ridge[free]))
    leverage = np.eye(2) * (1.0 + 1e-12) - design @ inverse @ design.transpose(0, 2, 1)
    leave_one_out = np.linalg.solve(leverage, error[:, :, None])[:, :, 0]
    return Candidate(model, terms, leave_one_out, float(misfit / posterior.noise**2))


def choose_model(candidates: list[Candidate]) -> Candidate:
    """Choose the simplest model whose mean leave-one-out distance is near the lowest.

    Only models that lower the misfit by more than chance are considered. For few points,
    leave-one-out alone takes too rich a model, and AICc and GRIC on plain fits do worse still
    (`geoaim.bench.georeference`).
    """
    first = candidates[0]
    considered = [
        candidate
        for candidate in candidates
        if first.misfit - candidate.misfit >= MIN_MISFIT_DROP * (TERM_COUNTS[candidate.model] - 4)
    ]
    errors = [float(np.linalg.norm(c.leave_one_out, axis=1).mean()) for c in considered]
    limit = (1.0 + LEAVE_ONE_OUT_MARGIN / len(first.leave_one_out)) * min(errors)
    return next(c for c, error in zip(considered, errors, strict=True) if error <= limit)
