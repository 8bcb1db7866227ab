"""Headings of vehicles that do not move: by the lane that they stand in, or by their boxes."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.base.geometry import wrap_angle
from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.headings import MIN_FORWARD_M
from geoaim.tracking.sizes import TURNS, get_typical_size, predict_extents

UNKNOWN_SIGMA_RAD = np.pi  # of a heading that may be any
LINE_SIGMA_RAD = np.pi / 2  # of one that may be the opposite
LANE_SIGMA_RAD = 0.1  # of a heading by a lane
ORIENTED_SIGMA_RAD = 0.05  # of the line of an oriented box
MAX_NEIGHBOURS = 9  # directions that are averaged
MIN_AGREEMENT = 0.8  # length of the mean of their unit vectors; short where lanes cross
MAX_WIDER = 1.2  # of a box than its agent, along which the agent stands; a turned one is wider


@dataclass(frozen=True, eq=False)
class Directions:
    """Places where the direction of travel is known."""

    points: Float[Array, "m 2"]  # m
    headings: Float[Array, "m"]  # rad
    reach: Float[Array, "m"]  # radius about each point in which its direction holds, m


class Standing(NamedTuple):
    """How a vehicle stands."""

    heading: float  # rad
    sigma: float  # standard deviation, rad; `LINE_SIGMA_RAD` of one that may be the opposite
    vote: float = 0.0  # by the first sides of its boxes: 1 if all point there, -1 if none does

    def face(self, forward: Float[Array, "n"]) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
        """Give heading and deviation, where first sides are fronts with a probability `forward`.

        With a probability p of the opposite, a heading deviates by π √p.
        """
        vote = (2 * forward - 1) * self.vote
        sigma = np.hypot(ORIENTED_SIGMA_RAD, np.pi * np.sqrt((1 - np.abs(vote)) / 2))
        heading = np.where(vote < 0, self.heading + np.pi, self.heading)
        known = sigma if self.vote else np.full_like(vote, self.sigma)
        return wrap_angle(heading), np.minimum(known, self.sigma)


def learn_forward(
    detections: GroundDetections, track: Int[Array, "M"], steps: int
) -> Float[Array, "T"]:
    """Learn from what moved until each step how probably first sides of boxes point forward.

    Detectors that give no sense are right in half of the cases, and what stands then has none.
    """
    right, total = np.zeros((2, steps))
    member = np.flatnonzero((track >= 0) & detections.oriented)
    order = member[np.argsort(track[member], kind="stable")]
    for part in np.split(order, np.flatnonzero(np.diff(track[order])) + 1):
        way = detections.position[part] - detections.position[part[:1]]
        far = np.flatnonzero(np.hypot(*way.T) > MIN_FORWARD_M)[:1]
        for end in far.tolist():
            ahead = np.arctan2(way[end, 1], way[end, 0])
            vote = np.sign(np.cos(detections.axis[part[: end + 1]] - ahead)).mean()
            right[detections.step[part[end]]] += max(vote, 0)
            total[detections.step[part[end]]] += abs(vote)
    # as if one agent more had been right, and one wrong (Laplace's rule)
    return (1 + right.cumsum()) / (2 + total.cumsum())


def find_standing(
    detections: GroundDetections, seen: Int[Array, " m"], kind: str, lanes: Directions | None
) -> Standing:
    """Find how a vehicle of a kind stands, by its detections.

    As `find_standing_heading`, but for oriented boxes, which tell its line, and perhaps its sense.
    """
    middle = np.median(detections.position[seen], axis=0)
    extent = np.median(detections.extent[seen], axis=0)
    axis = float(np.angle(np.exp(2j * detections.axis[seen]).mean()) / 2)
    heading, sigma = find_standing_heading(middle, axis, extent, get_typical_size(kind), lanes)
    if not detections.oriented[seen].all():
        return Standing(heading, sigma)
    if sigma < LINE_SIGMA_RAD:
        return Standing(axis + np.pi * (np.cos(heading - axis) < 0), ORIENTED_SIGMA_RAD)
    vote = float(np.sign(np.cos(detections.axis[seen] - axis)).mean())
    return Standing(axis, LINE_SIGMA_RAD, vote)


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
