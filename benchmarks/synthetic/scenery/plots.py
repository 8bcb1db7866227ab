"""Scenery of a place: plots divided into parcels and what stands on them, street trees."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString, Point, Polygon
from shapely.affinity import rotate
from shapely.geometry import box

from benchmarks.synthetic.roads.approaches import Approach, plan_from_road
from benchmarks.synthetic.roads.car_park import (
    AISLE_WIDTH_M,
    BAY_SIZE_M,
    BAYS,
    FIRST_BAY_M,
    outline_car_park_part,
)
from benchmarks.synthetic.roads.paving import VERGE_WIDTH_M, outline_crossing, outline_road
from benchmarks.synthetic.roads.plan import Roads
from benchmarks.synthetic.scenery.canvas import make_rectangle
from benchmarks.synthetic.scenery.scenery import Building, Parcel, Scenery, Spot, Tree

USES = ("block", "houses", "park", "plaza", "field", "houses", "block")  # twice: twice as likely
PARCEL_WIDTH_M = (30.0, 46.0)  # smallest and largest
CLEARANCE_M = 1.5  # free space around buildings
TREE_SPACING_M = 9.0  # mean distance of street trees
Additions = dict[str, Any]  # what is added to the objects and areas of `Scenery`


def place_scenery(roads: Roads, generator: np.random.Generator) -> Scenery:
    """Place buildings, trees and the other objects of `Scenery` at random.

    They stand along the roads and on the plots, which are the areas between roads, divided into
    parcels.
    """
    no_area, verges = Polygon(), _make_verges(roads)
    areas = verges, no_area, no_area, no_area, no_area
    trees = _make_street_trees(roads, verges, generator)
    scenery = Scenery((), *areas, (), trees, _list_bay_spots(roads))
    parcels = []
    for plot in roads.paving.plots:
        angle = _find_angle(roads, plot)
        for area in _divide(plot, angle, generator):
            beside_parking_lot = (
                area.distance(roads.paving.parking_lot) < 3 if roads.car_park else False
            )
            small = beside_parking_lot or area.area < 350
            rough = small or roads.layout.kind == "park"  # lawns and ponds have paths of their own
            use = "field" if rough else USES[int(generator.integers(len(USES)))]
            parcels.append(Parcel(use, area))
            free = area.buffer(-0.5).difference(roads.footpaths.surface.buffer(1.0))
            part = max(shapely.get_parts(free), key=lambda part: part.area, default=Polygon())
            if part.area > 80:
                scenery = _add(scenery, _PARCEL_MAKERS[use](part, angle, generator))
    return replace(scenery, parcels=tuple(parcels))


def _add(scenery: Scenery, additions: Additions) -> Scenery:
    """Append to lists of objects, and unite areas."""
    before = {name: getattr(scenery, name) for name in additions}
    changes: dict[str, Any] = {
        name: (*old, *additions[name]) if isinstance(old, tuple) else old.union(additions[name])
        for name, old in before.items()
    }
    return replace(scenery, **changes)


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
    """Make strips of grass along the kerbs, interrupted at crossings and driveways."""
    whole = outline_road(roads.paving)
    band = whole.buffer(VERGE_WIDTH_M + 0.3).difference(whole.buffer(0.35))
    doors = [roads.footpaths.surface.buffer(0.8), roads.paving.driveway.buffer(0.4)]
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


def _list_bay_spots(roads: Roads) -> tuple[Spot, ...]:
    """List the bays of the car park that traffic does not use."""
    car_park = roads.car_park
    if car_park is None:
        return ()
    spots = []
    for bay in range(BAYS):
        for side in (-1, 1):
            if side == 1 and bay in car_park.open_bays:
                continue
            beside = side * (AISLE_WIDTH_M + BAY_SIZE_M[1]) / 2
            deep = FIRST_BAY_M + (bay + 0.5) * BAY_SIZE_M[0]
            place, ahead = outline_car_park_part(car_park, (beside, beside + 1), (deep, deep + 1))[
                :2
            ]
            heading = float(np.arctan2(*(ahead - place)[::-1]))
            spots.append(Spot((float(place[0]), float(place[1])), heading, 0.7))
    return tuple(spots)


def _make_block(plot: Polygon, angle: float, generator: np.random.Generator) -> Additions:
    """Add one or two large flat roofs, slabs around them, and a few trees."""
    yard, rest, buildings = plot.buffer(1.4), plot, []
    for _ in range(2):
        size = generator.uniform(15, 26), generator.uniform(11, 19)
        body = _fit_rectangle(rest, size, angle, CLEARANCE_M, generator)
        if body is not None:
            buildings.append(Building(body[0], size, angle, generator.uniform(6, 13), True, 0))
            rest = rest.difference(Polygon(body[1]).buffer(3.0))
    trees = _scatter_trees(rest, 9, (1.2, 2.4), 4.0, generator)
    spots = _make_parking_row(rest, angle, generator)
    return {"slabs": yard, "buildings": buildings, "trees": trees, "spots": spots}


def _make_parking_row(area: Geometry, angle: float, generator: np.random.Generator) -> list[Spot]:
    """Make parking spots side by side in a yard."""
    body = _fit_rectangle(area, (13.0, 5.0), angle, 0.3, generator)
    if body is None:
        return []
    ahead, middle = np.array([np.cos(angle), np.sin(angle)]), np.array(body[0])
    places = [middle + d * ahead for d in (-5.2, -2.6, 0.0, 2.6, 5.2)]
    return [Spot((float(x), float(y)), angle + np.pi / 2, 0.7) for x, y in places]


def _make_houses(plot: Polygon, angle: float, generator: np.random.Generator) -> Additions:
    """Add pitched roofs in gardens, with driveways."""
    buildings, spots, driveways = [], [], []
    left = plot.buffer(-2.0)
    for _ in range(3):
        size = generator.uniform(11, 14.5), generator.uniform(8, 10)
        body = _fit_rectangle(left, size, angle + generator.normal(0, 0.05), CLEARANCE_M, generator)
        if body is None:
            break
        centre, outline = body
        height, colour = generator.uniform(4.5, 6.5), int(generator.integers(4))
        buildings.append(Building(centre, size, angle, height, False, colour))
        side = outline[1] + 0.5 * (outline[2] - outline[1])
        out = (outline[1] - outline[0]) / size[0]
        middle = side + 2.2 * out
        driveway = make_rectangle(middle, (3.4, size[1] + 3.0), angle)
        driveways.append(Polygon(driveway).intersection(plot))
        spots.append(Spot((float(middle[0]), float(middle[1])), angle + np.pi / 2, 0.6))
        left = left.difference(Polygon(outline).buffer(6.0)).difference(
            Polygon(driveway).buffer(1.0)
        )
    trees = _scatter_trees(left, 7, (1.6, 3.2), 4.0, generator)
    trees += _scatter_trees(left, 16, (0.5, 1.1), 2.0, generator)
    slabs = shapely.union_all(driveways)
    return {"slabs": slabs, "buildings": buildings, "trees": trees, "spots": spots}


def _make_park(plot: Polygon, angle: float, generator: np.random.Generator) -> Additions:
    """Add lawn, winding gravel paths, a pond and many trees."""
    x, y = plot.representative_point().coords[0]
    middle = np.array([x, y])
    t = np.linspace(-60, 60, 120)
    wave = 2.5 * np.sin(t / generator.uniform(5, 9) + generator.uniform(0, 6))
    lines = []
    for turn in (angle + 0.5, angle + 0.5 + generator.uniform(1.2, 1.9)):
        along = np.array([np.cos(turn), np.sin(turn)])
        across = np.array([-along[1], along[0]])
        lines.append(LineString(middle + t[:, None] * along + wave[:, None] * across))
    round_pond = Point(x, y).buffer(generator.uniform(6.5, 8.0))
    gravel = shapely.union_all([*[line.buffer(1.05) for line in lines], round_pond])
    lawn_edge = plot.buffer(-1.5)
    gravel = gravel.difference(round_pond.buffer(-2.0)).intersection(lawn_edge)
    pond = Point(x, y).buffer(3.6, quad_segs=24)
    if not plot.contains(round_pond):
        gravel, pond = gravel.difference(round_pond), Polygon()
    rest = lawn_edge.difference(shapely.union_all([gravel.buffer(1.0), round_pond]))
    trees = _scatter_trees(rest, 18, (2.0, 3.8), 5.0, generator)
    trees += _scatter_trees(rest, 14, (0.5, 1.1), 2.0, generator)
    return {"gravel": gravel, "ponds": pond, "trees": trees}


def _make_plaza(plot: Polygon, angle: float, generator: np.random.Generator) -> Additions:
    """Add slabs with shrubs, a low flat roof and trees."""
    square = plot.buffer(-0.4)
    size = generator.uniform(12, 18), generator.uniform(9, 13)
    body = _fit_rectangle(square, size, angle, 3.0, generator)
    buildings, rest = [], square.buffer(-2.0)
    if body is not None:
        buildings = [Building(body[0], size, angle, generator.uniform(5, 8), True, 1)]
        rest = rest.difference(Polygon(body[1]).buffer(4.0))
    trees = _scatter_trees(rest, 16, (1.3, 2.2), 5.5, generator)
    trees += _scatter_trees(rest, 10, (0.6, 1.2), 3.0, generator)
    return {"slabs": square.buffer(1.4), "buildings": buildings, "trees": trees}


def _make_field(plot: Polygon, angle: float, generator: np.random.Generator) -> Additions:
    """Add rough grass with bare soil, shrubs and a few trees."""
    spots = _sample_points(plot, 5, 6.0, generator)
    soil = [_make_blob(spot, generator.uniform(2, 7), generator) for spot in spots]
    rest = plot.buffer(-1.5)
    trees = _scatter_trees(rest, 7, (1.6, 3.2), 5.0, generator)
    trees += _scatter_trees(rest, 30, (0.4, 1.3), 1.4, generator)
    return {"soil": shapely.union_all(soil).intersection(plot), "trees": trees}


def _make_blob(spot: Point, radius: float, generator: np.random.Generator) -> Polygon:
    """Make a patch with an uneven rim."""
    turn = np.linspace(0, 2 * np.pi, 49)[:-1]
    size = radius * np.ones(48)
    for wave in range(2, 8):
        height = radius * generator.normal(0, 0.5 / wave)
        size += height * np.cos(wave * turn + generator.uniform(0, 6))
    size = np.maximum(size, 0.3 * radius)
    rim = np.stack([np.cos(turn), np.sin(turn)], axis=1) * size[:, None]
    return Polygon(rim + np.array([spot.x, spot.y])).buffer(0.0)


def _fit_rectangle(
    area: Geometry,
    size: tuple[float, float],
    angle: float,
    clear: float,
    generator: np.random.Generator,
) -> tuple[tuple[float, float], Float[Array, "4 2"]] | None:
    """Find a place for a rectangle in an area with clearance around it; None if there is none."""
    if area.is_empty:
        return None
    low_x, low_y, high_x, high_y = area.bounds
    shapely.prepare(area)
    for _ in range(60):
        centre = generator.uniform([low_x, low_y], [high_x, high_y])
        outline = make_rectangle(centre, size, angle)
        if area.contains(Polygon(outline).buffer(clear)):
            return (float(centre[0]), float(centre[1])), outline
    return None


def _sample_points(
    area: Geometry, count: int, apart: float, generator: np.random.Generator
) -> list[Point]:
    """Sample points in an area that keep a distance from each other."""
    points: list[Point] = []
    if area.is_empty:
        return points
    low_x, low_y, high_x, high_y = area.bounds
    shapely.prepare(area)
    for x, y in generator.uniform([low_x, low_y], [high_x, high_y], (12 * count, 2)):
        spot = Point(x, y)
        is_apart = all(spot.distance(other) > apart for other in points)
        if len(points) < count and area.contains(spot) and is_apart:
            points.append(spot)
    return points


def _scatter_trees(
    area: Geometry,
    count: int,
    radius: tuple[float, float],
    apart: float,
    generator: np.random.Generator,
) -> tuple[Tree, ...]:
    """Scatter trees in an area, with a distance between their stems."""
    inside = area.buffer(-0.4 * radius[1])
    spots = _sample_points(inside, count, apart, generator)
    return tuple(
        Tree((spot.x, spot.y), generator.uniform(*radius), int(generator.integers(1 << 16)))
        for spot in spots
    )


_PARCEL_MAKERS: dict[str, Callable[[Polygon, float, np.random.Generator], Additions]] = {
    "block": _make_block,
    "houses": _make_houses,
    "park": _make_park,
    "plaza": _make_plaza,
    "field": _make_field,
}
