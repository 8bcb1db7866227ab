"""Grid: the pixels of a raster on a plane; its shape and its map from pixels to metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import AimError
from geoaim.base.geometry import image_corners, transform_points, translation
from geoaim.base.world import World, crs_from_world

MAX_SIDE_PX = 30_000  # OpenCV addresses 32767, and a larger map is a wrong resolution
EDGE_TOLERANCE_PX = 1e-6  # an outline that ends on a grid line adds no row or column


@dataclass(frozen=True, eq=False)
class Grid:
    """The pixels of a raster on a plane: its size, and its transform from pixels to coordinates."""

    shape: tuple[int, int]  # (height, width) in pixels
    world_from_grid: Float[Array, "3 3"]  # pixels (corner origin, u right, v down) to coordinates
    world: World | None = None  # the plane of the coordinates; None where the grid's owner names it

    @property
    def height(self) -> int:
        """Rows of pixels."""
        return self.shape[0]

    @property
    def width(self) -> int:
        """Columns of pixels."""
        return self.shape[1]

    @property
    def grid_from_world(self) -> Float[Array, "3 3"]:
        """Coordinates to pixels."""
        return np.linalg.inv(self.world_from_grid)

    @property
    def crs_from_grid(self) -> Float[Array, "3 3"]:
        """Pixels to coordinates of the world's CRS."""
        origin = (0.0, 0.0) if self.world is None else self.world.origin
        return translation(*origin) @ self.world_from_grid

    @property
    def corners(self) -> Float[Array, "4 2"]:
        """Coordinates of the corners: top-left, top-right, bottom-right, bottom-left."""
        return transform_points(self.world_from_grid, image_corners(*self.shape))

    @property
    def resolution(self) -> float:
        """Metres per pixel in the middle of the grid: the square root of a pixel's area."""
        matrix = self.world_from_grid
        *point, scale = matrix @ [self.width / 2, self.height / 2, 1.0]
        jacobian = (matrix[:2, :2] - np.outer(np.divide(point, scale), matrix[2, :2])) / scale
        return float(np.sqrt(abs(np.linalg.det(jacobian))))


def make_north_up_grid(
    points: Float[Array, "n 2"], resolution: float, world: World | None = None
) -> Grid:
    """Make the smallest north-up grid over points, with lines at multiples of its resolution.

    Raises:
        AimError: the grid would have more than 30,000 pixels a side.
        ValueError: the resolution is not positive.
    """
    if not (np.isfinite(resolution) and resolution > 0):
        raise ValueError(f"resolution must be a positive number of metres, found {resolution}")
    low = np.floor(points.min(axis=0) / resolution + EDGE_TOLERANCE_PX)
    high = np.ceil(points.max(axis=0) / resolution - EDGE_TOLERANCE_PX)
    width, height = (int(n) for n in high - low)
    if max(height, width) > MAX_SIDE_PX:
        least = float(f"{1.1 * resolution * max(height, width) / MAX_SIDE_PX:.1g}")
        raise AimError(
            f"at {resolution:g} m a pixel the map has {height} x {width} pixels (height x width), "
            f"and at most {MAX_SIDE_PX} a side can be made: use a resolution of {least:g} m or "
            "more, or control points that keep far corners of the image near"
        )
    left, top = low[0] * resolution, high[1] * resolution
    matrix = np.array([[resolution, 0.0, left], [0.0, -resolution, top], [0.0, 0.0, 1.0]])
    return Grid((height, width), matrix, world)


def pad_grid(grid: Grid, pixels: int) -> Grid:
    """Extend a grid by a number of pixels on every side."""
    shape = grid.height + 2 * pixels, grid.width + 2 * pixels
    return Grid(shape, grid.world_from_grid @ translation(-pixels, -pixels), grid.world)


def fit_affine(grid: Grid, world: World, crs: str) -> tuple[Float[Array, "3 3"], float]:
    """Fit an affine map from the pixels of a grid in a world to a CRS.

    Returns:
        (3, 3) least-squares fit at 5 x 5 places of the grid, and its largest error there in pixels.
    """
    shares = np.stack(np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)), axis=-1)
    pixels = shares.reshape(-1, 2) * grid.shape[::-1]
    points = crs_from_world(world, transform_points(grid.world_from_grid, pixels), crs)
    mean = points.mean(axis=0)  # subtracted: degrees and millions of metres are ill-conditioned
    rows = np.column_stack([pixels, np.ones(len(pixels))])
    fit = np.linalg.lstsq(rows, points - mean, rcond=None)[0]
    errors = np.linalg.solve(fit[:2].T, (points - mean - rows @ fit).T)
    matrix = np.vstack([fit.T, [0.0, 0.0, 1.0]])
    matrix[:2, 2] += mean
    return matrix, float(np.abs(errors).max())
