"""Scenery of a place: plots divided into parcels, street trees and lamps."""

from dataclasses import replace

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString, Point, Polygon
from shapely.affinity import rotate
from shapely.geometry import box

from geoaim.synthetic.roads.approaches import Approach, plan_from_road
from geoaim.synthetic.roads.car_park import (
    AISLE_WIDTH_M,
    BAY_SIZE_M,
    FIRST_BAY_M,
    outline_lot_part,
)
from geoaim.synthetic.roads.paving import (
    VERGE_WIDTH_M,
    outline_crossing,
    outline_road,
)
from geoaim.synthetic.roads.plan import Roads
from geoaim.synthetic.scenery.parcels import PARCEL_MAKERS
from geoaim.synthetic.scenery.scenery import Parcel, Scenery, Spot, Tree

USES = ("block", "houses", "park", "plaza", "field", "houses", "block")
PARCEL_WIDTH_M = (30.0, 46.0)  # smallest and largest
TREE_SPACING_M = 9.0  # mean distance of street trees


def place_scenery(roads: Roads, generator: np.random.Generator) -> Scenery:
    """Place scenery on the plots and along the roads."""
    nothing = Polygon()
    verges = _make_verges(roads)
    empty = Scenery(
        (), verges, nothing, nothing, nothing, nothing, (), (), (), _make_lamps(roads), (), ()
    )
    scenery = replace(
        empty, trees=_make_street_trees(roads, verges, generator), spots=_list_bay_spots(roads)
    )
    parcels = []
    for plot in roads.paving.plots:
        angle = _find_angle(roads, plot)
        for area in _divide(plot, angle, generator):
            beside_lot = area.distance(roads.paving.lot) < 3 if roads.car_park else False
            small = beside_lot or area.area < 350
            rough = small or roads.layout.kind == "park"  # lawns and ponds have paths of their own
            use = "field" if rough else USES[int(generator.integers(len(USES)))]
            parcels.append(Parcel(use, area))
            free = area.buffer(-0.5).difference(roads.footpaths.surface.buffer(1.0))
            part = max(shapely.get_parts(free), key=lambda part: part.area, default=Polygon())
            if part.area > 80:
                scenery = PARCEL_MAKERS[use](scenery, part, angle, generator)
    return replace(scenery, parcels=tuple(parcels))


def _divide(plot: Polygon, angle: float, generator: np.random.Generator) -> list[Polygon]:
    """Divide a plot into parcels, across the road beside it."""
    level = rotate(plot, -angle, origin=(0, 0), use_radians=True)
    left, low, right, high = level.bounds
    parcels, at = [], left
    while at < right:
        wide = generator.uniform(*PARCEL_WIDTH_M)
        wide = right - at if right - at - wide < PARCEL_WIDTH_M[0] / 2 else wide
        piece = level.intersection(box(at, low, at + wide, high))
        parts = [part for part in shapely.get_parts(piece) if part.area > 60]
        parcels += [rotate(part, angle, origin=(0, 0), use_radians=True) for part in parts]
        at += wide
    return parcels


def _find_angle(roads: Roads, plot: Polygon) -> float:
    """Find the direction of the approach that passes closest to a plot's middle."""
    middle = np.array(plot.representative_point().coords[0])

    def measure_distance(approach: Approach) -> float:
        along = np.linspace(0, 100, 21)
        axis = plan_from_road(approach, np.stack([along, 0 * along], axis=1))
        return float(((axis - middle) ** 2).sum(axis=1).min())

    return min(roads.layout.approaches, key=measure_distance).angle


def _make_verges(roads: Roads) -> Geometry:
    """Make strips of grass along the kerbs, interrupted at crossings and drives."""
    whole = outline_road(roads.paving)
    band = whole.buffer(VERGE_WIDTH_M + 0.3).difference(whole.buffer(0.35))
    doors = [roads.footpaths.surface.buffer(0.8), roads.paving.drive.buffer(0.4)]
    gaps = [outline_crossing(crossing).buffer(3.2) for crossing in roads.crossings]
    keep = [Point(0, 0).buffer(max(approach.mouth for approach in roads.layout.approaches) + 3.0)]
    doors += [
        LineString(edge.line[[0, -1]]).buffer(1.4)
        for edge in roads.footpaths.edges
        if edge.end in roads.footpaths.spawn_nodes and len(edge.line) < 40
    ]
    return band.difference(shapely.union_all([*doors, *gaps, *keep]))


def _make_street_trees(
    roads: Roads, verges: Geometry, generator: np.random.Generator
) -> tuple[Tree, ...]:
    """Make rows of trees in the verges."""
    line = outline_road(roads.paving).buffer(VERGE_WIDTH_M / 2 + 0.3).exterior
    near = verges.buffer(-0.4)
    trees, at = [], generator.uniform(0, TREE_SPACING_M)
    while at < line.length:
        spot = line.interpolate(at)
        if near.contains(spot) and roads.extent.buffer(4.0).contains(spot):
            number, radius = int(generator.integers(1 << 16)), generator.uniform(1.2, 2.0)
            trees.append(Tree((spot.x, spot.y), radius, number))
        at += TREE_SPACING_M * generator.uniform(0.85, 1.3)
    return tuple(trees)


def _make_lamps(roads: Roads) -> Float[Array, "L 2 2"]:
    """Make lamps along the approaches, and masts with signals over the stop lines."""
    rows = []
    for approach in roads.layout.approaches:
        half = approach.half_width
        for along in np.arange(approach.mouth + 16.0, 100.0, 27.0):
            for side in (-1, 1):
                across = np.array([[along, side * (half + 0.7)], [along, side * (half - 1.5)]])
                rows.append(plan_from_road(approach, across))
        if roads.layout.signalised:
            mast = np.array([[approach.stop - 0.8, half + 0.7], [approach.stop - 0.8, 0.35 * half]])
            rows.append(plan_from_road(approach, mast))
    return np.array(rows)


def _list_bay_spots(roads: Roads) -> tuple[Spot, ...]:
    """List the bays of the car park that traffic does not use."""
    car_park = roads.car_park
    if car_park is None:
        return ()
    spots = []
    for bay in range(car_park.bays):
        for side in (-1, 1):
            if side == 1 and bay in car_park.open_bays:
                continue
            beside, deep = (
                side * (AISLE_WIDTH_M + BAY_SIZE_M[1]) / 2,
                FIRST_BAY_M + (bay + 0.5) * BAY_SIZE_M[0],
            )
            place, ahead = outline_lot_part(car_park, (beside, beside + 1), (deep, deep + 1))[:2]
            heading = float(np.arctan2(*(ahead - place)[::-1]))
            spots.append(Spot((float(place[0]), float(place[1])), heading, 0.7))
    return tuple(spots)
