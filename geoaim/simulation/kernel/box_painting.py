"""Paint one box: row by row, its edges by their coverage, the rest at once."""

from typing import no_type_check

import numpy as np

from geoaim.simulation.kernel.areas import compute_area
from geoaim.simulation.kernel.arrays import PaintedFragments
from geoaim.simulation.kernel.boxes import (
    FRONT,
    compute_corners,
    span_columns,
    span_pixels,
    span_rows,
)
from geoaim.simulation.kernel.compilation import compile_loops
from geoaim.simulation.rasterization import HALF_DIAGONAL_PX

BOX_EDGE, TRIANGLE_EDGE = 1, 2  # flags of a fragment through which such an edge may pass


@compile_loops
@no_type_check
def paint_box(box, paint, picture, tops, noted):
    """Paint a box where no upper one covers it.

    Args:
        box: the box in pixels of the view.
        paint: its colours.
        picture: (C, H, W), which is painted on.
        tops: (H, W) the uppermost box that covers each pixel, or empty.
        noted: the fragments so far, their number, and whether to add the box's own.

    Returns:
        The fragments, to which the box's own may have been added, and their number.
    """
    fragments, count, keep = noted
    _, height, width = picture.shape
    corners = compute_corners(box)
    first_row, end_row = span_rows(box, height)
    for row in range(first_row, end_row):
        first, inside, outside, end = span_row(box, paint.has_triangle, row, width)
        if keep and count + end - first > len(fragments.places):
            fragments = _enlarge(fragments, count + end - first)
        for start, stop in ((first, inside), (outside, end)):
            for column in range(start, stop):
                if tops.size == 0 or tops[row, column] <= paint.number:
                    share, triangle_share, edges = _measure_pixel(
                        box, corners, paint.has_triangle, row, column
                    )
                    # written out, since a call would count references to all arrays
                    for k in range(len(paint.colour)):
                        below = picture[paint.channel + k, row, column]
                        added = triangle_share * (paint.triangle_colour[k] - paint.colour[k])
                        added += share * paint.colour[k]
                        picture[paint.channel + k, row, column] = added + (1 - share) * below
                        if keep:
                            fragments.below[count, k] = below
                    if keep:
                        fragments.shares[count] = share, triangle_share
                        fragments.places[count] = paint.number, paint.layer, row, column, edges
                        count += 1
        if tops.size:  # cut what is hidden off both ends
            while inside < outside and tops[row, inside] > paint.number:
                inside += 1
            while inside < outside and tops[row, outside - 1] > paint.number:
                outside -= 1
        if inside < outside:
            for k in range(len(paint.colour)):
                picture[paint.channel + k, row, inside:outside] = paint.colour[k]
            if keep:
                fragments.places[count] = paint.number, paint.layer, row, inside, -outside
                count += 1
    return fragments, count


@compile_loops
@no_type_check
def span_row(box, has_triangle, row, width):
    """Find the columns of a row that a box may touch, and those that it covers.

    Args:
        box: the box in pixels of the view.
        has_triangle: whether a triangle shows its heading; its pixels do not count as covered.
        row: the row of the view.
        width: width of the view, pixels.

    Returns:
        Four columns: the first one touched, the first one covered, the one after the last covered,
        and the one after the last touched.
    """
    length, side, y = box.half_length, box.half_width, row + 0.5 - box.row
    reach = length + HALF_DIAGONAL_PX
    low, high = span_columns(box, y, -reach, reach, side + HALF_DIAGONAL_PX)
    first, end = span_pixels(box.column + low, box.column + high, width)
    behind, ahead = HALF_DIAGONAL_PX - length, length - HALF_DIAGONAL_PX
    if has_triangle:
        ahead = min(ahead, FRONT * length - HALF_DIAGONAL_PX)
    if ahead > behind and side > HALF_DIAGONAL_PX:
        low, high = span_columns(box, y, behind, ahead, side - HALF_DIAGONAL_PX)
        if high > low:
            inside, outside = span_pixels(box.column + low, box.column + high, width)
            inside = min(max(inside, first), end)
            return first, inside, min(max(outside, inside), end), end
    return first, end, end, end


@compile_loops
@no_type_check
def _measure_pixel(box, corners, has_triangle, row, column):
    """Measure which shares of a pixel a box and its triangle cover, and flag edges in it."""
    x, y = column + 0.5 - box.column, row + 0.5 - box.row
    along, across = x * box.right + y * box.down, x * box.down - y * box.right
    share, triangle_share, edges = 1.0, 0.0, 0
    if min(box.half_length - abs(along), box.half_width - abs(across)) < HALF_DIAGONAL_PX:
        share, edges = compute_area(corners[0], column, row), BOX_EDGE
    if has_triangle and along > FRONT * box.half_length - HALF_DIAGONAL_PX:
        triangle_share = compute_area(corners[1], column, row)
        edges += TRIANGLE_EDGE
    return share, triangle_share, edges


@compile_loops
@no_type_check
def _enlarge(fragments, count):
    """Copy fragments into arrays with space for twice `count`."""
    places = np.empty((2 * count, 5), np.int32)
    shares = np.empty((2 * count, 2), fragments.shares.dtype)
    below = np.empty((2 * count, fragments.below.shape[1]), fragments.below.dtype)
    size = len(fragments.places)
    places[:size], shares[:size], below[:size] = (
        fragments.places,
        fragments.shares,
        fragments.below,
    )
    return PaintedFragments(fragments.starts, places, shares, below)
