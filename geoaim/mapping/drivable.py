"""Where vehicles may drive, by an HD map or a drawn polygon, and how far from its edge one is."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import shapely
from affine import Affine
from jaxtyping import Float
from numpy import ndarray as Array
from rasterio.features import rasterize
from shapely import LineString, MultiPolygon, Polygon
from shapely.geometry import shape
from shapely.geometry.base import BaseGeometry

from geoaim.errors import MapError
from geoaim.files import replacing
from geoaim.mapping.hdmap import HDMap, Lanelet
from geoaim.world import World, lonlat_from_world, world_from_lonlat

NOT_DRIVEN = ("walkway", "crosswalk", "stairs", "bicycle_lane", "bikelane", "shared_walkway")
DRIVEN_AREAS = ("parking",)
GAP = 0.3  # m: gaps between lanes that are narrower are driven over
FINER = 4  # cells of the mask in one of the distance, each way
SPACING = 1.0  # m between places along a lane
MARGIN = 20.0  # m around the area in which distances are told


@dataclass(frozen=True, eq=False)
class SignedDistance:
    """How far points are from the edge of the drivable area.

    Attributes:
        metres: (H, W) at the middles of cells: positive outside, negative inside.
        image_from_world: (3, 3) metres to cells (corner origin).
    """

    metres: Float[Array, "H W"]
    image_from_world: Float[Array, "3 3"]


def outline(lanelet: Lanelet) -> Polygon:
    """The ground between a lanelet's lines."""
    ring = Polygon(np.concatenate([lanelet.left, lanelet.right[::-1]]))
    return ring if ring.is_valid else shapely.make_valid(ring)


def drivable_area(hdmap: HDMap) -> MultiPolygon:
    """Lanes and car parks of the map as one area, without the gaps between lanes.

    Raises:
        MapError: the map has no lane for vehicles.
    """
    lanes = [outline(x) for x in hdmap.lanelets if x.subtype not in NOT_DRIVEN]
    parks = [Polygon(a.points) for a in hdmap.areas if a.subtype in DRIVEN_AREAS]
    if not lanes:
        kinds = sorted({lanelet.subtype for lanelet in hdmap.lanelets})
        raise MapError(f"the map has no lane for vehicles, only {', '.join(kinds)}")
    return _closed(shapely.union_all([shapely.make_valid(part) for part in lanes + parks]))


def lane_directions(
    hdmap: HDMap,
) -> tuple[Float[Array, "m 2"], Float[Array, "m"], Float[Array, "m"]]:
    """Places along one-way lanes, the directions there, and how far to the side the lane goes."""
    places, directions, reaches = [np.empty((0, 2))], [np.empty(0)], [np.empty(0)]
    for lanelet in hdmap.lanelets:
        if lanelet.one_way and lanelet.subtype not in NOT_DRIVEN:
            left, right = LineString(lanelet.left), LineString(lanelet.right)
            count = max(2, int(np.ceil(max(left.length, right.length) / SPACING)) + 1)
            shares = np.linspace(0, 1, count)
            sides = [
                shapely.get_coordinates(shapely.line_interpolate_point(x, shares, normalized=True))
                for x in (left, right)
            ]
            middle, half = (sides[0] + sides[1]) / 2, np.linalg.norm(sides[0] - sides[1], axis=1)
            ahead = np.gradient(middle, axis=0)
            places.append(middle)
            directions.append(np.arctan2(ahead[:, 1], ahead[:, 0]))
            reaches.append(np.hypot(half / 2, SPACING / 2))
    return np.concatenate(places), np.concatenate(directions), np.concatenate(reaches)


def write_area(area: MultiPolygon, world: World, path: str | os.PathLike[str]) -> None:
    """Write an area as GeoJSON, in longitude and latitude, or in metres of a plane of its own."""
    moved = shapely.transform(
        area, lambda points: points if world.crs is None else lonlat_from_world(world, points)
    )
    feature = {"type": "Feature", "properties": {}, "geometry": shapely.geometry.mapping(moved)}
    with replacing(Path(path)) as temporary:
        collection = {"type": "FeatureCollection", "features": [feature]}
        Path(temporary).write_text(json.dumps(collection), encoding="utf-8")


def read_area(path: str | os.PathLike[str], world: World) -> MultiPolygon:
    """Read hand-drawn polygons, GeoJSON, as one area in the world.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: it is no GeoJSON with polygons.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        features = content.get("features", [content])
        parts = [shape(feature.get("geometry", feature)) for feature in features]
    except (ValueError, TypeError, KeyError, AttributeError, shapely.errors.ShapelyError) as error:
        raise MapError(f"{path} is no GeoJSON: {error}") from error
    flat = [part for part in parts if isinstance(part, Polygon | MultiPolygon)]
    if not flat:
        kinds = ", ".join(sorted({part.geom_type for part in parts})) or "nothing"
        raise MapError(f"{path} holds {kinds}; polygons are needed")
    whole = shapely.union_all([shapely.make_valid(part) for part in flat])
    if world.crs is not None:
        whole = shapely.transform(whole, lambda points: world_from_lonlat(world, points))
    return _polygons(whole)


def signed_distance(area: MultiPolygon, *, resolution: float = 0.2) -> SignedDistance:
    """Distances on a grid of so many metres a cell, within `MARGIN` around the area.

    They are those to the nearest cell of a mask `FINER` times as fine, which is half a cell of
    the mask from the edge on average.
    """
    low = np.floor((np.array(area.bounds[:2]) - MARGIN) / resolution) * resolution
    high = np.array(area.bounds[2:]) + MARGIN
    width, height = np.ceil((high - low) / resolution).astype(int)
    top = low[1] + height * resolution
    fine = resolution / FINER
    placed = Affine(fine, 0, low[0], 0, -fine, top)
    mask = rasterize([area], (height * FINER, width * FINER), transform=placed, dtype=np.uint8)
    inside, outside = (
        cv2.distanceTransform(part, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for part in (mask, 1 - mask)
    )
    signed = np.where(mask > 0, 0.5 - inside, outside - 0.5) * fine
    metres = cv2.resize(signed.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    image_from_world = np.array(
        [
            [1 / resolution, 0, -low[0] / resolution],
            [0, -1 / resolution, top / resolution],
            [0, 0, 1],
        ]
    )
    return SignedDistance(metres, image_from_world)


def fill_area(
    image: Array,
    area: BaseGeometry,
    image_from_world: Float[Array, "2 3"],
    colour: tuple[int, int, int],
) -> None:
    """Fill polygons with their holes, to the 1/256 of a pixel."""
    rings = [
        ring for polygon in _polygons(area).geoms for ring in (polygon.exterior, *polygon.interiors)
    ]
    matrix = image_from_world
    corners = [
        np.asarray(ring.coords)[:, :2] @ matrix[:2, :2].T + matrix[:2, 2] - 0.5 for ring in rings
    ]
    fixed = [np.rint(points * 256).astype(np.int32) for points in corners]
    if fixed:
        cv2.fillPoly(image, fixed, colour, lineType=cv2.LINE_AA, shift=8)


def _closed(area: BaseGeometry) -> MultiPolygon:
    return _polygons(area.buffer(GAP / 2, join_style="mitre").buffer(-GAP / 2, join_style="mitre"))


def _polygons(area: BaseGeometry) -> MultiPolygon:
    """The polygons of any geometry."""
    parts = shapely.get_parts(shapely.get_parts(np.atleast_1d(area)))
    return MultiPolygon([part for part in parts if isinstance(part, Polygon) and not part.is_empty])
