"""An independent renderer: exact areas by shapely, painted box by box, in float64."""

import numpy as np
import shapely
from scipy.ndimage import map_coordinates


def draw(view, camera, image, image_from_world, boxes):
    """Draw one view.

    Args:
        view: size and resolution.
        camera: x, y, heading.
        image: (C, h, w) texture, that goes on beyond its edges.
        image_from_world: (2, 3).
        boxes: in paint order: pose (3,), size (2,), colour (C,), colour of the triangle or None.
    """
    rows, columns = np.mgrid[: view.height, : view.width] + 0.5
    ahead = (view.height / 2 - rows) * view.resolution
    right = (columns - view.width / 2) * view.resolution
    c, s = np.cos(camera[2]), np.sin(camera[2])
    x, y = camera[0] + ahead * c + right * s, camera[1] + ahead * s - right * c
    u, v = np.einsum("ij,jhw->ihw", image_from_world, np.stack([x, y, np.ones_like(x)])) - 0.5
    picture = np.stack([map_coordinates(band, [v, u], order=1, mode="nearest") for band in image])
    pixels = shapely.box(columns - 0.5, rows - 0.5, columns + 0.5, rows + 0.5)
    for pose, size, colour, triangle_colour in boxes:
        box, triangle = _get_polygons(view, camera, pose, size)
        share = _measure(box, pixels)
        painted = share * colour[:, None, None]
        if triangle_colour is not None:
            painted += _measure(triangle, pixels) * (triangle_colour - colour)[:, None, None]
        picture = painted + (1 - share) * picture
    return picture


def _measure(polygon, pixels):
    """The area of each pixel that a polygon covers."""
    touched = shapely.intersects(pixels, polygon)
    share = np.zeros(pixels.shape)
    share[touched] = shapely.area(shapely.intersection(pixels[touched], polygon))
    return share


def _get_polygons(view, camera, pose, size):
    """The box, and the triangle in the first 0.35 of its length, in pixels of the view."""
    length, width = size
    outline = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [length / 2, width / 2]
    front = length / 2 - 0.35 * length
    tip = np.array([[length / 2, 0], [front, -width / 2], [front, width / 2]])
    return tuple(_project(view, camera, pose, corners) for corners in (outline, tip))


def _project(view, camera, pose, corners):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    world = corners @ [[c, s], [-s, c]] + pose[:2] - camera[:2]
    c, s = np.cos(camera[2]), np.sin(camera[2])
    ahead, left = world @ [c, s], world @ [-s, c]
    column = view.width / 2 - left / view.resolution
    row = view.height / 2 - ahead / view.resolution
    return shapely.Polygon(np.column_stack([column, row]))
