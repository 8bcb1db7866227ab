"""Move a click to the corner beside it, to a fraction of a pixel."""

import cv2
import numpy as np
from jaxtyping import Shaped
from numpy import ndarray as Array

SNAP_RADIUS_PX = 8.0  # radius around a click in which a corner is searched
SMOOTHING_PX = 0.7  # sigma of the Gaussian before gradients
WINDOW_PX = 7  # half the side of the square that refines the corner
ROUNDED_PX = 3  # half the side of its middle, left out: blur rounds the tip of a corner inwards
MIN_STRENGTH = 6.0  # strength of the weaker gradient, in variances of the noise
MIN_GREY_LEVELS = 2.0  # strength of the weaker gradient where there is no noise
MIN_RATIO = 0.06  # squared ratio of the weaker gradient to the stronger one; an edge has less


def snap_to_corner(
    image: Shaped[Array, "H W *channels"],
    pixel: tuple[float, float],
    radius: float = SNAP_RADIUS_PX,
) -> tuple[float, float] | None:
    """Find the strongest corner near a pixel."""
    height, width = image.shape[:2]
    if not (0 <= pixel[0] <= width and 0 <= pixel[1] <= height and radius > 0):
        raise ValueError(f"({pixel[0]:g}, {pixel[1]:g}) lies outside {width} x {height} pixels")
    reach = int(np.ceil(radius)) + 2 * WINDOW_PX
    left, top = (max(int(value) - reach, 0) for value in pixel)
    crop = image[top : top + 2 * reach + 1, left : left + 2 * reach + 1]
    grey = np.asarray(cv2.cvtColor(crop, cv2.COLOR_RGB2GRAY) if crop.ndim == 3 else crop)
    if min(grey.shape) <= 2 * WINDOW_PX + 5:
        return None
    clicked = np.array([pixel[0] - left, pixel[1] - top]) - 0.5  # OpenCV's origin, in the crop
    found = _find_corner(grey, clicked, radius)
    return None if found is None else (found[0] + left + 0.5, found[1] + top + 0.5)


def _find_corner(
    grey: Shaped[Array, "h w"], clicked: Shaped[Array, "2"], radius: float
) -> tuple[float, float] | None:
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTHING_PX)
    values = cv2.cornerEigenValsAndVecs(smooth, 5, 3)[..., :2]
    rows, columns = np.indices(grey.shape)
    near = np.hypot(columns - clicked[0], rows - clicked[1]) <= radius
    weaker = np.where(near, values.min(axis=2), -1.0)
    row, column = np.unravel_index(weaker.argmax(), weaker.shape)
    limit = max(MIN_STRENGTH * _estimate_noise(grey) ** 2, MIN_GREY_LEVELS**2)
    if weaker[row, column] < max(limit, MIN_RATIO * float(values[row, column].max())):
        return None
    start = np.array([[[column, row]]], np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    corner = cv2.cornerSubPix(smooth, start.copy(), (WINDOW_PX,) * 2, (ROUNDED_PX,) * 2, criteria)
    corner = corner[0, 0]
    if (corner == start[0, 0]).all() or np.linalg.norm(corner - clicked) > radius:
        return None  # OpenCV gives the start back where the refinement leaves the window
    return float(corner[0]), float(corner[1])


def _estimate_noise(grey: Shaped[Array, "h w"]) -> float:
    """Standard deviation of the noise after smoothing, by the median of second differences."""
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)  # Immerkaer 1996
    differences = cv2.filter2D(grey.astype(np.float32), -1, mask)
    sigma = float(np.median(np.abs(differences))) / (6.0 * 0.6745)
    return sigma / max(2.0 * np.sqrt(np.pi) * SMOOTHING_PX, 1.0)
