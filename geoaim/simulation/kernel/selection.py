"""Select the map of a view, and the boxes of a scene, from the arguments of the loops."""

from typing import NamedTuple, no_type_check

from numpy import ndarray as Array

from geoaim.simulation.kernel.compilation import compile_loops


class Paint(NamedTuple):
    """How a box is painted."""

    number: int  # number of the box in its scene
    layer: int  # number of its layer
    channel: int  # the first of the picture's channels that it is painted in
    colour: Array  # (K,)
    triangle_colour: Array  # (K,)
    has_triangle: bool


@compile_loops
@no_type_check
def select_map(views, textures, view):
    """Select the map of a view.

    Args:
        views: all views.
        textures: the textures of one map, or of one map for each scene.
        view: number of the view.

    Returns:
        Its transform and its region.
    """
    place = view * views.scenes // len(views.cameras) if len(textures.regions) > 1 else 0
    return textures.image_from_world[place], textures.regions[place]


@compile_loops
@no_type_check
def is_present(boxes, scene, number):
    """Whether a box is present.

    Args:
        boxes: the boxes of all scenes.
        scene: number of the box's scene.
        number: number of the box in its scene.

    Returns:
        True if it is.
    """
    return boxes.present.size == 0 or boxes.present[scene, number]


@compile_loops
@no_type_check
def select_box(boxes, scene, number):
    """Select a box.

    Args:
        boxes: the boxes of all scenes.
        scene: number of the box's scene.
        number: number of the box in its scene.

    Returns:
        Its pose and its size.
    """
    return boxes.poses[scene, number], boxes.sizes[min(scene, len(boxes.sizes) - 1), number]


@compile_loops
@no_type_check
def select_paint(boxes, scene, number, layer):
    """Select how a box is painted.

    Args:
        boxes: the boxes of all scenes.
        scene: number of the box's scene.
        number: number of the box in its scene.
        layer: number of its layer.

    Returns:
        Its channels and colours.
    """
    _, has_triangle, channel = boxes.layers[layer]
    row = min(scene, len(boxes.colours) - 1)
    triangle_row = min(scene, len(boxes.triangle_colours) - 1)
    return Paint(
        number,
        layer,
        channel,
        boxes.colours[row, number],
        boxes.triangle_colours[triangle_row, number],
        has_triangle != 0,
    )
