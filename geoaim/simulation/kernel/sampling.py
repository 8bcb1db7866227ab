"""The ground of a view: bilinear samples of a texture."""

import math
from typing import no_type_check

import numpy as np

from geoaim.simulation.kernel.compilation import compile_loops

LAST_PIXEL_PX = 1e-9  # keeps the right neighbour of a sample within the texture


@compile_loops
@no_type_check
def project_view(image_from_world, camera, resolution, shape):
    """Compute the transform from a view's pixels to those of the image.

    Args:
        image_from_world: (2, 3) metres to pixels of the image.
        camera: (3,) x and y, metres, and heading, radians.
        resolution: resolution of the view, metres per pixel.
        shape: height and width of the view, pixels.

    Returns:
        (2, 3) matrix.
    """
    steps = step_pixels(camera, resolution, shape)
    matrix = np.empty((2, 3))
    for i in range(2):
        for j in range(3):
            matrix[i, j] = (
                image_from_world[i, 0] * steps[0, j] + image_from_world[i, 1] * steps[1, j]
            )
        matrix[i, 2] += image_from_world[i, 2]
    return matrix


@compile_loops
@no_type_check
def step_pixels(camera, resolution, shape):
    """Compute the transform from a view's pixels to metres.

    Args:
        camera: (3,) x and y, metres, and heading, radians.
        resolution: resolution of the view, metres per pixel.
        shape: height and width of the view, pixels.

    Returns:
        (2, 3) matrix: the step to the next column, the step to the next row, and the first corner.
    """
    height, width = shape
    forward_x, forward_y = math.cos(camera[2]) * resolution, math.sin(camera[2]) * resolution
    steps = np.empty((2, 3))
    steps[0, 0], steps[1, 0] = forward_y, -forward_x
    steps[0, 1], steps[1, 1] = -forward_x, -forward_y
    for i in range(2):
        steps[i, 2] = camera[i] - steps[i, 0] * width / 2 - steps[i, 1] * height / 2
    return steps


@compile_loops
@no_type_check
def sample_view(image, region, matrix, picture):
    """Sample the ground of a view.

    Args:
        image: (h, w, C) textures of all maps.
        region: left, top, right and bottom edge of the view's map in the image.
        matrix: (2, 3) transform from the view's pixels to those of the image.
        picture: (C or more, H, W); its first C channels are overwritten.
    """
    _, width, channels = image.shape
    number, texels = picture.dtype.type, image.reshape(-1)
    u_end, v_end, origin, stride = locate_texels(region, width, channels)
    for row in range(picture.shape[1]):
        u_start, v_start = start_row(matrix, row, region)
        red, green, blue = picture[0, row], picture[channels // 2, row], picture[channels - 1, row]
        for column in range(picture.shape[2]):
            u = min(max(u_start + matrix[0, 0] * column, 0.0), u_end)
            v = min(max(v_start + matrix[1, 0] * column, 0.0), v_end)
            x, y = number(u - int(u)), number(v - int(v))
            i = origin + int(v) * stride + int(u) * channels
            j = i + stride
            d = x * y
            b, c = x - d, y - d
            a = number(1) - x - c
            if channels == 3:  # unrolled by hand, which is twice as fast
                red[column] = _blend(texels, i, j, 3, (a, b, c, d))
                green[column] = _blend(texels, i + 1, j + 1, 3, (a, b, c, d))
                blue[column] = _blend(texels, i + 2, j + 2, 3, (a, b, c, d))
            else:
                for k in range(channels):
                    mean = _blend(texels, i + k, j + k, channels, (a, b, c, d))
                    picture[k, row, column] = mean


@compile_loops
@no_type_check
def locate_texels(region, width, channels):
    """Locate a map in the texels of its image, which lie row by row.

    Args:
        region: left, top, right and bottom edge of the map in the image.
        width: width of the image, pixels.
        channels: number of its channels.

    Returns:
        The largest column and row of a sample, from the centre of the map's first texel; the
        index of that texel; and the step from one row to the next.
    """
    left, top, right, bottom = region
    u_end, v_end = right - left - 1 - LAST_PIXEL_PX, bottom - top - 1 - LAST_PIXEL_PX
    return u_end, v_end, (top * width + left) * channels, width * channels


@compile_loops
@no_type_check
def _blend(texels, i, j, step, weights):
    """Average four texels: those at `i` and `j`, and those `step` after them."""
    a, b, c, d = weights
    return a * texels[i] + b * texels[i + step] + c * texels[j] + d * texels[j + step]


@compile_loops
@no_type_check
def start_row(matrix, row, region):
    """Compute where the first pixel of a row of a view lies in its map.

    Args:
        matrix: (2, 3) transform from the view's pixels to those of the image.
        row: the row of the view.
        region: left, top, right and bottom edge of the map in the image.

    Returns:
        Column and row from the centre of the map's first texel.
    """
    left, top, _, _ = region
    u = matrix[0, 0] * 0.5 + matrix[0, 1] * (row + 0.5) + matrix[0, 2] - left - 0.5
    v = matrix[1, 0] * 0.5 + matrix[1, 1] * (row + 0.5) + matrix[1, 2] - top - 0.5
    return u, v
