"""Resample an AIM to a north-up grid of square pixels."""

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.position import keep_place
from geoaim.base.errors import AimError
from geoaim.base.geometry import to_opencv, transform_points, translation
from geoaim.base.grid import Grid, make_north_up_grid
from geoaim.base.world import World, change_world

BLOCK_PX = 1024  # side of the blocks that are resampled at a time
SAMPLES_PER_SIDE = 33  # pixel sizes are measured at so many places along each side of the image
MAX_WORLD_ERROR_PX = 0.1  # of taking the map between two worlds as affine


def rectify(aim: AIM, resolution: float | None = None) -> AIM:
    """Resample an AIM to a north-up grid whose lines lie on whole multiples of its resolution.

        aim = geoaim.rectify(geoaim.read_aim("aim.tif"), resolution=0.1)

    Colours are interpolated bicubically, and averaged where the grid is coarser than the image;
    coverage and contested are those of the nearest pixel. Outside the image the coverage is 0.

    Args:
        aim: the AIM to resample.
        resolution: metres per pixel; None for the median ground size of a pixel, to two digits.

    Returns:
        The resampled AIM, in the same world.

    Raises:
        AimError: the grid would have more than 30,000 pixels per side.
        ValueError: the resolution is not positive.
    """
    sides = _measure_pixels(aim)
    if resolution is None:
        resolution = float(f"{np.median(np.sqrt(sides.prod(axis=1))):.2g}")
    return resample(aim, make_north_up_grid(aim.corners, resolution, aim.world))


def resample(aim: AIM, grid: Grid) -> AIM:
    """Resample an AIM to a grid in the same world, as `rectify` does."""
    image_from_grid = aim.grid.grid_from_world @ grid.world_from_grid
    oversampling = int(np.clip(round(grid.resolution / _measure_pixels(aim).min()), 1, BLOCK_PX))
    coverage = sample_nearest(aim.coverage, image_from_grid, grid.shape)
    contested = sample_nearest(aim.contested.astype(np.uint8), image_from_grid, grid.shape)
    image = _resample_colours(aim, image_from_grid, grid.shape, oversampling)
    image[coverage == 0] = 0
    return replace(
        aim,
        image=image,
        world_from_image=grid.world_from_grid,
        coverage=coverage,
        contested=contested > 0,
        report=keep_place(aim.report, grid),
    )


def change_aim_world(aim: AIM, world: World) -> AIM:
    """Express where an AIM lies in another world; its pixels stay as they are.

    The map between the two worlds is taken as affine over the image, which is right to millimetres
    over a kilometre.

    Raises:
        AimError: it is not affine to a tenth of a pixel over this image.
    """
    if aim.world == world:
        return aim
    low, high = aim.corners.min(axis=0), aim.corners.max(axis=0)
    shares = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)), axis=-1)
    points = low + (high - low) * shares.reshape(-1, 2)
    targets = change_world(aim.world, world, points)
    middle = points.mean(axis=0)
    design = np.column_stack([points - middle, np.ones(len(points))])
    solution = np.linalg.lstsq(design, targets)[0]
    error = float(np.abs(design @ solution - targets).max())
    if error > MAX_WORLD_ERROR_PX * aim.resolution:
        raise AimError(
            f"the map is {high[0] - low[0]:.0f} m wide, too large to be expressed in {world.crs} "
            f"instead of {aim.world.crs} as it is: {error:.2f} m would be wrong; give a smaller one"
        )
    affine = np.vstack([solution.T, [0.0, 0.0, 1.0]]) @ translation(*-middle)
    moved = Grid(aim.coverage.shape, affine @ aim.world_from_image, world)
    report = keep_place(aim.report, moved)
    return replace(aim, world_from_image=moved.world_from_grid, world=world, report=report)


def _measure_pixels(aim: AIM) -> Float[Array, "m 2"]:
    """Measure ground lengths (m) of pixel widths and heights at points all over the image."""
    height, width = aim.coverage.shape
    across = np.linspace(0.5, width - 0.5, SAMPLES_PER_SIDE)
    down = np.linspace(0.5, height - 0.5, SAMPLES_PER_SIDE)
    points = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    steps = [
        transform_points(aim.world_from_image, points + half)
        - transform_points(aim.world_from_image, points - half)
        for half in ([0.5, 0.0], [0.0, 0.5])
    ]
    return np.linalg.norm(steps, axis=-1).T


def sample_nearest(
    raster: Array, image_from_grid: Float[Array, "3 3"], shape: tuple[int, int]
) -> Array:
    """Sample the nearest pixels of a raster (uint8, uint16 or float) on a grid; 0 outside."""
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(raster, to_opencv(image_from_grid), shape[::-1], flags=flags)


def _resample_colours(
    aim: AIM, image_from_grid: Float[Array, "3 3"], shape: tuple[int, int], oversampling: int
) -> UInt8[Array, "H W 3"]:
    """Resample premultiplied colours, so that uncovered pixels do not bleed in."""
    source = np.empty((*aim.coverage.shape, 4), np.float32)  # floats, as bicubic sums overshoot
    source[..., 3] = aim.coverage > 0
    np.multiply(aim.image, source[..., 3:], out=source[..., :3])
    height, width = shape
    image = np.empty((height, width, 3), np.uint8)
    size = BLOCK_PX // oversampling
    for top, left in product(range(0, height, size), range(0, width, size)):
        rows, columns = min(size, height - top), min(size, width - left)
        scale = 1.0 / oversampling
        grid_from_block = np.array([[scale, 0.0, left], [0.0, scale, top], [0.0, 0.0, 1.0]])
        fine = cv2.warpPerspective(
            source,
            to_opencv(image_from_grid @ grid_from_block),
            (columns * oversampling, rows * oversampling),
            flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        )
        block = cv2.resize(fine, (columns, rows), interpolation=cv2.INTER_AREA)
        # a pixel of lower alpha has no colour of its own
        colours = block[..., :3] / np.maximum(block[..., 3:], 0.01)
        image[top : top + rows, left : left + columns] = np.clip(np.rint(colours), 0, 255)
    return image
