"""A pyramid of grids over the ground that imagery and an AIM share, with the edges on each."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.errors import AlignmentError
from geoaim.base.grid import Grid, make_north_up_grid
from geoaim.imagery.alignment.prior import Prior
from geoaim.imagery.alignment.template_matching import (
    GreyImage,
    compute_orientation,
    find_edges,
    reduce_to_grey,
    resample_grey,
)

WINDOW_PX = 64  # side of a window
COARSEST_PX = 128  # longer side of the coarsest grid, at most about
MIN_COARSEST_PX = 32  # shorter side of the coarsest grid
FINEST_STEP = 0.8  # pixels of the coarser image for one of the finest grid
MAX_WINDOWS = 300  # approximate number of windows on one grid


class Level(NamedTuple):
    """A grid of the pyramid."""

    grid: Grid  # the grid in the world
    reference: Float32[Array, "H W 2"]  # orientation channels of the AIM on the grid
    image: GreyImage  # the imagery, smoothed for the grid

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
    """Build grids over the ground that both may share, from coarse to fine."""
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


def _describe_bounds(aim: AIM) -> str:
    (left, low), (right, high) = aim.corners.min(axis=0), aim.corners.max(axis=0)
    return f"from ({left:.0f}, {low:.0f}) to ({right:.0f}, {high:.0f}) m"
