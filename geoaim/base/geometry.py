"""Homographies, points, boxes and angles in float64; the pixel origin is the image's corner."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array


def to_opencv(matrix: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3 3"]:
    """Convert a pixel transform to OpenCV's origin, the centre of the first pixel.

    >>> to_opencv(np.diag([2.0, 2.0, 1.0]))[0, 2]   # resizing by 2 moves pixel centres by 1/2
    np.float64(0.5)
    """
    return translation(-0.5, -0.5) @ matrix @ translation(0.5, 0.5)


def from_opencv(matrix: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3 3"]:
    """Convert a pixel transform from OpenCV's origin: the inverse of `to_opencv`."""
    return translation(0.5, 0.5) @ matrix @ translation(-0.5, -0.5)


def transform_points(
    matrix: Float[Array, "*#batch 3 3"], points: Float[Array, "*#batch m 2"]
) -> Float[Array, "*#batch m 2"]:
    """Map points by a homography, broadcast over leading axes; a matrix of NaN gives NaN.

    >>> transform_points(np.array([[1.0, 0, 3], [0, 1, 4], [0, 0, 1]]), np.zeros((1, 2)))
    array([[3., 4.]])
    """
    transposed = np.swapaxes(np.asarray(matrix, np.float64), -1, -2)
    mapped = np.asarray(points, np.float64) @ transposed[..., :2, :] + transposed[..., 2:, :]
    return mapped[..., :2] / mapped[..., 2:]


def transform_boxes(
    matrix: Float[Array, "*#batch 3 3"], boxes: Float[Array, "*#batch m 4"]
) -> Float[Array, "*#batch m 4 2"]:
    """Map the corners of boxes (left, top, right, bottom) by a homography.

    Returns:
        (..., m, 4, 2) top-left, top-right, bottom-right, bottom-left of each box.
    """
    left, top, right, bottom = np.moveaxis(np.asarray(boxes, np.float64), -1, 0)
    corners = np.stack([left, top, right, top, right, bottom, left, bottom], axis=-1)
    mapped = transform_points(matrix, corners.reshape(*boxes.shape[:-2], 4 * boxes.shape[-2], 2))
    return mapped.reshape(*boxes.shape[:-1], 4, 2)


def image_corners(height: float, width: float) -> Float[Array, "4 2"]:
    """List the corners of an image in pixels: top-left, top-right, bottom-right, bottom-left."""
    return np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])


def wrap_angle(angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Wrap angles (radians) to [-pi, pi).

    >>> wrap_angle(np.array([0.5, 1.5 * np.pi])).round(3)
    array([ 0.5  , -1.571])
    """
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def translation(x: float, y: float) -> Float[Array, "3 3"]:
    """Make the matrix that moves points by x and y."""
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def make_similarity(centre: Float[Array, "2"], angle: float, scale: float) -> Float[Array, "3 3"]:
    """Make the matrix of a rotation (rad, counter-clockwise, y up) and scaling about a point."""
    cosine, sine = scale * np.cos(angle), scale * np.sin(angle)
    linear = np.array([[cosine, -sine], [sine, cosine]])
    return np.vstack([np.column_stack([linear, centre - linear @ centre]), [0.0, 0.0, 1.0]])
