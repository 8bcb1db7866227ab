"""A box in one view: where it lies, and which pixels it touches."""

import math
from typing import NamedTuple, no_type_check

import numpy as np

from geoaim.simulation.kernel.compilation import compile_loops
from geoaim.simulation.rasterization import HALF_DIAGONAL_PX, TRIANGLE_SHARE

MIN_SLOPE = 1e-12  # avoids divisions by zero
# where the triangle at the front begins, in half lengths from the centre
FRONT = 1 - 2 * TRIANGLE_SHARE
# corners of a box and of its triangle, whose tip counts twice: half lengths forwards, half widths
# to the left
CORNERS = np.array(
    [
        [[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]],
        [[1.0, 0.0], [1.0, 0.0], [FRONT, -1.0], [FRONT, 1.0]],
    ]
)


class Box(NamedTuple):
    """A box in pixels of its view."""

    column: float  # the centre's column and row (corner origin)
    row: float
    right: float  # unit vector of its heading
    down: float
    half_length: float
    half_width: float


@compile_loops
@no_type_check
def project_box(camera, pose, size, resolution, shape):
    """Project a box into the view of a camera.

    Args:
        camera: (3,) x and y, metres, and heading, radians.
        pose: (3,) x and y, metres, and heading, radians, of the box.
        size: (2,) length and width, metres.
        resolution: resolution of the view, metres per pixel.
        shape: height and width of the view, pixels.

    Returns:
        The box, pixels.
    """
    height, width = shape
    x, y, turn = pose[0] - camera[0], pose[1] - camera[1], pose[2] - camera[2]
    cosine, sine = math.cos(camera[2]), math.sin(camera[2])
    return Box(
        width / 2 + (x * sine - y * cosine) / resolution,
        height / 2 - (x * cosine + y * sine) / resolution,
        -math.sin(turn),
        -math.cos(turn),
        size[0] / 2 / resolution,
        size[1] / 2 / resolution,
    )


@compile_loops
@no_type_check
def span_rows(box, height):
    """Find the first row of pixels that a box may touch, and the one after the last."""
    reach = abs(box.down) * (box.half_length + HALF_DIAGONAL_PX)
    reach += abs(box.right) * (box.half_width + HALF_DIAGONAL_PX)
    return span_pixels(box.row - reach, box.row + reach, height)


@compile_loops
@no_type_check
def span_columns(box, y, behind, ahead, side):
    """Find the part of a row of pixels that lies within limits along and across a box.

    Args:
        box: the box in pixels of the view.
        y: the row's distance below the box's centre, pixels.
        behind: lower limit along the heading, pixels from the centre.
        ahead: upper limit along the heading.
        side: largest distance to either side.

    Returns:
        Its ends, pixels to the right of the box's centre; the second is lower where there is none.
    """
    low, high = -math.inf, math.inf
    offset = y * box.down
    if abs(box.right) > MIN_SLOPE:
        one, other = (behind - offset) / box.right, (ahead - offset) / box.right
        low, high = min(one, other), max(one, other)
    elif offset < behind or offset > ahead:
        return 0.0, -1.0
    offset = -y * box.right
    if abs(box.down) > MIN_SLOPE:
        one, other = (-side - offset) / box.down, (side - offset) / box.down
        low, high = max(low, min(one, other)), min(high, max(one, other))
    elif abs(offset) > side:
        return 0.0, -1.0
    return low, high


@compile_loops
@no_type_check
def span_pixels(low, high, count):
    """Find the pixels whose centres lie in an interval.

    Args:
        low: lower end of the interval, pixels.
        high: upper end of the interval.
        count: number of pixels.

    Returns:
        The first pixel, and the one after the last.
    """
    first = math.ceil(min(max(low - 0.5, 0.0), float(count)))
    end = math.floor(min(max(high + 0.5, 0.0), float(count)))
    return first, max(end, first)


@compile_loops
@no_type_check
def compute_corners(box):
    """Compute the (4, 2) corners of a box, and those of its triangle, whose tip counts twice."""
    corners = np.empty((2, 4, 2))
    for polygon in range(2):
        for k in range(4):
            forward, left = CORNERS[polygon, k]
            forward, left = forward * box.half_length, left * box.half_width
            corners[polygon, k, 0] = box.column + forward * box.right + left * box.down
            corners[polygon, k, 1] = box.row + forward * box.down - left * box.right
    return corners
