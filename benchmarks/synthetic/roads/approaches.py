"""Approaches: the roads that meet in a place, each with road coordinates s and t.

The plan has its origin in the centre of the place, x right and y up as drawn, in metres. As in
OpenDRIVE, s runs along a road's reference line, here outwards from the centre, and t to its left.
Traffic drives on the right: inbound lanes lie at larger t than outbound lanes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.synthetic.roads.curves import Polyline, make_unit_vector, rotate_90
from geoaim.base.geometry import wrap_angle

GUTTER_M = 0.45  # width between the edge of the outer lane and the kerb


@dataclass(frozen=True)
class Approach:
    """A road from the centre outwards."""

    name: str  # "east", "north", ...
    angle: float  # its direction at the centre, radians
    curvature: float  # curvature of the reference line, 1/m, positive to the left
    # the turns that each inbound lane serves, from the inner lane outwards: letters of "LSR"
    # for left, straight on, right
    turns: tuple[str, ...]
    outbound_lanes: int  # their number
    lane_width: float = 3.3  # metres
    median: float = 0.0  # width of the median between the two directions, metres
    mouth: float = 0.0  # s where lanes end and the lanes through the junction begin
    crossing: float = np.nan  # s of the crossing's nearer edge; NaN: there is none
    stop: float = np.nan  # s of the stop or give-way line; NaN: there is none
    speed_limit: float = 13.9  # m/s

    @property
    def divider(self) -> float:
        """The t of the line between the two directions (the middle of the median)."""
        return 0.5 * self.lane_width * (self.outbound_lanes - len(self.turns))

    @property
    def half_width(self) -> float:
        """Metres from the reference line to either kerb."""
        lanes = self.outbound_lanes + len(self.turns)
        return 0.5 * (self.lane_width * lanes + self.median) + GUTTER_M


def plan_from_road(approach: Approach, points: Float[Array, "m 2"]) -> Polyline:
    """Convert road coordinates (s, t) of an approach to plan coordinates, all in metres."""
    s, t = np.asarray(points, np.float64).T
    forward = make_unit_vector(approach.angle)
    left = rotate_90(forward)
    axis = s[:, None] * forward + 0.5 * approach.curvature * s[:, None] ** 2 * left
    tangent = forward + approach.curvature * s[:, None] * left
    tangent = tangent / np.sqrt((tangent**2).sum(axis=1, keepdims=True))
    return axis + t[:, None] * rotate_90(tangent)


def outline_strip(approach: Approach, s: tuple[float, float], t: tuple[float, float]) -> Polyline:
    """Outline a rectangle in road coordinates, which bends with the road.

    Args:
        approach: the road.
        s: (2,) ends of the rectangle along the road, metres from the place's centre.
        t: (2,) ends of the rectangle across the road, metres to the left of the reference line.

    Returns:
        (m, 2) points of the outline in plan coordinates, metres, about 2 m apart along the sides;
        the first is not repeated.
    """
    count = max(2, int(abs(s[1] - s[0]) / 2) + 2)
    along = np.linspace(*s, count)
    outline = np.stack([np.append(along, along[::-1]), np.repeat(t, count)], axis=1)
    return plan_from_road(approach, outline)


def locate_inbound_lane(approach: Approach, index: int) -> float:
    """Locate the centreline of an inbound lane: metres to the left of the reference line.

    Lanes count from the divider.
    """
    return approach.divider + approach.median / 2 + (index + 0.5) * approach.lane_width


def locate_outbound_lane(approach: Approach, index: int) -> float:
    """Locate the centreline of an outbound lane: metres to the left of the reference line.

    Lanes count from the divider.
    """
    return approach.divider - approach.median / 2 - (index + 0.5) * approach.lane_width


def classify_turn(origin: Approach, destination: Approach) -> str:
    """Classify the way from one approach into another: "L" left, "S" straight on, "R" right."""
    change = wrap_angle(np.asarray(destination.angle - origin.angle - np.pi))
    return "S" if abs(change) < np.pi / 4 else "L" if change > 0 else "R"
