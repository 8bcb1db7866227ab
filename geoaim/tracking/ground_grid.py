"""A grid on the ground, in metres: where frames and maps are compared at the world's scale."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.base.geometry import image_corners, to_opencv, transform_points

MIN_RESOLUTION = 0.12  # metres per pixel; finer frames are averaged
MAX_CELLS = 4_000_000  # of the grid; more make it coarser


@dataclass(frozen=True, eq=False)
class GroundGrid:
    """A grid of square cells on the ground, turned as the frames are."""

    grid_from_world: Float[Array, "3 3"]  # metres to cells
    size: tuple[int, int]  # rows and columns
    resolution: float  # metres per cell

    def view(
        self, image: UInt8[Array, "h w *c"], world_from_image: Float[Array, "3 3"]
    ) -> tuple[UInt8[Array, "H W *c"], Bool[Array, "H W"]]:
        """View an image on the grid, averaged where it is finer.

        Args:
            image: grey or RGB.
            world_from_image: transform of its pixels to metres.

        Returns:
            The image on the grid, and which cells it covers but for a rim of two.
        """
        height, width = image.shape[:2]
        fine = measure_resolution(world_from_image, (height, width))
        factor = max(1, int(self.resolution / fine + 0.25))
        if factor > 1:
            small = -(-width // factor), -(-height // factor)
            image = np.asarray(cv2.resize(image, small, interpolation=cv2.INTER_AREA), np.uint8)
            shrink = np.diag([width / small[0], height / small[1], 1.0])
            world_from_image = world_from_image @ shrink
        matrix = to_opencv(self.grid_from_world @ world_from_image)
        size = self.size[::-1]
        seen = cv2.warpPerspective(
            np.ones(image.shape[:2], np.uint8), matrix, size, flags=cv2.INTER_NEAREST
        )
        viewed = cv2.warpPerspective(image, matrix, size, flags=cv2.INTER_LINEAR)
        inner = cv2.erode(seen, np.ones((5, 5), np.uint8), borderValue=0)
        return np.asarray(viewed, np.uint8), np.asarray(inner) > 0


def measure_resolution(matrix: Float[Array, "3 3"], size: tuple[int, int]) -> float:
    """Measure the metres per pixel in the middle of an image of (height, width)."""
    middle = np.array(size[::-1]) / 2
    points = transform_points(matrix, middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    return float(np.sqrt(abs(np.linalg.det(points[1:] - points[0]))))


def make_grid(
    world_from_frame: Float[Array, "T 3 3"], size: tuple[int, int], reference: int
) -> GroundGrid:
    """Make the grid that covers what a frame sees.

    Args:
        world_from_frame: transforms of the frames' pixels to metres.
        size: (height, width) of the frames, pixels.
        reference: number of the frame.

    Returns:
        The grid, as fine as the frames but no finer than `MIN_RESOLUTION`.
    """
    matrix = world_from_frame[reference]
    corners = transform_points(matrix, image_corners(*size))
    right = corners[1] + corners[2] - corners[0] - corners[3]
    right = right / np.hypot(*right)
    down = np.array([right[1], -right[0]])
    if (corners[3] - corners[0]) @ down < 0:
        down = -down
    spans = corners @ np.stack([right, down], axis=1)
    low, extent = spans.min(axis=0), np.ptp(spans, axis=0)
    resolution = max(measure_resolution(matrix, size), MIN_RESOLUTION)
    resolution = max(resolution, float(np.sqrt(extent.prod() / MAX_CELLS)))
    turn = np.eye(3)
    turn[0, :2], turn[1, :2], turn[:2, 2] = right, down, -low
    columns, rows = np.ceil(extent / resolution).astype(int).tolist()
    return GroundGrid(
        np.diag([1 / resolution, 1 / resolution, 1.0]) @ turn, (rows, columns), resolution
    )
