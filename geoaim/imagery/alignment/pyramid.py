"""A pyramid of grids over the ground that imagery and an AIM share, with the edges on each."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import AlignmentError
from geoaim.geometry import transform_points
from geoaim.grid import Grid, make_north_up_grid
from geoaim.imagery.alignment.result import Prior
from geoaim.imagery.alignment.template_matching import (
    GreyImage,
    WindowShifts,
    compute_orientation,
    find_edges,
    match_windows,
    reduce_to_grey,
    resample_grey,
)
from geoaim.mapping.registration.motion_models import PointMatches

WINDOW_PX = 64  # side of a window
COARSEST_PX = 128  # longer side of the coarsest grid, at most about
MIN_COARSEST_PX = 32  # shorter side of the coarsest grid
FINEST_STEP = 0.8  # pixels of the coarser image for one of the finest grid
MAX_WINDOWS = 300  # on one grid, about


class Level(NamedTuple):
    """A grid of the pyramid.

    Attributes:
        grid: in the world.
        reference: (H, W, 2) orientation channels of the AIM on the grid.
        image: the imagery, smoothed for the grid.
    """

    grid: Grid
    reference: Float32[Array, "H W 2"]
    image: GreyImage

    @property
    def side(self) -> int:
        """Pixels of a window: half as many where few would fit."""
        return WINDOW_PX if min(self.grid.shape) >= 4 * WINDOW_PX else WINDOW_PX // 2

    @property
    def stride(self) -> int:
        """Pixels between windows, so that at most about `MAX_WINDOWS` lie on valid ground."""
        valid = np.count_nonzero(find_edges(self.reference))
        return max(int(np.sqrt(valid / MAX_WINDOWS)), self.side // 4)

    @property
    def overlap(self) -> float:
        """How many windows cover a pixel, at least one."""
        return max((self.side / self.stride) ** 2, 1.0)


def build_pyramid(imagery: AIM, aim: AIM, prior: Prior) -> list[Level]:
    """Build grids over the ground that both may share, from coarse to fine.

    Args:
        imagery: to be aligned.
        aim: that it is aligned to.
        prior: how far off the imagery may be.

    Returns:
        Two levels or more, each with half the resolution of the one before.

    Raises:
        AlignmentError: both share too little ground.
    """
    low = np.maximum(aim.corners.min(axis=0), imagery.corners.min(axis=0) - prior.max_shift)
    high = np.minimum(aim.corners.max(axis=0), imagery.corners.max(axis=0) + prior.max_shift)
    finest = FINEST_STEP * max(imagery.resolution, aim.resolution)
    shorter, longer = np.sort(high - low) / finest
    if shorter < 2 * WINDOW_PX:
        raise AlignmentError(
            f"the imagery lies {_describe_bounds(imagery)}, the AIM {_describe_bounds(aim)}; with "
            f"{prior.max_shift:g} m to search, both must share {2 * WINDOW_PX * finest:.0f} m each "
            "way or more"
        )
    halvings = min(
        np.ceil(np.log2(longer / COARSEST_PX)), np.floor(np.log2(shorter / MIN_COARSEST_PX))
    )
    corners = np.stack([low, high])
    levels = []
    for halving in range(max(int(halvings), 1), -1, -1):
        grid = make_north_up_grid(corners, finest * 2**halving, aim.world)
        grey, valid = resample_grey(reduce_to_grey(aim, grid.resolution), np.eye(3), grid)
        reference = compute_orientation(grey, valid, grid.resolution)
        levels.append(Level(grid, reference, reduce_to_grey(imagery, grid.resolution)))
    return levels


def orient_image(
    image: GreyImage, stated_from_true: Float[Array, "3 3"], grid: Grid
) -> Float32[Array, "H W 2"]:
    """Compute the orientation channels of an image on a grid, as if it had been moved.

    Args:
        image: to be resampled.
        stated_from_true: (3, 3) metres where ground lies to metres where the image places it.
        grid: in the world.

    Returns:
        (H, W, 2) channels.
    """
    return compute_orientation(*resample_grey(image, stated_from_true, grid), grid.resolution)


def search_windows(
    level: Level, stated_from_true: Float[Array, "3 3"], search_px: int
) -> WindowShifts:
    """Find windows of the AIM in the imagery, as if it had been moved.

    Args:
        level: of the pyramid.
        stated_from_true: (3, 3) metres where ground lies to metres where the imagery places it.
        search_px: largest shift in x and in y.

    Returns:
        The shifts of the windows.
    """
    channels = orient_image(level.image, stated_from_true, level.grid)
    sizes = {"side": level.side, "stride": level.stride}
    return match_windows(level.reference, channels, search=search_px, **sizes)


def match_near_windows(
    shifts: WindowShifts, stated_from_true: Float[Array, "3 3"], grid: Grid, max_shift_px: float
) -> PointMatches:
    """Keep windows that were found near their place, as pixels of the AIM and of the imagery.

    Args:
        shifts: of the windows.
        stated_from_true: (3, 3) metres, at which they were searched.
        grid: whose pixels they are.
        max_shift_px: of the windows that are kept.

    Returns:
        From pixels where ground lies to pixels where the imagery places it.
    """
    near = np.linalg.norm(shifts.shifts, axis=1) < max_shift_px
    matrix = grid.grid_from_world @ stated_from_true @ grid.world_from_grid
    source = shifts.centers[near]
    target = transform_points(matrix, source + shifts.shifts[near])
    return PointMatches(source, target, shifts.information[near])


def _describe_bounds(aim: AIM) -> str:
    (left, low), (right, high) = aim.corners.min(axis=0), aim.corners.max(axis=0)
    return f"from ({left:.0f}, {low:.0f}) to ({right:.0f}, {high:.0f}) m"
