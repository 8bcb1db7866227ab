"""Arms: the roads that meet in a place, each with coordinates along and across it.

The plan has its origin in the middle of the place, x right and y up as drawn, in metres. `along`
runs outwards from the middle, `across` to the left of somebody who looks outwards. Traffic keeps
to the right: lanes towards the middle lie at larger `across` than those away from it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.geometry import wrap_angle
from geoaim.synthetic.roads.curves import Line, left_of, unit

GUTTER = 0.45  # m between the outer lane's edge and the kerb


@dataclass(frozen=True)
class Arm:
    """One road, from the middle outwards.

    Attributes:
        name: "east", "north", ...
        angle: its direction in the middle, radians.
        bend: its curvature, 1/m, positive to the left of somebody who looks outwards.
        turns: for each lane towards the middle, from the middle line out, the turns that it
            serves: letters of "LSR" for left, straight on, right.
        lanes_out: number of lanes away from the middle.
        lane: width of a lane, metres.
        median: width between the two directions, metres.
        mouth: metres from the middle to where lanes begin to turn.
        crossing: metres from the middle to the near edge of the crossing; NaN: there is none.
        stop: metres from the middle to the stop or give-way line; NaN: there is none.
        speed: limit, m/s.
    """

    name: str
    angle: float
    bend: float
    turns: tuple[str, ...]
    lanes_out: int
    lane: float = 3.3
    median: float = 0.0
    mouth: float = 0.0
    crossing: float = np.nan
    stop: float = np.nan
    speed: float = 13.9


def on_arm(arm: Arm, points: Float[Array, "m 2"]) -> Line:
    """Plan coordinates of points given along and across an arm."""
    along, across = np.asarray(points, np.float64).T
    ahead, left = unit(arm.angle), left_of(unit(arm.angle))
    axis = along[:, None] * ahead + 0.5 * arm.bend * along[:, None] ** 2 * left
    tangent = ahead + arm.bend * along[:, None] * left
    tangent = tangent / np.sqrt((tangent**2).sum(axis=1, keepdims=True))
    return axis + across[:, None] * left_of(tangent)


def strip(arm: Arm, along: tuple[float, float], across: tuple[float, float]) -> Line:
    """The outline of a rectangle along an arm, with points along its sides to bend with it."""
    (s0, s1), (o0, o1) = along, across
    count = max(2, int(abs(s1 - s0) / 2) + 2)
    s = np.linspace(s0, s1, count)
    sides = [np.stack([s, np.full(count, o0)], 1), np.stack([s[::-1], np.full(count, o1)], 1)]
    return on_arm(arm, np.concatenate(sides))


def divider(arm: Arm) -> float:
    """Across of the line between the two directions (the middle of the median)."""
    return 0.5 * arm.lane * (arm.lanes_out - len(arm.turns))


def half_width(arm: Arm) -> float:
    """Metres from an arm's axis to either kerb."""
    return 0.5 * (arm.lane * (arm.lanes_out + len(arm.turns)) + arm.median) + GUTTER


def lane_in(arm: Arm, rank: int) -> float:
    """Across of the middle of a lane towards the middle, counted from the divider."""
    return divider(arm) + arm.median / 2 + (rank + 0.5) * arm.lane


def lane_out(arm: Arm, rank: int) -> float:
    """Across of the middle of a lane away from the middle, counted from the divider."""
    return divider(arm) - arm.median / 2 - (rank + 0.5) * arm.lane


def turn_between(come: Arm, go: Arm) -> str:
    """L, S or R: how somebody turns who comes in on one arm and leaves on another."""
    change = wrap_angle(np.asarray(go.angle - come.angle - np.pi))
    return "S" if abs(change) < np.pi / 4 else "L" if change > 0 else "R"
