"""Signed distance to the edge of a drivable area, on a grid."""

import cv2
import numpy as np
from affine import Affine
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array
from rasterio.features import rasterize
from shapely import MultiPolygon

from geoaim.base.errors import MapError, warn
from geoaim.base.grid import Grid, make_north_up_grid

SUPERSAMPLING = 4  # cells of the mask in one of the distance, each way
MARGIN_M = 20.0  # distance from the area to the edges of the grid
MAX_CELLS = 9_000_000  # about a gigabyte of memory during the computation


def compute_signed_distance(
    area: MultiPolygon, *, resolution: float
) -> tuple[Float32[Array, "H W"], Grid]:
    """Compute the distance to the edge of an area, on a grid of `resolution` metres per cell.

    Distances are measured to the nearest cell of a mask `SUPERSAMPLING` times as fine, less half
    such a cell. For more than `MAX_CELLS`, cells are made coarser, with a warning.

    Returns:
        (H, W) metres at the centres of cells, positive outside the area and negative inside; and
        the north-up grid, which reaches `MARGIN_M` beyond the area.

    Raises:
        MapError: the area is empty, or too narrow for a cell of the mask.
    """
    if area.is_empty:
        raise MapError("the area is empty; polygons are needed")
    low, high = np.array(area.bounds).reshape(2, 2)
    resolution = _limit_resolution(high - low + 2 * MARGIN_M, resolution)
    grid = make_north_up_grid(np.stack([low - MARGIN_M, high + MARGIN_M]), resolution)
    cell = resolution / SUPERSAMPLING
    transform = Affine(*grid.world_from_grid[:2].ravel()) * Affine.scale(1 / SUPERSAMPLING)
    shape = grid.height * SUPERSAMPLING, grid.width * SUPERSAMPLING
    mask = rasterize([area], shape, transform=transform, dtype=np.uint8)
    if not mask.any():
        raise MapError(f"the area is narrower than {cell:g} m; draw it wider, or take finer cells")
    outside, inside = (_measure_distance(part, grid) for part in (1 - mask, mask))
    return (outside - inside) * np.float32(cell), grid


def _limit_resolution(size: Float[Array, "2"], resolution: float) -> float:
    """The resolution, or a coarser one at which the size has at most `MAX_CELLS`."""
    finest = float(np.sqrt(size.prod() / MAX_CELLS))
    if not 0 < resolution < finest:
        return resolution
    warn(
        f"{size[0]:.0f} x {size[1]:.0f} m are too large for distances every {resolution:g} m; "
        f"they are computed every {finest:.2g} m. Cut the area to what the tracks need"
    )
    return finest


def _measure_distance(mask: UInt8[Array, "h w"], grid: Grid) -> Float32[Array, "H W"]:
    """Cells of the mask to its edge, 0 beyond it, averaged over the cells of the grid."""
    distance = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    np.subtract(distance, 0.5, out=distance, where=mask > 0)
    coarse = cv2.resize(distance, grid.shape[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(coarse, np.float32)
