"""Boxes of shadows: dark, beside lighter ones, and all on the side away from the sun."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.detection.network import RESOLUTION, Peaks
from geoaim.mapping.box_evidence import MIN_BOXES

DARK = 0.6  # of the map's brightness: less is a shadow, or a dark vehicle
TOUCHING_M = 0.4  # between the boxes of a shadow and of what casts it, at most
# mean of the unit vectors from lighter boxes to dark ones from which these are shadows, and cosine
# of the angle about it in which they are: 0.08 and 0.17 of two videos without sun, 0.51 and 0.60
# with short shadows, 0.77 and 0.85 with long ones, 0.70 of Kharkiv
MIN_AGREEMENT = 0.5


@dataclass(frozen=True, eq=False)
class DarkBoxes:
    """Dark boxes of one frame that touch lighter ones."""

    row: Int[Array, " n"]  # numbers of the boxes, each as often as it touches one
    direction: Float[Array, "n 2"]  # unit vectors from the lighter ones in the world


def find_dark_boxes(
    peaks: Peaks, is_dark: Bool[Array, " N"], world_from_image: Float[Array, "3 3"]
) -> DarkBoxes:
    """Find which dark boxes of a picture of the network's resolution touch lighter ones."""
    light, dark = np.flatnonzero(~is_dark), np.flatnonzero(is_dark)
    offset = peaks.centres[dark] - peaks.centres[light, None]
    distance = np.hypot(*offset.transpose(2, 0, 1))
    unit = offset / np.maximum(distance, 1e-9)[..., None]
    reach = _measure_reach(peaks.pick(light), unit)
    reach += _measure_reach(peaks.pick(dark), unit.swapaxes(0, 1)).T
    rows, columns = np.nonzero(distance - reach < TOUCHING_M / RESOLUTION)
    direction = unit[rows, columns] @ world_from_image[:2, :2].T
    return DarkBoxes(dark[columns], direction / np.hypot(*direction.T)[:, None])


def find_shadows(frames: Sequence[DarkBoxes]) -> list[Int[Array, "_"]]:
    """Find the shadows among the dark boxes of each frame: none if they lie on all sides."""
    total = np.sum([boxes.direction.sum(axis=0) for boxes in frames], axis=0)
    count = sum(len(boxes.row) for boxes in frames)
    length = float(np.hypot(*total)) if frames else 0.0
    if count < MIN_BOXES or length < MIN_AGREEMENT * count:
        return [np.empty(0, int) for _ in frames]
    away = total / length
    return [np.unique(b.row[b.direction @ away > MIN_AGREEMENT]) for b in frames]


def _measure_reach(peaks: Peaks, unit: Float[Array, "N m 2"]) -> Float[Array, "N m"]:
    """Measure how far boxes reach from their middles in some directions, pixels."""
    along = np.stack([np.cos(peaks.headings), np.sin(peaks.headings)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    parts = [np.abs((unit * axis[:, None]).sum(axis=2)) for axis in (along, across)]
    return (parts[0] * peaks.lengths[:, None] + parts[1] * peaks.widths[:, None]) / 2
