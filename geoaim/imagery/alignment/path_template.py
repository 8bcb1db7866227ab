"""Templates of vehicle paths: the edges and surfaces that imagery should show under them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from geoaim.agent_types import AGENT_GROUPS
from geoaim.geometry import make_similarity, transform_points
from geoaim.grid import Grid
from geoaim.tracks import Tracks

VEHICLE_TYPES = (*AGENT_GROUPS["vehicle"], "motorcycle")
MIN_SPEED_M_S = 1.0  # the heading of a standing vehicle says nothing of the road
CELL_SIZE = (1.0, 1.0, np.pi / 8)  # m, m and rad: poses within one cell count once
HALF_LANE_M = 1.65  # from a path to the lane's markings
MARKING_SIGMA_M = 0.45  # of that distance
CENTER_SIGMA_M = 0.55  # around a path, where no edges are
HALF_BODY_M = 1.0  # to each side of a path that is driven over
TEMPLATE_REACH_M = 6.0  # to each side of a path


class PathTemplate(NamedTuple):
    """What the paths of vehicles expect of imagery.

    Attributes:
        channels: (H, W, 4) wanted orientation (2 channels), unwanted edge strength, and how often
            a pixel is driven over.
        top: row of the grid at which the template begins.
        left: column of the grid at which it begins.
    """

    channels: Float32[Array, "h w 4"]
    top: int
    left: int


def sample_poses(tracks: Tracks) -> Float[Array, "M 3"]:
    """Poses x, y, heading of moving vehicles, one for each cell of place and heading."""
    vehicles = np.array([agent_type in VEHICLE_TYPES for agent_type in tracks.types])
    moving = tracks.present & vehicles[:, None]
    moving[moving] = np.abs(tracks.states[moving][:, 3]) > MIN_SPEED_M_S
    poses = tracks.states[moving][:, :3]
    cells = np.floor(poses / CELL_SIZE)
    return poses[np.unique(cells, axis=0, return_index=True)[1]]


def rotate_poses(
    poses: Float[Array, "M 3"], center: Float[Array, "2"], angle: float
) -> Float[Array, "M 3"]:
    """Rotate poses by an angle in radians about a point.

    Args:
        poses: (M, 3) x, y, heading.
        center: (2,) metres.
        angle: radians, counter-clockwise.

    Returns:
        The rotated poses.
    """
    places = transform_points(make_similarity(center, angle, 1.0), poses[:, :2])
    return np.column_stack([places, poses[:, 2] + angle])


def draw_template(poses: Float[Array, "M 3"], grid: Grid) -> PathTemplate:
    """Draw what paths expect: edges along both sides of a lane, none in its middle.

    Args:
        poses: (M, 3) x, y, heading along the paths, metres and radians.
        grid: on which the template is drawn; the paths lie within it.

    Returns:
        The template, cut to the paths.
    """
    sides = np.arange(-TEMPLATE_REACH_M, TEMPLATE_REACH_M + 0.01, grid.resolution)
    x, y, heading = poses.T[:, :, None]
    places = np.stack([x - sides * np.sin(heading), y + sides * np.cos(heading)], axis=-1)
    pixels = transform_points(grid.grid_from_world, places.reshape(-1, 2))
    left, top = (int(n) - 1 for n in np.floor(pixels.min(axis=0)))
    right, bottom = (int(n) + 1 for n in np.ceil(pixels.max(axis=0)))
    marking = np.exp(-(((np.abs(sides) - HALF_LANE_M) / MARKING_SIGMA_M) ** 2) / 2)
    doubled = -2 * heading - np.pi  # of an edge along the path, v down
    shape = len(poses), len(sides)
    wanted = [
        np.cos(doubled) * marking,
        np.sin(doubled) * marking,
        np.broadcast_to(-np.exp(-((sides / CENTER_SIGMA_M) ** 2) / 2), shape),
        np.broadcast_to(np.abs(sides) <= HALF_BODY_M, shape),
    ]
    values = np.stack(wanted, axis=-1).reshape(-1, 4)
    channels = _splat(pixels - (left, top), values, (bottom - top, right - left))
    return PathTemplate(channels, top, left)


def _splat(
    pixels: Float[Array, "n 2"], values: Float[Array, "n c"], size: tuple[int, int]
) -> Float32[Array, "h w c"]:
    """Sums of values at points, each shared by the four pixels around it (bilinear splatting)."""
    corner = np.floor(pixels - 0.5).astype(int)
    right, down = (pixels - 0.5 - corner).T
    total = np.zeros((size[0] * size[1], values.shape[1]))
    for row, column, share in (
        (0, 0, (1 - down) * (1 - right)),
        (0, 1, (1 - down) * right),
        (1, 0, down * (1 - right)),
        (1, 1, down * right),
    ):
        flat = (corner[:, 1] + row) * size[1] + corner[:, 0] + column
        for channel, value in enumerate(values.T):
            total[:, channel] += np.bincount(flat, share * value, len(total))
    return total.reshape(*size, -1).astype(np.float32)
