"""The road plan of a place, from its kind and a random generator."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from shapely import Polygon
from shapely.geometry import box

from benchmarks.synthetic.roads.approaches import Approach
from benchmarks.synthetic.roads.car_park import CarPark, make_car_park
from benchmarks.synthetic.roads.lanes import Lane, Route, make_lanes
from benchmarks.synthetic.roads.layouts import Layout, PlaceKind, make_layout
from benchmarks.synthetic.roads.paving import Crossing, Paving, make_paving
from benchmarks.synthetic.roads.pedestrian_network import PedestrianNetwork, make_pedestrian_network

HEIGHT_M, WIDTH_M = 104.0, 176.0  # size of the drawn extent
CAR_PARK_S: Mapping[PlaceKind, float] = {"junction": 46.0, "t": 42.0, "street": 26.0}


@dataclass(frozen=True, eq=False)
class Roads:
    """The plan of a place, in metres from its centre: x right and y up as drawn."""

    layout: Layout  # approaches, corners, roundabout
    lanes: tuple[Lane, ...]  # all lanes of the roads
    routes: tuple[Route, ...]  # all routes of vehicles through the place
    car_park: CarPark | None  # a car park beside the east approach, or None
    crossings: tuple[Crossing, ...]  # pedestrian crossings
    paving: Paving  # surfaces
    footpaths: PedestrianNetwork  # the network that pedestrians walk on
    extent: Polygon  # the part of the plan that is drawn


def make_roads(kind: PlaceKind, generator: np.random.Generator) -> Roads:
    """Plan a place; the same generator state gives the same plan."""
    layout = make_layout(kind, generator)
    lanes, routes = make_lanes(layout)
    extent = box(-WIDTH_M / 2, -HEIGHT_M / 2, WIDTH_M / 2, HEIGHT_M / 2)
    car_park = None
    if kind in CAR_PARK_S:
        s = CAR_PARK_S[kind] + generator.uniform(-2, 2)
        car_park = make_car_park(find_approach(layout, "east"), s)
    pavement_width = generator.uniform(4.0, 5.2)
    paving, crossings = make_paving(layout, lanes, car_park, extent, pavement_width)
    footpaths = make_pedestrian_network(
        paving, crossings, extent, pavement_width, generator, park=kind == "park"
    )
    return Roads(layout, lanes, routes, car_park, crossings, paving, footpaths, extent)


def find_approach(layout: Layout, name: str) -> Approach:
    """Find the approach with a name; raises StopIteration if there is none."""
    return next(approach for approach in layout.approaches if approach.name == name)


def find_signal(roads: Roads, lane: str, turn: str) -> str:
    """Find the name of the traffic light for a turn from a lane.

    Args:
        roads: the plan.
        lane: name of a lane.
        turn: L, S or R.

    Returns:
        "east", "east left" for a protected left turn, or "" where no light controls the lane.
    """
    if not roads.layout.signalised or " in " not in lane:
        return ""
    name, index = lane.split(" in ")
    only_left = find_approach(roads.layout, name).turns[int(index)] == "L"
    protected = only_left and name in ("east", "west")
    return f"{name} left" if protected and turn == "L" else name
