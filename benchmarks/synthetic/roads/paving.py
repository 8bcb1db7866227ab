"""Surfaces of a place: carriageway, islands, pavement, crossings, car park, plots."""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString, Point, Polygon

from benchmarks.synthetic.roads.approaches import GUTTER_M, Approach, outline_strip, plan_from_road
from benchmarks.synthetic.roads.car_park import (
    AISLE_WIDTH_M,
    BAY_SIZE_M,
    CAR_PARK_DEPTH_M,
    DRIVEWAY_WIDTH_M,
    CarPark,
    outline_car_park_part,
)
from benchmarks.synthetic.roads.lanes import LANE_END_M, Lane, compute_lane_bounds
from benchmarks.synthetic.roads.layouts import CROSSING_WIDTH_M, RING_LANE_WIDTH_M, Layout

VERGE_WIDTH_M = 1.5  # width of the grass between kerb and pavement, away from crossings
FLARE_RADIUS_M = 5.0  # radius of the kerbs where a driveway meets the road
MIN_PLOT_M2 = 60.0


@dataclass(frozen=True)
class Crossing:
    """Where pedestrians cross a road."""

    name: str  # name of its approach, or "drive", or "east on foot" where nothing is marked
    ends: Float[Array, "2 2"]  # its ends on the kerbs, plan metres; the end at larger t first
    width: float  # metres along the road
    marked: bool  # whether stripes are painted
    signalised: bool  # whether traffic lights control it


@dataclass(frozen=True)
class Paving:
    """Surfaces as polygons in plan metres that do not overlap."""

    carriageway: Geometry  # asphalt between the kerbs
    islands: Geometry  # raised ground within it
    driveway: Geometry  # asphalt of the driveway, across the pavement
    parking_lot: Geometry  # asphalt of the car park
    pavement: Geometry  # pavements for pedestrians on both sides of the roads, with their verges
    plots: tuple[Polygon, ...]  # the remaining ground of at least 60 m², one polygon per plot


def make_paving(
    layout: Layout,
    lanes: tuple[Lane, ...],
    car_park: CarPark | None,
    extent: Polygon,
    pavement_width: float,
) -> tuple[Paving, tuple[Crossing, ...]]:
    """Make the surfaces and crossings of a layout.

    Args:
        layout: approaches and corners.
        lanes: all lanes; the carriageway contains them and islands do not overlap them.
        car_park: None without a car park.
        extent: the part of the plan that is drawn, which the plots fill.
        pavement_width: metres.

    Returns:
        The surfaces and the crossings.
    """
    road = _outline_carriageway(layout, lanes)
    bounds = [compute_lane_bounds(lane) for lane in lanes]
    driven = [Polygon(np.concatenate([left, right[::-1]])).buffer(0) for left, right in bounds]
    islands = shapely.union_all(_make_islands(layout)).difference(shapely.union_all(driven))
    driveway, parking_lot = _make_driveway_and_parking_lot(car_park, road)
    paved = road.buffer(pavement_width, quad_segs=32)
    pavement = paved.difference(shapely.union_all([road, driveway, parking_lot]))
    rest = extent.difference(shapely.union_all([paved, driveway, parking_lot.buffer(1.0)]))
    plots = tuple(part for part in shapely.get_parts(rest) if part.area > MIN_PLOT_M2)
    paving = Paving(road.difference(islands), islands, driveway, parking_lot, pavement, plots)
    return paving, _make_crossings(layout, car_park, paving)


def _make_crossings(
    layout: Layout, car_park: CarPark | None, paving: Paving
) -> tuple[Crossing, ...]:
    """Make the marked crossings, then the informal ones, then the driveway's crossing."""
    crossings = []
    road = outline_road(paving)
    for approach in layout.approaches:
        if np.isfinite(approach.crossing):
            width, lights = CROSSING_WIDTH_M, layout.signalised
            ends = _cut_across(approach, approach.crossing + width / 2, road)
            crossings.append(Crossing(approach.name, ends, width, True, lights))
    by_name = {approach.name: approach for approach in layout.approaches}
    for name, s in layout.informal_crossings:
        ends = _cut_across(by_name[name], s, road)
        crossings.append(Crossing(f"{name} on foot", ends, 2.0, False, False))
    if car_park is not None:
        half = DRIVEWAY_WIDTH_M / 2 + 2.0
        ends = outline_car_park_part(car_park, (half, -half), (2.8, 2.8))[:2]
        crossings.append(Crossing("drive", ends, 2.5, False, False))
    return tuple(crossings)


def outline_road(paving: Paving) -> Polygon:
    """Outline the ground within the outer kerbs, in plan metres: carriageway and islands."""
    return Polygon(shapely.union_all([paving.carriageway, paving.islands]).exterior)


def outline_crossing(crossing: Crossing) -> Polygon:
    """Outline the ground of a crossing, from kerb to kerb, in plan metres."""
    return LineString(crossing.ends).buffer(crossing.width / 2, cap_style="flat")


def _outline_carriageway(layout: Layout, lanes: tuple[Lane, ...]) -> Polygon:
    """The outer kerbs, rounded where approaches meet."""
    asphalt = []
    for approach in layout.approaches:
        kerbs = -approach.half_width, approach.half_width
        asphalt.append(Polygon(outline_strip(approach, (-1.0, LANE_END_M), kerbs)))
    for lane in lanes:
        if " to " in lane.name or " ring" in lane.name:
            half = min(lane.width) / 2 + GUTTER_M
            asphalt.append(LineString(lane.centreline).buffer(half, cap_style="flat"))
    if layout.ring_radius:
        outer = layout.ring_radius + RING_LANE_WIDTH_M / 2 + 0.4
        asphalt.append(Point(0, 0).buffer(outer, quad_segs=32))
    radius = layout.corner_radius
    rounded = shapely.union_all(asphalt).buffer(radius, quad_segs=32).buffer(-radius)
    return Polygon(shapely.union_all([rounded]).exterior)


def _cut_across(approach: Approach, s: float, road: Polygon) -> Float[Array, "2 2"]:
    """From kerb to kerb across an approach, which corner radii widen."""
    reach = approach.half_width + 12.0
    left, middle, right = plan_from_road(approach, np.array([[s, reach], [s, 0.0], [s, -reach]]))
    parts = shapely.get_parts(LineString([left, right]).intersection(road))
    nearest = min(parts, key=lambda part: part.distance(Point(middle)))
    return np.array(nearest.coords)


def _make_islands(layout: Layout) -> list[Geometry]:
    """The central island of a roundabout, and the splitter islands, open at the crossings."""
    if not layout.ring_radius:
        return []
    radius = layout.ring_radius
    centre = Point(0, 0).buffer(radius - RING_LANE_WIDTH_M / 2 - 0.3, quad_segs=32)
    islands: list[Geometry] = [centre]
    for approach in layout.approaches:
        middle, half = approach.divider, approach.median / 2 - 0.35
        start, crossing = radius + RING_LANE_WIDTH_M / 2 + 2.2, approach.crossing
        nose = [[start, -2.6], [start - 0.6, 0.0], [start, 2.6]]
        corners = np.array([[crossing - 0.3, -half], *nose, [crossing - 0.3, half]])
        outline = plan_from_road(approach, corners + np.array([0, middle]))
        islands.append(Polygon(outline).buffer(0.0))
        end = crossing + CROSSING_WIDTH_M + 0.3
        outline = outline_strip(approach, (end, end + 14.0), (middle - half, middle + half))
        islands.append(Polygon(outline))
    return islands


def _make_driveway_and_parking_lot(
    car_park: CarPark | None, road: Geometry
) -> tuple[Geometry, Geometry]:
    """The driveway with rounded kerbs, and the car park; both empty without a car park."""
    if car_park is None:
        return Polygon(), Polygon()
    half = DRIVEWAY_WIDTH_M / 2
    lane = Polygon(outline_car_park_part(car_park, (-half, half), (-3.0, 12.0)))
    near = lane.buffer(12.0)
    mouth = shapely.union_all([lane, road.intersection(near)])
    mouth = mouth.buffer(FLARE_RADIUS_M, quad_segs=16).buffer(-FLARE_RADIUS_M, quad_segs=16)
    half = AISLE_WIDTH_M / 2 + BAY_SIZE_M[1] + 0.4
    parking_lot = Polygon(outline_car_park_part(car_park, (-half, half), (6.0, CAR_PARK_DEPTH_M)))
    parking_lot = parking_lot.difference(road)
    reach = Polygon(outline_car_park_part(car_park, (-12.0, 12.0), (0.0, 6.5)))
    driveway = shapely.union_all([mouth.intersection(near).intersection(reach)])
    return driveway.difference(shapely.union_all([road, parking_lot])), parking_lot
