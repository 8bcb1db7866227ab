"""Blocks of an image, each so small that an affine map leads from it to the CRS of any source."""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.geometry import transform_points, translation
from geoaim.grid import Grid
from geoaim.world import World, crs_from_world

BLOCK_PX = 1024  # side of the blocks to begin with
MIN_BLOCK_PX = 16  # side below which blocks are not divided
MAX_AFFINE_ERROR_PX = 0.005  # of the affine map from a block to a CRS


def split_into_blocks(
    grid: Grid, world: World, crses: Iterable[str]
) -> Iterator[tuple[tuple[slice, slice], dict[str, Float[Array, "3 3"]]]]:
    """Divide an image into blocks from which affine maps lead to every CRS.

    Args:
        grid: of the image.
        world: plane of the grid.
        crses: of the sources.

    Yields:
        Rows and columns of a block, and crs_from_block for each CRS.
    """
    tops, lefts = range(0, grid.height, BLOCK_PX), range(0, grid.width, BLOCK_PX)
    waiting = [(top, left, BLOCK_PX) for top in reversed(tops) for left in reversed(lefts)]
    while waiting:
        top, left, side = waiting.pop()
        if top >= grid.height or left >= grid.width:
            continue
        rows, columns = (
            slice(top, min(top + side, grid.height)),
            slice(left, min(left + side, grid.width)),
        )
        shape = rows.stop - top, columns.stop - left
        block = Grid(shape, grid.world_from_grid @ translation(left, top), world)
        fits = {crs: _fit_affine(block, world, crs) for crs in crses}
        if side > MIN_BLOCK_PX and max(error for _, error in fits.values()) > MAX_AFFINE_ERROR_PX:
            half = side // 2
            waiting += [(top + i, left + j, half) for i in (half, 0) for j in (half, 0)]
        else:
            rows, columns = slice(top, top + shape[0]), slice(left, left + shape[1])
            yield (rows, columns), {crs: matrix for crs, (matrix, _) in fits.items()}


def _fit_affine(block: Grid, world: World, crs: str) -> tuple[Float[Array, "3 3"], float]:
    """The least-squares affine map from a block's pixels to a CRS, and its largest error in px."""
    shares = np.stack(np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)), axis=-1)
    pixels = shares.reshape(-1, 2) * block.shape[::-1]
    points = crs_from_world(world, transform_points(block.world_from_grid, pixels), crs)
    mean = points.mean(axis=0)  # subtracted: degrees and millions of metres are ill-conditioned
    rows = np.column_stack([pixels, np.ones(len(pixels))])
    fit = np.linalg.lstsq(rows, points - mean, rcond=None)[0]
    errors = np.linalg.solve(fit[:2].T, (points - mean - rows @ fit).T)
    matrix = np.vstack([fit.T, [0.0, 0.0, 1.0]])
    matrix[:2, 2] += mean
    return matrix, float(np.abs(errors).max())
