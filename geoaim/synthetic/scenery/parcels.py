"""What stands on a parcel: blocks, houses, parks, plazas, fields."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, LineString, Point, Polygon

from geoaim.synthetic.scenery.canvas import make_bar, make_rectangle
from geoaim.synthetic.scenery.scenery import Building, Scenery, Spot, Tree

CLEARANCE_M = 1.5  # around buildings


def _make_block(
    scenery: Scenery, plot: Polygon, angle: float, generator: np.random.Generator
) -> Scenery:
    """Add one or two large flat roofs, slabs around them, and a few trees."""
    yard, rest, buildings = plot.buffer(1.4), plot, []
    for _ in range(2):
        size = generator.uniform(15, 26), generator.uniform(11, 19)
        body = _fit_rectangle(rest, size, angle, CLEARANCE_M, generator)
        if body is not None:
            buildings.append(Building(body[0], size, angle, generator.uniform(6, 13), True, 0))
            rest = rest.difference(Polygon(body[1]).buffer(3.0))
    trees = _scatter_trees(rest, 9, (1.2, 2.4), 4.0, generator)
    return replace(
        scenery,
        slabs=scenery.slabs.union(yard),
        buildings=(*scenery.buildings, *buildings),
        trees=(*scenery.trees, *trees),
        spots=(*scenery.spots, *_make_parking_row(rest, angle, generator)),
        spare=(*scenery.spare, *_make_spare_rectangles(rest, angle, generator)),
    )


def _make_parking_row(area: Geometry, angle: float, generator: np.random.Generator) -> list[Spot]:
    """Make parking spots side by side in a yard."""
    body = _fit_rectangle(area, (13.0, 5.0), angle, 0.3, generator)
    if body is None:
        return []
    ahead, middle = np.array([np.cos(angle), np.sin(angle)]), np.array(body[0])
    places = [middle + d * ahead for d in (-5.2, -2.6, 0.0, 2.6, 5.2)]
    return [Spot((float(x), float(y)), angle + np.pi / 2, 0.7) for x, y in places]


def _make_houses(
    scenery: Scenery, plot: Polygon, angle: float, generator: np.random.Generator
) -> Scenery:
    """Add pitched roofs in gardens, with drives and hedges."""
    buildings, spots, drives = [], [], []
    left = plot.buffer(-2.0)
    for _ in range(3):
        size = generator.uniform(11, 14.5), generator.uniform(8, 10)
        body = _fit_rectangle(left, size, angle + generator.normal(0, 0.05), CLEARANCE_M, generator)
        if body is None:
            break
        centre, outline = body
        buildings.append(
            Building(
                centre, size, angle, generator.uniform(4.5, 6.5), False, int(generator.integers(4))
            )
        )
        side = outline[1] + 0.5 * (outline[2] - outline[1])
        out = (outline[1] - outline[0]) / size[0]
        drive = make_rectangle(side + 2.2 * out, (3.4, size[1] + 3.0), angle)
        drives.append(Polygon(drive).intersection(plot))
        spots.append(
            Spot(
                (float((side + 2.2 * out)[0]), float((side + 2.2 * out)[1])), angle + np.pi / 2, 0.6
            )
        )
        left = left.difference(Polygon(outline).buffer(6.0)).difference(Polygon(drive).buffer(1.0))
    trees = _scatter_trees(left, 7, (1.6, 3.2), 4.0, generator) + _scatter_trees(
        left, 16, (0.5, 1.1), 2.0, generator
    )
    return replace(
        scenery,
        slabs=shapely.union_all([scenery.slabs, *drives]),
        buildings=(*scenery.buildings, *buildings),
        trees=(*scenery.trees, *trees),
        hedges=(*scenery.hedges, *_make_hedges(plot, generator)),
        spots=(*scenery.spots, *spots),
        spare=(*scenery.spare, *_make_spare_rectangles(left, angle, generator)),
    )


def _make_park(
    scenery: Scenery, plot: Polygon, angle: float, generator: np.random.Generator
) -> Scenery:
    """Add lawn, winding gravel paths, a pond and many trees."""
    x, y = plot.representative_point().coords[0]
    middle = np.array([x, y])
    t = np.linspace(-60, 60, 120)
    wave = 2.5 * np.sin(t / generator.uniform(5, 9) + generator.uniform(0, 6))
    lines = []
    for turn in (angle + 0.5, angle + 0.5 + generator.uniform(1.2, 1.9)):
        along, across = (
            np.array([np.cos(turn), np.sin(turn)]),
            np.array([-np.sin(turn), np.cos(turn)]),
        )
        lines.append(LineString(middle + t[:, None] * along + wave[:, None] * across))
    round_pond = Point(x, y).buffer(generator.uniform(6.5, 8.0))
    gravel = shapely.union_all([*[line.buffer(1.05) for line in lines], round_pond])
    lawn_edge = plot.buffer(-1.5)
    gravel = gravel.difference(round_pond.buffer(-2.0)).intersection(lawn_edge)
    pond = Point(x, y).buffer(3.6, quad_segs=24)
    if not plot.contains(round_pond):
        gravel, pond = gravel.difference(round_pond), Polygon()
    rest = lawn_edge.difference(shapely.union_all([gravel.buffer(1.0), round_pond]))
    trees = _scatter_trees(rest, 18, (2.0, 3.8), 5.0, generator) + _scatter_trees(
        rest, 14, (0.5, 1.1), 2.0, generator
    )
    return replace(
        scenery,
        gravel=scenery.gravel.union(gravel),
        ponds=scenery.ponds.union(pond),
        trees=(*scenery.trees, *trees),
        spare=(*scenery.spare, *_make_spare_rectangles(rest, angle, generator)),
    )


def _make_plaza(
    scenery: Scenery, plot: Polygon, angle: float, generator: np.random.Generator
) -> Scenery:
    """Add slabs with shrubs, a low flat roof and trees."""
    square = plot.buffer(-0.4)
    size = generator.uniform(12, 18), generator.uniform(9, 13)
    body = _fit_rectangle(square, size, angle, 3.0, generator)
    buildings, rest = [], square.buffer(-2.0)
    if body is not None:
        buildings = [Building(body[0], size, angle, generator.uniform(5, 8), True, 1)]
        rest = rest.difference(Polygon(body[1]).buffer(4.0))
    trees = _scatter_trees(rest, 16, (1.3, 2.2), 5.5, generator) + _scatter_trees(
        rest, 10, (0.6, 1.2), 3.0, generator
    )
    return replace(
        scenery,
        slabs=scenery.slabs.union(square.buffer(1.4)),
        buildings=(*scenery.buildings, *buildings),
        trees=(*scenery.trees, *trees),
        spare=(*scenery.spare, *_make_spare_rectangles(rest, angle, generator)),
    )


def _make_field(
    scenery: Scenery, plot: Polygon, angle: float, generator: np.random.Generator
) -> Scenery:
    """Add rough grass with bare soil, shrubs and a few trees."""
    soil = [
        _make_blob(spot, generator.uniform(2, 7), generator)
        for spot in _sample_points(plot, 5, 6.0, generator)
    ]
    rest = plot.buffer(-1.5)
    trees = _scatter_trees(rest, 7, (1.6, 3.2), 5.0, generator) + _scatter_trees(
        rest, 30, (0.4, 1.3), 1.4, generator
    )
    return replace(
        scenery,
        soil=scenery.soil.union(shapely.union_all(soil).intersection(plot)),
        trees=(*scenery.trees, *trees),
        spare=(*scenery.spare, *_make_spare_rectangles(rest, angle, generator)),
    )


def _make_blob(spot: Point, radius: float, generator: np.random.Generator) -> Polygon:
    """Make a patch with an uneven rim."""
    turn = np.linspace(0, 2 * np.pi, 49)[:-1]
    size = radius * np.ones(48)
    for wave in range(2, 8):
        size += (
            radius * generator.normal(0, 0.5 / wave) * np.cos(wave * turn + generator.uniform(0, 6))
        )
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
        if (
            len(points) < count
            and area.contains(spot)
            and all(spot.distance(o) > apart for o in points)
        ):
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


def _make_hedges(plot: Polygon, generator: np.random.Generator) -> list[Float[Array, "4 2"]]:
    """Make hedges along parts of a plot's rim."""
    inner = max(shapely.get_parts(plot.buffer(-1.1)), key=lambda part: part.area)
    rim, hedges = inner.exterior, []
    at = generator.uniform(0, 6)
    while at < rim.length - 4:
        long = min(generator.uniform(8, 22), rim.length - at)
        start, end = (np.array(rim.interpolate(d).coords[0]) for d in (at, at + long))
        if abs(np.hypot(*(end - start)) - long) < 0.3:
            hedges.append(make_bar(start, end, 0.55))
        at += long + generator.uniform(3, 9)
    return hedges


def _make_spare_rectangles(
    area: Geometry, angle: float, generator: np.random.Generator
) -> list[Float[Array, "4 2"]]:
    """Make rectangles of the size of a container or a tent."""
    rectangles = []
    for _ in range(2):
        size = generator.uniform(3.5, 7.0), generator.uniform(2.4, 3.5)
        body = _fit_rectangle(area, size, angle + generator.uniform(-0.3, 0.3), 0.5, generator)
        if body is not None:
            rectangles.append(body[1])
    return rectangles


PARCEL_MAKERS: dict[str, Callable[[Scenery, Polygon, float, np.random.Generator], Scenery]] = {
    "block": _make_block,
    "houses": _make_houses,
    "park": _make_park,
    "plaza": _make_plaza,
    "field": _make_field,
}
