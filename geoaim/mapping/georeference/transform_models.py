"""Transform models from the image to the ground: similarity and homography.

They are fitted in the normalised plane p (origin at the image's centre, x right, y up, unit half a
diagonal), to ground points that the best similarity has brought onto it. Every parameter is then
small. There are nine, called terms: shift and similarity (tx, ty, s, r), stretch and shear (a, b),
perspective (c), one radial lens term (k), which thus does not depend on the resolution:

    q = (A p' + t) / (1 + c . p'),   p' = p (1 + k |p|^2),   A = [[1+s+a, b-r], [b+r, 1+s-a]]

A similarity frees the first 4 terms, a homography the first 8, each with or without the lens term
(`model_choice`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.optimize import least_squares

Points = Float[Array, "m 2"]  # rows of x and y, or of u and v
Terms = Float[Array, "9"]  # the nine terms in the order above

TERM_COUNTS = {"similarity": 4, "homography": 8}  # free terms without the lens


@dataclass(frozen=True)
class PointPairs:
    """Control points in the normalised plane: their pixels, and their ground by a similarity."""

    image: Points
    ground: Points
    # brings the errors of points of unequal accuracy to one variance; None: all count alike
    whitening: Float[Array, "m 2 2"] | None = None

    def compute_errors(self, terms: Terms) -> Points:
        """Compute how far the ground lies from where terms put the points, whitened."""
        return self._whiten((self.ground - apply_terms(terms, self.image))[:, :, None])[:, :, 0]

    def compute_design(self, terms: Terms) -> Float[Array, "m 2 9"]:
        """Compute the derivatives of the terms' places to each term, whitened."""
        return self._whiten(term_jacobian(terms, self.image))

    def _whiten(self, values: Float[Array, "m 2 k"]) -> Float[Array, "m 2 k"]:
        return values if self.whitening is None else self.whitening @ values


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
    whitening = None if pairs.whitening is None else pairs.whitening[keep]
    return PointPairs(pairs.image[keep], pairs.ground[keep], whitening)


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
    """Compose the homography from undistorted pixels to world metres."""
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
        error = -pairs.compute_errors(terms)
        return np.concatenate([error.ravel(), root * values])

    def jacobian(values: Array) -> Array:
        terms[free] = values
        design = pairs.compute_design(terms).reshape(-1, 9)[:, free]
        return np.concatenate([design, np.diag(root)])

    first = np.zeros(len(free)) if start is None else start[free]
    # 6 evaluations are usual, and only grossly wrong points take more
    limits = {"xtol": 1e-9, "ftol": 1e-12, "gtol": 1e-15, "max_nfev": 30}
    terms[free] = least_squares(residuals, first, jacobian, method="lm", **limits).x
    return terms


def invert_normal_matrix(normal: Float[Array, "k k"]) -> Float[Array, "k k"]:
    """Invert a normal matrix J^T J; a tiny ridge keeps variances of undetermined terms finite."""
    scale = 1.0 / np.sqrt(np.diag(normal) + 1e-30)
    even = normal * scale * scale[:, None] + 1e-12 * np.eye(len(normal))
    return np.asarray(np.linalg.inv(even) * scale * scale[:, None])


def half_diagonal(height: float, width: float) -> float:
    """Compute half the image's diagonal in pixels: the unit of the normalised plane."""
    return float(np.hypot(height, width) / 2.0)


def plane_from_image(height: float, width: float) -> Float[Array, "3 3"]:
    """Make the transform from pixels (corner origin) to the normalised plane."""
    unit = half_diagonal(height, width)
    return np.array([[1.0, 0.0, -width / 2], [0.0, -1.0, height / 2], [0.0, 0.0, unit]]) / unit


def normalise_pixels(pixels: Points, size: tuple[int, int]) -> Points:
    """Transform pixels of an image of (height, width) to the normalised plane."""
    matrix = plane_from_image(*size)
    return np.asarray(pixels, np.float64) @ matrix[:2, :2].T + matrix[:2, 2]


def fit_similarity(
    points: Points, targets: Points, *, mirrored: bool = False
) -> tuple[Float[Array, "3 3"], float]:
    """Fit a similarity by least squares, without the point that fits worst."""
    z = points[:, 0] + 1j * points[:, 1]
    z = z.conj() if mirrored else z
    q = targets[:, 0] + 1j * targets[:, 1]
    subsets = ~np.eye(len(z), dtype=bool) if len(z) > 3 else [np.ones(len(z), bool)]
    fits = [_fit_complex_line(z[keep], q[keep]) for keep in subsets]
    error, a, b = min(fits, key=lambda fit: fit[0])
    matrix = [[a.real, -a.imag, b.real], [a.imag, a.real, b.imag], [0.0, 0.0, 1.0]]
    return np.array(matrix), error


def _fit_complex_line(z: Array, q: Array) -> tuple[float, complex, complex]:
    """Squared error, a and b of q = a z + b over complex numbers: a similarity of the plane."""
    centre, middle = z.mean(), q.mean()
    a = np.vdot(z - centre, q - middle) / np.vdot(z - centre, z - centre)
    error = np.sum(np.abs(q - middle - a * (z - centre)) ** 2)
    return float(error), complex(a), complex(middle - a * centre)


def undistort_points(pixels: Points, radial: float, height: int, width: int) -> Points:
    """Remove radial lens distortion: p (1 + k |p|^2) in the normalised plane.

    >>> undistort_points(np.array([[0.0, 0.0]]), 0.01, 60, 80)
    array([[-0.4, -0.3]])
    """
    centre = np.array([width, height]) / 2.0
    offset = np.asarray(pixels, np.float64) - centre
    square = np.sum(offset**2, axis=-1, keepdims=True) / half_diagonal(height, width) ** 2
    return centre + offset * (1.0 + radial * square)


def distort_points(pixels: Points, radial: float, height: int, width: int) -> Points:
    """Invert `undistort_points`, by Newton's method on the radius."""
    centre = np.array([width, height]) / 2.0
    offset = np.asarray(pixels, np.float64) - centre
    target = np.linalg.norm(offset, axis=-1, keepdims=True) / half_diagonal(height, width)
    radius = target.copy()
    for _ in range(20):
        radius -= (radius * (1.0 + radial * radius**2) - target) / (1.0 + 3.0 * radial * radius**2)
    return centre + offset / (1.0 + radial * radius**2)
