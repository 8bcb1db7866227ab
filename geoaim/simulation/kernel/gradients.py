"""Gradients of painted views, from the fragments that were kept."""

from typing import no_type_check

import numpy as np

from geoaim.simulation.kernel.areas import add_area_gradient
from geoaim.simulation.kernel.box_painting import BOX_EDGE, TRIANGLE_EDGE
from geoaim.simulation.kernel.boxes import CORNERS, compute_corners, project_box
from geoaim.simulation.kernel.compilation import compile_loops
from geoaim.simulation.kernel.sampling import project_view, step_pixels
from geoaim.simulation.kernel.sampling_gradients import differentiate_texture, differentiate_view
from geoaim.simulation.kernel.selection import select_box, select_map, select_paint


@compile_loops
@no_type_check
def differentiate_views(views, textures, boxes, fragments, grads, part):
    """Add the gradients of `paint_views`.

    Args:
        views: the views that were painted.
        textures: the textures of their maps.
        boxes: the boxes of their scenes.
        fragments: the fragments that `paint_views` returned for the part.
        grads: `Gradients`: the pictures' are read, and the results are added to the others.
        part: the first view, and the one after the last.
    """
    first, last = part
    picture = np.empty_like(grads.pictures[0])  # gradient; boxes are undone one by one
    for view in range(first, last):
        if len(views.present) and not views.present[view]:
            continue
        picture[:] = grads.pictures[view]
        end = fragments.starts[view - first + 1]
        while end > fragments.starts[view - first]:  # box by box, from the top down
            start = end - 1
            number = fragments.places[start, 0]
            while start > fragments.starts[view - first]:
                if fragments.places[start - 1, 0] != number:
                    break
                start -= 1
            _differentiate_box(views, boxes, (fragments, start, end), picture, grads, view)
            end = start
        if len(grads.image_from_world):
            _differentiate_ground(views, textures, view, picture, grads)


@compile_loops
@no_type_check
def _differentiate_box(views, boxes, span, picture, grads, view):
    """Add the gradients with respect to a box, whose fragments go from `start` to `end`."""
    fragments, start, end = span
    number, layer = fragments.places[start, 0], fragments.places[start, 1]
    scene = view * views.scenes // len(views.cameras)
    camera, shape = views.cameras[view], picture.shape[1:]
    pose, size = select_box(boxes, scene, number)
    box = project_box(camera, pose, size, views.resolution, shape)
    own = fragments.places[start:end], fragments.shares[start:end], fragments.below[start:end]
    paint = select_paint(boxes, scene, number, layer)
    colours = grads.colours[view, number], grads.triangle_colours[view, number]
    by_corners = _differentiate_paint(box, paint, picture, own, colours)
    by_box = _differentiate_corners(box, by_corners)
    poses = grads.cameras[view], grads.poses[view, number], grads.sizes[view, number]
    _differentiate_projection(box, camera, views.resolution, shape, by_box, poses)


@compile_loops
@no_type_check
def _differentiate_paint(box, paint, picture, fragments, colours):
    """Compute the gradients with respect to a box and to the picture below it.

    Args:
        box: the box in pixels of the view.
        paint: the box's colours.
        picture: (C, H, W) gradient with respect to the picture with the box; overwritten with the
            gradient with respect to the picture without it.
        fragments: places, shares and colours below of the box alone.
        colours: (K,) gradients with respect to the colours of the box and of its triangle; the
            results are added to them.

    Returns:
        (2, 4, 2) gradient with respect to the corners of the box and of its triangle.
    """
    places, shares, below = fragments
    corners, by_corners = compute_corners(box), np.zeros((2, 4, 2))
    for i in range(len(places)):
        _, _, row, column, edges = places[i]
        if edges < 0:
            for k in range(len(paint.colour)):
                line = picture[paint.channel + k, row]
                for covered in range(column, -edges):
                    colours[0][k] += line[covered]
                    line[covered] = 0
            continue
        share, triangle_share = shares[i]
        by_share, by_triangle_share = 0.0, 0.0
        for k in range(len(paint.colour)):
            weight = picture[paint.channel + k, row, column]
            by_share += weight * (paint.colour[k] - below[i, k])
            by_triangle_share += weight * (paint.triangle_colour[k] - paint.colour[k])
            colours[0][k] += weight * (share - triangle_share)
            colours[1][k] += weight * triangle_share
            picture[paint.channel + k, row, column] = weight * (1 - share)
        if edges & BOX_EDGE:
            add_area_gradient(corners[0], column, row, by_share, by_corners[0])
        if edges & TRIANGLE_EDGE:
            add_area_gradient(corners[1], column, row, by_triangle_share, by_corners[1])
    return by_corners


@compile_loops
@no_type_check
def _differentiate_corners(box, by_corners):
    """Convert the gradient with respect to a box's corners to one for its six numbers."""
    column, row, forward_x, forward_y, left_x, left_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for polygon in range(2):
        for k in range(4):
            by_x, by_y = by_corners[polygon, k]
            forward, left = CORNERS[polygon, k]
            column, row = column + by_x, row + by_y
            forward_x, forward_y = forward_x + forward * by_x, forward_y + forward * by_y
            left_x, left_y = left_x + left * by_x, left_y + left * by_y
    return (
        column,
        row,
        box.half_length * forward_x - box.half_width * left_y,
        box.half_length * forward_y + box.half_width * left_x,
        forward_x * box.right + forward_y * box.down,
        left_x * box.down - left_y * box.right,
    )


@compile_loops
@no_type_check
def _differentiate_projection(box, camera, resolution, shape, by_box, grads):
    """Convert the gradient with respect to a box, and add it to camera, pose and size."""
    by_camera, by_pose, by_size = grads
    column, row, right, down, half_length, half_width = by_box
    cosine, sine = np.cos(camera[2]) / resolution, np.sin(camera[2]) / resolution
    by_x, by_y = column * sine - row * cosine, -column * cosine - row * sine
    by_turn = right * box.down - down * box.right
    by_pose[0] += by_x
    by_pose[1] += by_y
    by_pose[2] += by_turn
    by_camera[0] -= by_x
    by_camera[1] -= by_y
    by_camera[2] += column * (shape[0] / 2 - box.row) + row * (box.column - shape[1] / 2) - by_turn
    by_size[0] += half_length / 2 / resolution
    by_size[1] += half_width / 2 / resolution


@compile_loops
@no_type_check
def _differentiate_ground(views, textures, view, picture, grads):
    """Add a view's gradients with respect to its camera, the texture and the texture's place."""
    camera, shape = views.cameras[view], picture.shape[1:]
    image_from_world, region = select_map(views, textures, view)
    matrix = project_view(image_from_world, camera, views.resolution, shape)
    by_matrix = differentiate_view(textures.image, region, matrix, picture)
    if len(grads.image):
        differentiate_texture(region, matrix, picture, grads.image)
    steps = step_pixels(camera, views.resolution, shape)
    height, width = shape
    for i in range(2):
        a, b = image_from_world[i, 0], image_from_world[i, 1]
        right, down, origin = by_matrix[i]
        grads.cameras[view, 0] += a * origin
        grads.cameras[view, 1] += b * origin
        # turned by a small angle, a step right moves up, and a step down moves right
        change = a * steps[0, 0] + b * steps[1, 0], a * steps[0, 1] + b * steps[1, 1]
        grads.cameras[view, 2] += change[0] * down - change[1] * right
        grads.cameras[view, 2] += origin * (change[1] * width / 2 - change[0] * height / 2)
        for j in range(2):
            grads.image_from_world[view, i, j] += (
                right * steps[j, 0] + down * steps[j, 1] + origin * steps[j, 2]
            )
        grads.image_from_world[view, i, 2] += origin
