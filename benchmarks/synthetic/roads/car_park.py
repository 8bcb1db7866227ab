"""A car park beside an approach: its driveway, aisle and bays, and the vehicles' manoeuvres.

Car park coordinates: metres along the kerb from the middle of the driveway (outwards), and metres
deep from the kerb. Vehicles enter on the side with negative coordinates, as traffic drives on the
right.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from benchmarks.synthetic.roads.approaches import Approach, locate_outbound_lane, plan_from_road
from benchmarks.synthetic.roads.curves import Polyline, compute_headings, connect_poses
from geoaim.base.geometry import transform_points

BAYS = 9  # bays on each side of the aisle
DRIVEWAY_WIDTH_M = 7.0
AISLE_WIDTH_M = 6.8  # distance between the rows of bays
BAY_SIZE_M = (2.6, 5.0)  # width and depth
FIRST_BAY_M = 6.5  # distance of the first bay from the kerb
# distance of the aisle's end from the kerb
CAR_PARK_DEPTH_M = FIRST_BAY_M + BAYS * BAY_SIZE_M[0] + 2.0
PATH_OFFSET_M = 1.7  # distance of the paths of vehicles from the middle of the driveway
DRIVEWAY_TURN_M = 7.6  # length along the road of a turn into the driveway
BAY_TURN_M = 5.0  # length along the aisle of a turn into a bay
REST_OFFSET_M = 4.5  # distance of a parked vehicle's rear axle from the middle of the aisle
CAR_PARK_SPEED = 5.0  # m/s


@dataclass(frozen=True)
class CarPark:
    """A car park on the right of an approach's outbound lanes."""

    approach: str  # its name
    s: float  # where the middle of the driveway is along the approach, metres
    open_bays: tuple[int, ...]  # the bays that traffic uses, on the side of positive coordinates
    plan_from_car_park: Float[Array, "3 3"]  # car park coordinates to plan metres


@dataclass(frozen=True)
class Manoeuvre:
    """The path into or out of a bay."""

    name: str  # "into bay 3", "out of bay 3"
    line: Polyline  # path of the rear axle; its first or last point is on the road
    forward: Bool[Array, "L"]  # whether the vehicle drives forward there
    bay: int  # number of the bay


def make_car_park(approach: Approach, s: float) -> CarPark:
    """Place a car park with its driveway at s (metres) of an approach, on its outbound side.

    Traffic uses every other bay: a vehicle that backs out would touch one in the next bay.
    """
    t = -approach.half_width
    kerb, next_point = plan_from_road(approach, np.array([[s, t], [s + 1, t]]))
    along = (next_point - kerb) / np.hypot(*(next_point - kerb))
    deep = np.array([along[1], -along[0]])
    plan_from_car_park = np.eye(3)
    plan_from_car_park[:2] = np.stack([along, deep, kerb], axis=1)
    return CarPark(approach.name, s, tuple(range(2, BAYS - 2, 2)), plan_from_car_park)


def outline_car_park_part(
    car_park: CarPark, along: tuple[float, float], deep: tuple[float, float]
) -> Polyline:
    """Compute the corners of a rectangle in a car park.

    Args:
        car_park: the car park that the coordinates belong to.
        along: ends of the rectangle along the kerb, metres.
        deep: its ends perpendicular to the kerb, metres from it.

    Returns:
        Four corners in plan coordinates.
    """
    (x0, x1), (y0, y1) = along, deep
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return transform_points(car_park.plan_from_car_park, corners)


def make_manoeuvres(car_park: CarPark, approach: Approach) -> list[Manoeuvre]:
    """Make the path from the road into each open bay and the path out; both turn right only."""
    manoeuvres = []
    for bay in car_park.open_bays:
        road = _enter_driveway(car_park, approach)
        into = np.concatenate([road, _enter_bay(car_park, bay, road)[1:]])
        manoeuvres.append(Manoeuvre(f"into bay {bay}", into, np.ones(len(into), bool), bay))
        back, road = _leave_bay(car_park, bay), _leave_driveway(car_park, approach)
        heading = compute_headings(back)[-1] + np.pi
        forward = connect_poses(back[-1], heading, road[0], compute_headings(road)[0])
        out = np.concatenate([back, forward[1:], road[1:]])
        is_forward = np.arange(len(out)) >= len(back)
        manoeuvres.append(Manoeuvre(f"out of bay {bay}", out, is_forward, bay))
    return manoeuvres


def _enter_driveway(car_park: CarPark, approach: Approach) -> Polyline:
    """From the outer outbound lane into the driveway."""
    end = _plan_from_car_park(car_park, [[-PATH_OFFSET_M, DRIVEWAY_TURN_M - 2.0]])[0]
    start = _locate_lane_pose(approach, car_park.s - PATH_OFFSET_M - DRIVEWAY_TURN_M)
    return connect_poses(*start, end, _compute_heading(car_park, deep=1))


def _leave_driveway(car_park: CarPark, approach: Approach) -> Polyline:
    """From the driveway into the same lane."""
    start = _plan_from_car_park(car_park, [[PATH_OFFSET_M, DRIVEWAY_TURN_M - 2.0]])[0]
    end = _locate_lane_pose(approach, car_park.s + PATH_OFFSET_M + DRIVEWAY_TURN_M)
    return connect_poses(start, _compute_heading(car_park, deep=-1), *end)


def _enter_bay(car_park: CarPark, bay: int, road: Polyline) -> Polyline:
    """Down the aisle and with one turn forward into the bay."""
    turn, mouth, rest = _locate_bay_path(car_park, bay, -BAY_TURN_M)
    inwards = _compute_heading(car_park, deep=1)
    aisle = connect_poses(road[-1], compute_headings(road)[-1], turn, inwards)
    curve = connect_poses(turn, inwards, mouth, _compute_heading(car_park, along=1))
    return np.concatenate([aisle, curve[1:], np.linspace(mouth, rest, 4)[1:]])


def _leave_bay(car_park: CarPark, bay: int) -> Polyline:
    """In reverse out of the bay, with one turn, until the vehicle points to the road."""
    turn, mouth, rest = _locate_bay_path(car_park, bay, BAY_TURN_M)
    headings = _compute_heading(car_park, along=-1), _compute_heading(car_park, deep=1)
    curve = connect_poses(mouth, headings[0], turn, headings[1])
    return np.concatenate([np.linspace(rest, mouth, 4)[:-1], curve])


def _locate_bay_path(car_park: CarPark, bay: int, turn: float) -> Polyline:
    """Where a turn begins `turn` metres deeper than a bay, where it ends, where vehicles rest."""
    deep = FIRST_BAY_M + (bay + 0.5) * BAY_SIZE_M[0]
    points = [[-PATH_OFFSET_M, deep + turn], [BAY_TURN_M - PATH_OFFSET_M, deep]]
    return _plan_from_car_park(car_park, [*points, [REST_OFFSET_M, deep]])


def _plan_from_car_park(car_park: CarPark, points: list[list[float]]) -> Polyline:
    return transform_points(car_park.plan_from_car_park, np.array(points))


def _compute_heading(car_park: CarPark, *, along: float = 0.0, deep: float = 0.0) -> float:
    """The heading in the plan of a direction in car park coordinates."""
    x, y = car_park.plan_from_car_park[:2, :2] @ [along, deep]
    return float(np.arctan2(y, x))


def _locate_lane_pose(approach: Approach, s: float) -> tuple[Float[Array, "2"], float]:
    """A point of the outer outbound lane and the heading there."""
    t = locate_outbound_lane(approach, approach.outbound_lanes - 1)
    point, next_point = plan_from_road(approach, np.array([[s, t], [s + 0.1, t]]))
    return point, float(np.arctan2(*(next_point - point)[::-1]))
