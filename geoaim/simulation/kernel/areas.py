"""The area that a polygon shares with a pixel, and its gradient (see `coverage`)."""

from typing import no_type_check

from geoaim.simulation.kernel.compilation import compile_loops

MIN_RUN_PX = 1e-6  # an edge that runs less far to the side counts as vertical


@compile_loops
@no_type_check
def compute_area(corners, column, row):
    """Compute the area that a polygon shares with a pixel (see `coverage`).

    Args:
        corners: (4, 2) columns and rows.
        column: the pixel's column.
        row: the pixel's row.

    Returns:
        The area, 0 to 1.
    """
    area = 0.0
    for k in range(4):
        x, y = corners[k, 0] - column, corners[k, 1] - row
        next_x, next_y = corners[(k + 1) % 4, 0] - column, corners[(k + 1) % 4, 1] - row
        start, end = min(max(y, 0.0), 1.0), min(max(next_y, 0.0), 1.0)
        if start == end or max(x, next_x) <= 0.0:
            continue
        if min(x, next_x) >= 1.0:
            area += end - start
        else:
            slope = (next_x - x) / (next_y - y)
            first, last = x + (start - y) * slope, x + (end - y) * slope
            area += (end - start) * _average_clamped(first, last)
    return area


@compile_loops
@no_type_check
def _average_clamped(first, last):
    """Average the numbers of an interval, clamped to 0 to 1."""
    if abs(last - first) < MIN_RUN_PX:
        return min(max((first + last) / 2, 0.0), 1.0)
    low, high = min(max(first, 0.0), 1.0), min(max(last, 0.0), 1.0)
    return (high * (last - high / 2) - low * (first - low / 2)) / (last - first)


@compile_loops
@no_type_check
def add_area_gradient(corners, column, row, factor, gradient):
    """Add the gradient of `compute_area`.

    Args:
        corners: (4, 2) columns and rows.
        column: the pixel's column.
        row: the pixel's row.
        factor: number by which the gradient is multiplied.
        gradient: (4, 2) gradient with respect to the corners; the result is added to it.
    """
    for k in range(4):
        x, y = corners[k, 0] - column, corners[k, 1] - row
        across = corners[(k + 1) % 4, 0] - column - x
        along = corners[(k + 1) % 4, 1] - row - y
        start, end = _clip(x, across, 0.0, 1.0)
        start, end = _clip(y, along, start, end)
        if end > start:
            by_end = factor * (end * end - start * start) / 2
            by_start = factor * (end - start) - by_end
            gradient[k, 0] += along * by_start
            gradient[k, 1] -= across * by_start
            gradient[(k + 1) % 4, 0] += along * by_end
            gradient[(k + 1) % 4, 1] -= across * by_end


@compile_loops
@no_type_check
def _clip(position, change, start, end):
    """Clip the part from `start` to `end` of an edge to where its coordinate is in 0 to 1."""
    if abs(change) < MIN_RUN_PX:  # along the pixel's border, it counts in one of the two pixels
        return (start, end) if 0.0 <= position + change / 2 < 1.0 else (1.0, 0.0)
    enter, leave = -position / change, (1.0 - position) / change
    return max(start, min(enter, leave)), min(end, max(enter, leave))
