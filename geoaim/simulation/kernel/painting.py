"""Paint views: the ground, then boxes over it; for gradients, fragments are kept."""

import math
from typing import no_type_check

import numpy as np

from geoaim.simulation.kernel.arrays import PaintedFragments
from geoaim.simulation.kernel.box_painting import paint_box, span_row
from geoaim.simulation.kernel.boxes import project_box, span_rows
from geoaim.simulation.kernel.compilation import compile_loops
from geoaim.simulation.kernel.sampling import project_view, sample_view
from geoaim.simulation.kernel.selection import is_present, select_box, select_map, select_paint

# what cannot be drawn: a camera or a box that is present, or a map beyond its image
CAMERA_PROBLEM, BOX_PROBLEM, MAP_PROBLEM = -1, -2, -3
FIRST_CAPACITY = 1024  # fragments for which there is space at first


@compile_loops
@no_type_check
def paint_views(views, textures, boxes, pictures, part, keep):
    """Paint a part of the views.

    Args:
        views: all V cameras.
        textures: the textures of their maps.
        boxes: the boxes of their scenes.
        pictures: (V, C, H, W), overwritten: channels of the ground, then channels of boxes alone.
        part: the first view, and the one after the last.
        keep: whether to return the fragments, for `differentiate_views`.

    Returns:
        The fragments of these views; none if they are not kept. Where a pose cannot be drawn,
        `starts` holds a single number instead, such as `CAMERA_PROBLEM`.
    """
    first, end = part
    capacity, channels = FIRST_CAPACITY if keep else 0, boxes.colours.shape[2]
    fragments = PaintedFragments(
        np.zeros(end - first + 1, np.int64),
        np.empty((capacity, 5), np.int32),
        np.empty((capacity, 2), pictures.dtype),
        np.empty((capacity, channels), pictures.dtype),
    )
    count = 0
    for view in range(first, end):
        picture = pictures[view]
        if len(views.present) and not views.present[view]:
            picture[:] = 0
        elif not abs(views.cameras[view].sum()) < math.inf:
            return _report(CAMERA_PROBLEM, fragments)
        else:
            image_from_world, region = select_map(views, textures, view)
            matrix = project_view(
                image_from_world, views.cameras[view], views.resolution, picture.shape[1:]
            )
            if not (abs(matrix.sum()) < math.inf and _has_region(textures.image, region)):
                return _report(MAP_PROBLEM, fragments)
            sample_view(textures.image, region, matrix, picture)
            picture[textures.image.shape[2] :] = 0
            fragments, count = _paint_boxes(views, boxes, view, picture, (fragments, count), keep)
            if count < 0:
                return _report(BOX_PROBLEM, fragments)
        fragments.starts[view - first + 1] = count
    return fragments


@compile_loops
@no_type_check
def _has_region(image, region):
    """Whether a map's region, of two pixels a side or more, lies in the image."""
    height, width, _ = image.shape
    left, top, right, bottom = region
    return 0 <= left < right - 1 and right <= width and 0 <= top < bottom - 1 and bottom <= height


@compile_loops
@no_type_check
def _paint_boxes(views, boxes, view, picture, noted, keep):
    """Paint the boxes of a view.

    Returns:
        The fragments, and their number; -1 where a box that is present cannot be drawn.
    """
    fragments, count = noted
    scene, shape = view * views.scenes // len(views.cameras), picture.shape[1:]
    total = 0.0
    for number in range(boxes.poses.shape[1]):
        if is_present(boxes, scene, number):
            pose, size = select_box(boxes, scene, number)
            if not (abs(pose.sum() + size.sum()) < math.inf and min(size[0], size[1]) > 0):
                return fragments, -1
            total += min(size[0], shape[0] * views.resolution) * size[1] / views.resolution**2
    tops = np.empty((0, 0), np.int32)
    if total > shape[0] * shape[1] and (boxes.layers[:, 2] == boxes.layers[0, 2]).all():
        tops = _find_tops(views, boxes, view, shape)
    first = 0
    for layer in range(len(boxes.layers)):
        end = first + boxes.layers[layer, 0]
        for number in range(first, end):
            if is_present(boxes, scene, number):
                pose, size = select_box(boxes, scene, number)
                box = project_box(views.cameras[view], pose, size, views.resolution, shape)
                paint = select_paint(boxes, scene, number, layer)
                noted = fragments, count, keep
                fragments, count = paint_box(box, paint, picture, tops, noted)
        first = end
    return fragments, count


@compile_loops
@no_type_check
def _find_tops(views, boxes, view, shape):
    """Find the uppermost box that covers each pixel of a view; -1: none.

    What lies below it needs no painting, which counts where many boxes lie on each other.
    """
    tops = np.full(shape, -1, np.int32)
    scene = view * views.scenes // len(views.cameras)
    has_triangles = (boxes.layers[:, 1] != 0).any()  # then none covers pixels at its front
    for number in range(boxes.poses.shape[1] - 1, -1, -1):
        if is_present(boxes, scene, number):
            pose, size = select_box(boxes, scene, number)
            box = project_box(views.cameras[view], pose, size, views.resolution, shape)
            first, end = span_rows(box, shape[0])
            for row in range(first, end):
                _, inside, outside, _ = span_row(box, has_triangles, row, shape[1])
                for column in range(inside, outside):
                    tops[row, column] = max(tops[row, column], number)
    return tops


@compile_loops
@no_type_check
def _report(problem, fragments):
    """Return a problem in place of the starts of fragments."""
    return PaintedFragments(
        np.array([problem]), fragments.places, fragments.shares, fragments.below
    )
