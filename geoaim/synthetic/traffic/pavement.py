"""The ground where pedestrians may walk, as a distance map."""

from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.synthetic.roads.plan import Roads

CELL_M = 0.25
MARGIN_M = 12.0  # around the drawn extent
MIN_SLOPE = 1e-6  # of the distance, so that its direction is defined


@dataclass(frozen=True)
class PavementMap:
    """Distances to the edge of the pavement on a grid over the plan, whose rows run upwards.

    Attributes:
        table: (H, W, 3) metres to the nearest edge, 0 off the pavement; and the unit vector
            away from that edge.
        corner: plan coordinates of the first cell's outer corner.
    """

    table: Float[Array, "H W 3"]
    corner: Float[Array, "2"]


def make_pavement_map(roads: Roads) -> PavementMap:
    """Rasterise the pavements, footpaths and driveway of a place."""
    paving = roads.paving
    walkable = shapely.union_all([paving.pavement, paving.drive, roads.footpaths.surface])
    left, bottom, right, top = roads.extent.buffer(MARGIN_M).bounds
    corner = np.array([left, bottom])
    mask = np.zeros((round((top - bottom) / CELL_M), round((right - left) / CELL_M)), np.uint8)
    for part in shapely.get_parts(walkable):
        rings = [np.array(ring.coords) for ring in (part.exterior, *part.interiors)]
        cells = [np.rint((ring - corner) / CELL_M - 0.5).astype(np.int32) for ring in rings]
        cv2.fillPoly(mask, cells, 1)
    distance = CELL_M * cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    distance = np.round(distance.astype(np.float64), 6)
    smooth = np.round(cv2.GaussianBlur(distance, (0, 0), 1.0), 4)
    slope_y, slope_x = np.gradient(smooth)
    slope = np.sqrt(slope_y**2 + slope_x**2).clip(MIN_SLOPE)
    table = np.stack([distance, slope_x / slope, slope_y / slope], axis=-1)
    return PavementMap(np.round(table, 4), corner)


def sample_pavement(
    pavement: PavementMap, positions: Float[Array, "n 2"]
) -> tuple[Float[Array, "n"], Float[Array, "n 2"]]:
    """Metres to the nearest edge at each position, and the unit vector away from that edge."""
    cells = ((positions - pavement.corner) / CELL_M).astype(np.int64)
    height, width = pavement.table.shape[:2]
    column = np.minimum(np.maximum(cells[:, 0], 0), width - 1)
    row = np.minimum(np.maximum(cells[:, 1], 0), height - 1)
    values = pavement.table[row, column]
    return values[:, 0], values[:, 1:]
