"""Gradients of a sampled view with respect to its place and to the texture."""

from typing import no_type_check

import numpy as np

from geoaim.simulation.kernel.compilation import compile_loops
from geoaim.simulation.kernel.sampling import locate_texels, start_row


@compile_loops
@no_type_check
def differentiate_view(image, region, matrix, grad):
    """Compute the gradient of `sample_view` with respect to its matrix.

    Args:
        image: (h, w, C) textures of all maps.
        region: left, top, right and bottom edge of the view's map in the image.
        matrix: (2, 3) transform from the view's pixels to those of the image.
        grad: (C, H, W) gradient with respect to the picture.

    Returns:
        (2, 3) gradient with respect to the matrix.
    """
    _, width, channels = image.shape
    number, texels = image.dtype.type, image.reshape(-1)
    u_end, v_end, origin, stride = locate_texels(region, width, channels)
    result = np.zeros((2, 3))
    for row in range(grad.shape[1]):
        u_start, v_start = start_row(matrix, row, region)
        red, green, blue = grad[0, row], grad[channels // 2, row], grad[channels - 1, row]
        u_sum, u_moment, v_sum, v_moment = 0.0, 0.0, 0.0, 0.0
        for column in range(grad.shape[2]):
            u_free, v_free = u_start + matrix[0, 0] * column, v_start + matrix[1, 0] * column
            u, v = min(max(u_free, 0.0), u_end), min(max(v_free, 0.0), v_end)
            x, y = number(u - int(u)), number(v - int(v))
            i = origin + int(v) * stride + int(u) * channels
            j = i + stride
            # the four texels around the sample, summed over the channels
            if channels == 3:
                weights = red[column], green[column], blue[column]
                a, b = _weigh(texels, i, weights), _weigh(texels, i + 3, weights)
                c, d = _weigh(texels, j, weights), _weigh(texels, j + 3, weights)
            else:
                a, b, c, d = number(0), number(0), number(0), number(0)
                for k in range(channels):
                    weight = grad[k, row, column]
                    a, b = a + weight * texels[i + k], b + weight * texels[i + channels + k]
                    c, d = c + weight * texels[j + k], d + weight * texels[j + channels + k]
            twist = d - c - b + a
            by_u = float(b - a + y * twist) if u == u_free else 0.0  # 0 beyond the edges
            by_v = float(c - a + x * twist) if v == v_free else 0.0
            u_sum, u_moment = u_sum + by_u, u_moment + by_u * column
            v_sum, v_moment = v_sum + by_v, v_moment + by_v * column
        for i, total, moment in ((0, u_sum, u_moment), (1, v_sum, v_moment)):
            result[i, 0] += moment + 0.5 * total
            result[i, 1] += total * (row + 0.5)
            result[i, 2] += total
    return result


@compile_loops
@no_type_check
def _weigh(texels, i, weights):
    """Sum a texel over its three channels."""
    red, green, blue = weights
    return red * texels[i] + green * texels[i + 1] + blue * texels[i + 2]


@compile_loops
@no_type_check
def differentiate_texture(region, matrix, grad, grad_image):
    """Add the gradient of `sample_view` with respect to the image.

    Args:
        region: left, top, right and bottom edge of the view's map in the image.
        matrix: (2, 3) transform from the view's pixels to those of the image.
        grad: (C or more, H, W) gradient with respect to the picture.
        grad_image: (h, w, C) gradient with respect to the image; the result is added to it.
    """
    _, width, channels = grad_image.shape
    number, texels = grad_image.dtype.type, grad_image.reshape(-1)
    u_end, v_end, origin, stride = locate_texels(region, width, channels)
    for row in range(grad.shape[1]):
        u_start, v_start = start_row(matrix, row, region)
        for column in range(grad.shape[2]):
            u = min(max(u_start + matrix[0, 0] * column, 0.0), u_end)
            v = min(max(v_start + matrix[1, 0] * column, 0.0), v_end)
            x, y = number(u - int(u)), number(v - int(v))
            i = origin + int(v) * stride + int(u) * channels
            for k in range(channels):
                change = grad[k, row, column]
                texels[i + k] += change * (1 - x) * (1 - y)
                texels[i + channels + k] += change * x * (1 - y)
                texels[i + stride + k] += change * (1 - x) * y
                texels[i + stride + channels + k] += change * x * y
