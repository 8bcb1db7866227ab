"""Headings of vehicles that do not move: by the lane that they stand in, or by their boxes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.geometry import wrap_angle
from geoaim.tracking.sizes import TURNS, predict_extents

UNKNOWN_SIGMA_RAD = np.pi  # of a heading that may be any
LINE_SIGMA_RAD = np.pi / 2  # of one that may be the opposite
LANE_SIGMA_RAD = 0.1  # of a heading by a lane
MAX_NEIGHBOURS = 9  # directions that are averaged
MIN_AGREEMENT = 0.8  # length of the mean of their unit vectors; short where lanes cross
MAX_WIDER = 1.2  # of a box than its agent, along which the agent stands; a turned one is wider


@dataclass(frozen=True, eq=False)
class Directions:
    """Places where the direction of travel is known."""

    points: Float[Array, "m 2"]  # m
    headings: Float[Array, "m"]  # rad
    reach: Float[Array, "m"]  # radius about each point in which its direction holds, m


def find_standing_heading(
    position: Float[Array, "2"],
    axis: float,
    extent: Float[Array, "2"],
    size: tuple[float, float],
    lanes: Directions | None,
) -> tuple[float, float]:
    """Find the heading of a vehicle that stands all the time, and its standard deviation, rad.

    Its boxes have an axis (rad) and sides, its type a size (m). Without a lane at its place the
    heading is that of the box's longer axis, which may as well be the opposite: `LINE_SIGMA_RAD`. A
    box that is too wide for that is turned to either side: `UNKNOWN_SIGMA_RAD`.
    """
    here = None if lanes is None else _average_directions(lanes, position)
    if here is not None:
        return here, LANE_SIGMA_RAD
    misfit = ((predict_extents(np.array(size), TURNS) - extent) ** 2).sum(axis=1)
    heading = float(wrap_angle(np.array(axis + TURNS[np.argmin(misfit)])))
    straight = extent.min() < MAX_WIDER * size[1] and extent.max() > 2 * extent.min()
    return heading, LINE_SIGMA_RAD if straight else UNKNOWN_SIGMA_RAD


def _average_directions(lanes: Directions, position: Float[Array, "2"]) -> float | None:
    """Average the directions of lanes at a place, rad; None where none is, or they differ."""
    distance = np.hypot(*(lanes.points - position).T)
    near = np.flatnonzero(distance < lanes.reach)
    if not len(near):
        return None
    nearest = near[np.argsort(distance[near])[:MAX_NEIGHBOURS]]
    mean = np.exp(1j * lanes.headings[nearest]).mean()
    return float(np.angle(mean)) if np.abs(mean) > MIN_AGREEMENT else None
