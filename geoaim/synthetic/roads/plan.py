"""Roads: the whole plan of a place, from its kind and a generator."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from shapely import Polygon

from geoaim.synthetic.roads.arms import Arm
from geoaim.synthetic.roads.car_park import CarPark, make_car_park
from geoaim.synthetic.roads.lanes import Lane, Passage, make_lanes
from geoaim.synthetic.roads.layouts import Kind, Layout, lay_out
from geoaim.synthetic.roads.paving import Crossing, Paving, make_crossings, page_area, pave
from geoaim.synthetic.roads.walks import Walks, make_walks

HEIGHT, WIDTH = 104.0, 176.0  # m, of the drawn page
CAR_PARKS: Mapping[Kind, float] = {"junction": 46.0, "t": 42.0, "street": 26.0}  # m along the arm


@dataclass(frozen=True, eq=False)
class Roads:
    """The plan of a place, in metres from its middle: x right and y up as drawn.

    Attributes:
        layout: arms, corners, ring.
        lanes: all lanes of the roads.
        passages: all ways through the place.
        car_park: beside one of the arms, or None.
        crossings: where people cross.
        paving: surfaces.
        walks: where people walk.
        page: the part of the plan that is drawn.
    """

    layout: Layout
    lanes: tuple[Lane, ...]
    passages: tuple[Passage, ...]
    car_park: CarPark | None
    crossings: tuple[Crossing, ...]
    paving: Paving
    walks: Walks
    page: Polygon


def make_roads(kind: Kind, generator: np.random.Generator) -> Roads:
    """Plan a place of some kind; the same generator state gives the same plan."""
    layout = lay_out(kind, generator)
    lanes, passages = make_lanes(layout)
    page = page_area(HEIGHT, WIDTH)
    car_park = _car_park(layout, generator)
    wide = generator.uniform(4.0, 5.2)
    paving = pave(layout, lanes, car_park, page, wide)
    crossings = make_crossings(layout, car_park, paving)
    walks = make_walks(paving, crossings, page, wide, generator, park=kind == "park")
    return Roads(layout, lanes, passages, car_park, crossings, paving, walks, page)


def arm_named(layout: Layout, name: str) -> Arm:
    """The arm of that name."""
    return next(arm for arm in layout.arms if arm.name == name)


def signal_of(roads: Roads, lane: str, turn: str) -> str:
    """The light that holds a lane towards the middle, or ""."""
    if not roads.layout.signalised or " in " not in lane:
        return ""
    name, rank = lane.split(" in ")
    protected = arm_named(roads.layout, name).turns[int(rank)] == "L" and name in ("east", "west")
    return f"{name} left" if protected and turn == "L" else name


def _car_park(layout: Layout, generator: np.random.Generator) -> CarPark | None:
    """A car park beside the east arm, where its plot has room for one."""
    if layout.kind not in CAR_PARKS:
        return None
    along = CAR_PARKS[layout.kind] + generator.uniform(-2, 2)
    return make_car_park(arm_named(layout, "east"), along, bays=9)
