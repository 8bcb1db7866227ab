"""Warp frames to the image, and correct the blur of their mean."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.base.geometry import image_corners, to_opencv, transform_points


def warp(
    pixels: UInt8[Array, "H W *c"], matrix: Float[Array, "3 3"], size: tuple[int, int]
) -> UInt8[Array, "h w *c"]:
    """Warp pixels with bilinear interpolation to a target of (height, width); edges are repeated.

    Bilinear takes a third of bicubic's time, and OpenCV's bicubic kernel (a = -0.75) shifts smooth
    texture by up to 0.047 px. `sharpen_mean` restores what a mean of bilinear warps loses. The
    matrix leads from pixels of the source to those of the target (corner origin).
    """
    matrix = to_opencv(matrix)
    matrix = matrix / matrix[2, 2]
    affine = np.abs(matrix[2, :2]).max() < 1e-12  # faster
    function, matrix = (cv2.warpAffine, matrix[:2]) if affine else (cv2.warpPerspective, matrix)
    warped = function(pixels, matrix, size[::-1], borderMode=cv2.BORDER_REPLICATE)  # bilinear
    return np.asarray(warped, np.uint8)


def measure_warp_blur(matrix: Float[Array, "3 3"], size: tuple[int, int]) -> Float[Array, "2"]:
    """Measure the mean blur of a bilinear warp along x and y: d (1 - d) at the sub-pixel phase d.

    That is the second moment of the two interpolation weights about the point, in px squared: 0
    where pixels fall on pixels, 1/6 where the phases are uniformly distributed. The arguments are
    those of `warp`.
    """
    # sub-pixel phases are sampled at 16 points along each side
    steps = [(np.arange(16) + 0.5) * extent / 16 // 1 + 0.5 for extent in size[::-1]]
    points = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    phase = (transform_points(np.linalg.inv(matrix), points) - 0.5) % 1.0
    return np.asarray((phase * (1 - phase)).mean(axis=0))


def sharpen_mean(
    pixels: Float32[Array, "h w c"], blur: Float[Array, "2"]
) -> Float32[Array, "h w c"]:
    """Invert the blur of a mean of bilinear warps, given by `measure_warp_blur`.

    Over uniform phases the mean passes (sin(w/2) / (w/2))^2 of a wave of w radians per pixel. Its
    inverse is 1 + w^2/12 + w^4/240 + ... A filter of five weights, 1 + s/12 + s^2/90 with
    s = 2 - 2 cos w, agrees with it to that order.
    """
    second = np.array([0.0, -1.0, 2.0, -1.0, 0.0])
    fourth = np.convolve([-1.0, 2.0, -1.0], [-1.0, 2.0, -1.0])
    along_x, along_y = (np.eye(5)[2] + 6 * v * (second / 12 + fourth / 90) for v in blur)
    sharp = cv2.sepFilter2D(pixels, -1, along_x, along_y, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(sharp, np.float32).reshape(pixels.shape)


def draw_footprint(
    frame_size: tuple[int, ...], image_from_frame: Float[Array, "3 3"], size: tuple[int, int]
) -> UInt8[Array, "h w"]:
    """Draw where a frame shows the image: between the centres of its outermost pixels."""
    corners = image_corners(frame_size[0] - 1, frame_size[1] - 1) + 0.5
    polygon = transform_points(image_from_frame, corners)
    return draw_polygons(polygon[None], size)


def draw_polygons(polygons: Float[Array, "n m 2"], size: tuple[int, int]) -> UInt8[Array, "h w"]:
    """Draw n convex polygons of m corners (pixels) to 1/16 px, on an image of (height, width)."""
    mask = np.zeros(size, np.uint8)
    for polygon in np.rint((polygons - 0.5).clip(-30000, 30000) * 16).astype(np.int32):
        cv2.fillConvexPoly(mask, polygon, [1], shift=4)
    return mask


def enlarge_mask(mask: Bool[Array, "h w"], size: tuple[int, int]) -> UInt8[Array, "H W"]:
    """Resize a small mask to (height, width): 1 where it is True, else 0."""
    large = cv2.resize(mask.view(np.uint8), size[::-1], interpolation=cv2.INTER_NEAREST)
    return np.asarray(large, np.uint8)
