"""The normalised image plane: origin at the image's centre, x right, y up, unit half a diagonal.

The radial lens term is defined in this plane too, so it does not depend on the resolution.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

Points = Float[Array, "m 2"]  # rows of x and y, or of u and v


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
    """Fit a similarity by least squares, without the point that fits worst.

    One point that is kilometres off would otherwise spoil the scale of everything that follows.
    """
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

    Args:
        pixels: u, v as they lie in the image.
        radial: k, positive where the lens moves points towards the centre.
        height: height of the image, pixels.
        width: width of the image, pixels.

    Returns:
        Undistorted pixels.

    >>> undistort_points(np.array([[0.0, 0.0]]), 0.01, 60, 80)
    array([[-0.4, -0.3]])
    """
    centre = np.array([width, height]) / 2.0
    offset = np.asarray(pixels, np.float64) - centre
    square = np.sum(offset**2, axis=-1, keepdims=True) / half_diagonal(height, width) ** 2
    return centre + offset * (1.0 + radial * square)


def distort_points(pixels: Points, radial: float, height: int, width: int) -> Points:
    """Invert `undistort_points`, by Newton's method on the radius.

    Args:
        pixels: undistorted u, v.
        radial: k of `undistort_points`.
        height: height of the image, pixels.
        width: width of the image, pixels.

    Returns:
        Pixels as they lie in the image.
    """
    centre = np.array([width, height]) / 2.0
    offset = np.asarray(pixels, np.float64) - centre
    target = np.linalg.norm(offset, axis=-1, keepdims=True) / half_diagonal(height, width)
    radius = target.copy()
    for _ in range(20):
        radius -= (radius * (1.0 + radial * radius**2) - target) / (1.0 + 3.0 * radial * radius**2)
    return centre + offset / (1.0 + radial * radius**2)
