"""What the ground is made of: carriageway, islands, pavement, crossings, car park, plots."""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString, Point, Polygon
from shapely.geometry import box

from geoaim.synthetic.roads.arms import GUTTER, Arm, divider, half_width, on_arm, strip
from geoaim.synthetic.roads.car_park import AISLE, BAY, DRIVE, CarPark, lot_end
from geoaim.synthetic.roads.curves import Line
from geoaim.synthetic.roads.lanes import FAR, Lane, sides
from geoaim.synthetic.roads.layouts import CROSSING, RING_LANE, Layout

VERGE = 1.5  # m, width of the grass between kerb and pavement, away from crossings
FLARE = 5.0  # m, radius of the kerbs of a drive


@dataclass(frozen=True)
class Crossing:
    """Where people cross an arm.

    Attributes:
        name: of its arm, or "drive", or "east on foot" where nothing is marked.
        arm: the arm that it crosses.
        ends: left and right of somebody who looks outwards along the arm, on the kerbs.
        width: metres along the arm.
        marked: whether stripes are painted.
        signalised: whether lights control it.
    """

    name: str
    arm: str
    ends: Float[Array, "2 2"]
    width: float
    marked: bool
    signalised: bool


@dataclass(frozen=True)
class Paving:
    """Surfaces as polygons in plan metres, none of which overlaps another.

    Attributes:
        carriageway: tar between kerbs.
        islands: raised ground within it.
        drive: tar across the pavement into the car park.
        lot: tar of the car park.
        pavement: for those on foot, on both sides of the roads, with its verges.
        plots: what lies between, one polygon a plot.
    """

    carriageway: Geometry
    islands: Geometry
    drive: Geometry
    lot: Geometry
    pavement: Geometry
    plots: tuple[Polygon, ...]


def pave(
    layout: Layout, lanes: tuple[Lane, ...], car_park: CarPark | None, page: Polygon, wide: float
) -> Paving:
    """Surfaces of a layout, with a pavement so wide (metres), on a page."""
    tar = [Polygon(strip(arm, (-1.0, FAR), _kerbs(arm))) for arm in layout.arms]
    tar += [_lane_area(lane) for lane in lanes if " to " in lane.name or " ring" in lane.name]
    if layout.ring:
        tar.append(Point(0, 0).buffer(layout.ring + RING_LANE / 2 + 0.4, quad_segs=32))
    edges = [sides(lane) for lane in lanes]
    closed = shapely.union_all(tar).buffer(layout.corner, quad_segs=32).buffer(-layout.corner)
    whole = Polygon(shapely.union_all([closed]).exterior)
    wheels = [Polygon(np.concatenate([left, right[::-1]])).buffer(0) for left, right in edges]
    islands = shapely.union_all(_islands(layout)).difference(shapely.union_all(wheels))
    drive, lot = _drive_and_lot(car_park, whole)
    around = whole.buffer(wide, quad_segs=32)
    pavement = around.difference(shapely.union_all([whole, drive, lot]))
    rest = page.difference(shapely.union_all([around, drive, lot.buffer(1.0)]))
    parts = [part for part in shapely.get_parts(rest) if part.area > 60]
    return Paving(whole.difference(islands), islands, drive, lot, pavement, tuple(parts))


def make_crossings(
    layout: Layout, car_park: CarPark | None, paving: Paving
) -> tuple[Crossing, ...]:
    """Marked and unmarked crossings of the arms, and of the drive of the car park."""
    found = []
    arms = {arm.name: arm for arm in layout.arms}
    road = outer_kerbs(paving)
    for arm in layout.arms:
        if np.isfinite(arm.crossing):
            ends = _across(arm, arm.crossing + CROSSING / 2, road)
            found.append(Crossing(arm.name, arm.name, ends, CROSSING, True, layout.signalised))
    for name, along in layout.informal:
        ends = _across(arms[name], along, road)
        found.append(Crossing(f"{name} on foot", name, ends, 2.0, False, False))
    if car_park is not None:
        ends = lot_polygon(car_park, (DRIVE / 2 + 2.0, -DRIVE / 2 - 2.0), (2.8, 2.8))[:2]
        found.append(Crossing("drive", car_park.arm, ends, 2.5, False, False))
    return tuple(found)


def outer_kerbs(paving: Paving) -> Polygon:
    """The roads with all islands in them."""
    return Polygon(shapely.union_all([paving.carriageway, paving.islands]).exterior)


def crossing_area(crossing: Crossing) -> Polygon:
    """The ground of a crossing, from kerb to kerb."""
    return LineString(crossing.ends).buffer(crossing.width / 2, cap_style="flat")


def page_area(height: float, width: float) -> Polygon:
    """The drawn part of the plan, metres, around the middle."""
    return box(-width / 2, -height / 2, width / 2, height / 2)


def lot_polygon(car_park: CarPark, beside: tuple[float, float], deep: tuple[float, float]) -> Line:
    """Corners of a rectangle in a car park's coordinates, in plan metres."""
    (b0, b1), (d0, d1) = beside, deep
    corners = np.array([[b0, d0], [b1, d0], [b1, d1], [b0, d1]])
    place = car_park.plan_from_lot
    return corners @ place[:2, :2].T + place[:2, 2]


def _kerbs(arm: Arm) -> tuple[float, float]:
    return -half_width(arm), half_width(arm)


def _across(arm: Arm, along: float, road: Polygon) -> Line:
    """From kerb to kerb: round corners widen the road."""
    reach = half_width(arm) + 12.0
    ends = on_arm(arm, np.array([[along, reach], [along, 0.0], [along, -reach]]))
    parts = shapely.get_parts(LineString(ends[[0, 2]]).intersection(road))
    middle = min(parts, key=lambda part: part.distance(Point(ends[1])))
    return np.array(middle.coords)


def _lane_area(lane: Lane) -> Geometry:
    """The ground that wheels need where lanes turn."""
    return LineString(lane.centre).buffer(min(lane.width) / 2 + GUTTER, cap_style="flat")


def _islands(layout: Layout) -> list[Geometry]:
    """The middle of a roundabout, and the medians of its arms, open where people cross."""
    if not layout.ring:
        return []
    islands: list[Geometry] = [Point(0, 0).buffer(layout.ring - RING_LANE / 2 - 0.3, quad_segs=32)]
    for arm in layout.arms:
        middle, half = divider(arm), arm.median / 2 - 0.35
        start, crossing = layout.ring + RING_LANE / 2 + 2.2, arm.crossing
        nose = [[start, -2.6], [start - 0.6, 0.0], [start, 2.6]]
        outline = [[crossing - 0.3, -half], *nose, [crossing - 0.3, half]]
        islands.append(Polygon(on_arm(arm, np.array(outline) + np.array([0, middle]))).buffer(0.0))
        after = crossing + CROSSING + 0.3
        islands.append(Polygon(strip(arm, (after, after + 14.0), (middle - half, middle + half))))
    return islands


def _drive_and_lot(car_park: CarPark | None, road: Geometry) -> tuple[Geometry, Geometry]:
    if car_park is None:
        return Polygon(), Polygon()
    lane = Polygon(lot_polygon(car_park, (-DRIVE / 2, DRIVE / 2), (-3.0, 12.0)))
    near = lane.buffer(12.0)
    mouth = shapely.union_all([lane, road.intersection(near)])
    mouth = mouth.buffer(FLARE, quad_segs=16).buffer(-FLARE, quad_segs=16).intersection(near)
    half = AISLE / 2 + BAY[1]
    lot = Polygon(lot_polygon(car_park, (-half - 0.4, half + 0.4), (6.0, lot_end(car_park))))
    lot = lot.difference(road)
    reach = Polygon(lot_polygon(car_park, (-12.0, 12.0), (0.0, 6.5)))
    drive = shapely.union_all([mouth.intersection(reach)]).difference(
        shapely.union_all([road, lot])
    )
    return drive, lot
