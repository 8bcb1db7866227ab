"""A car park beside an arm: its drive, aisle and bays, and the lines that wheels follow there.

Its own coordinates are metres beside the drive's middle (outwards along the arm) and metres deep
from the kerb. One enters on the side of lower `beside`, as traffic keeps to the right.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.synthetic.roads.arms import Arm, half_width, lane_out, on_arm
from geoaim.synthetic.roads.curves import Line, headings, joint

DRIVE = 7.0  # m, width of the drive
AISLE = 6.8  # m between the rows of bays
BAY = (2.6, 5.0)  # m, width and depth
NEAR = 6.5  # m from the kerb to the first bay
SIDE = 1.7  # m from the drive's middle to the line that wheels follow
TURN = 7.6  # m along the road that a turn into the drive takes
SWING = 5.0  # m that a turn into a bay takes
REST = 4.5  # m beside the middle of the aisle where the rear axle of a parked car stands
SLOW = 5.0  # m/s in the car park


@dataclass(frozen=True)
class CarPark:
    """A car park on the right of an arm, seen from the middle.

    Attributes:
        arm: the name of the arm.
        along: metres along the arm of the middle of its drive.
        bays: how many bays stand on either side of the aisle.
        open_bays: which bays on the far side of those who enter are used by traffic.
        plan_from_lot: (3, 3) its coordinates (beside, deep) to plan metres.
    """

    arm: str
    along: float
    bays: int
    open_bays: tuple[int, ...]
    plan_from_lot: Float[Array, "3 3"]


@dataclass(frozen=True)
class Manoeuvre:
    """A line into or out of a bay.

    Attributes:
        name: "into bay 3", "out of bay 3".
        line: where the rear axle goes; its first or last point is on the road.
        forward: (L,) whether the vehicle drives forward there.
        bay: the number of the bay.
    """

    name: str
    line: Line
    forward: Array
    bay: int


def make_car_park(arm: Arm, along: float, *, bays: int) -> CarPark:
    """A car park whose drive meets an arm at `along`; traffic uses every other bay.

    Next to each other, who backs out would touch his neighbour.
    """
    kerb, ahead = on_arm(arm, np.array([[along, -half_width(arm)], [along + 1, -half_width(arm)]]))
    beside = (ahead - kerb) / np.hypot(*(ahead - kerb))
    deep = np.array([beside[1], -beside[0]])
    plan_from_lot = np.eye(3)
    plan_from_lot[:2] = np.stack([beside, deep, kerb], axis=1)
    return CarPark(arm.name, along, bays, tuple(range(2, bays - 2, 2)), plan_from_lot)


def bay_middle(bay: int) -> float:
    """Metres deep of the middle of a bay."""
    return NEAR + (bay + 0.5) * BAY[0]


def lot_end(car_park: CarPark) -> float:
    """Metres deep of the end of the aisle."""
    return NEAR + car_park.bays * BAY[0] + 2.0


def manoeuvres(car_park: CarPark, arm: Arm) -> list[Manoeuvre]:
    """A line from the road into each open bay, and one out of it; both turn right only."""
    lines = []
    for bay in car_park.open_bays:
        road = _onto_drive(car_park, arm)
        way = np.concatenate([road, _to_bay(car_park, bay, road[-1], headings(road)[-1])[1:]])
        lines.append(Manoeuvre(f"into bay {bay}", way, np.ones(len(way), bool), bay))
        back, road = _out_of_bay(car_park, bay), _off_drive(car_park, arm)
        forward = joint(back[-1], headings(back)[-1] + np.pi, road[0], headings(road)[0])
        way = np.concatenate([back, forward[1:], road[1:]])
        lines.append(Manoeuvre(f"out of bay {bay}", way, np.arange(len(way)) >= len(back), bay))
    return lines


def _onto_drive(car_park: CarPark, arm: Arm) -> Line:
    """From the outer lane out of the place to the drive."""
    end = _plan(car_park, [[-SIDE, TURN - 2.0]])[0]
    start = _pose(arm, car_park.along - SIDE - TURN, lane_out(arm, arm.lanes_out - 1))
    return joint(*start, end, _heading(car_park, deep=1))


def _off_drive(car_park: CarPark, arm: Arm) -> Line:
    """From the drive to the same lane."""
    start = _plan(car_park, [[SIDE, TURN - 2.0]])[0]
    end = _pose(arm, car_park.along + SIDE + TURN, lane_out(arm, arm.lanes_out - 1))
    return joint(start, _heading(car_park, deep=-1), *end)


def _to_bay(car_park: CarPark, bay: int, start: Array, heading: float) -> Line:
    """Down the aisle and with one turn into the bay, nose first."""
    deep = bay_middle(bay)
    turn, mouth, rest = _plan(car_park, [[-SIDE, deep - SWING], [SWING - SIDE, deep], [REST, deep]])
    aside = _heading(car_park, beside=1)
    aisle = joint(start, heading, turn, _heading(car_park, deep=1))
    swing = joint(turn, _heading(car_park, deep=1), mouth, aside)
    return np.concatenate([aisle, swing[1:], np.linspace(mouth, rest, 4)[1:]])


def _out_of_bay(car_park: CarPark, bay: int) -> Line:
    """Backwards out of the bay, with one turn, until the nose points to the road."""
    deep = bay_middle(bay)
    rest, mouth, turn = _plan(car_park, [[REST, deep], [SWING - SIDE, deep], [-SIDE, deep + SWING]])
    aside = _heading(car_park, beside=-1)
    swing = joint(mouth, aside, turn, _heading(car_park, deep=1))
    return np.concatenate([np.linspace(rest, mouth, 4)[:-1], swing])


def _plan(car_park: CarPark, points: list[list[float]]) -> Line:
    place = car_park.plan_from_lot
    return np.asarray(points) @ place[:2, :2].T + place[:2, 2]


def _heading(car_park: CarPark, *, beside: float = 0.0, deep: float = 0.0) -> float:
    x, y = car_park.plan_from_lot[:2, :2] @ [beside, deep]
    return float(np.arctan2(y, x))


def _pose(arm: Arm, along: float, across: float) -> tuple[Array, float]:
    """A point of an arm and the direction outwards there."""
    place, ahead = on_arm(arm, np.array([[along, across], [along + 0.1, across]]))
    return place, float(np.arctan2(*(ahead - place)[::-1]))
