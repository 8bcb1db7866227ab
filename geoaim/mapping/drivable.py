"""Where vehicles may drive, by an HD map or a drawn polygon, and how far from its edge one is."""

import os
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from affine import Affine
from jaxtyping import Float
from numpy import ndarray as Array
from rasterio.features import rasterize
from shapely import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from geoaim.aim import north_up_grid
from geoaim.errors import MapError
from geoaim.geojson import Feature, read_features, write_features
from geoaim.mapping.hdmap import HDMap, Lanelet
from geoaim.world import World

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


def points_along(lanelet: Lanelet, shares: Float[Array, "n"]) -> Float[Array, "2 n 2"]:
    """Points of the left and of the right line at shares of their lengths."""
    sides = (
        shapely.line_interpolate_point(LineString(line), shares, normalized=True)
        for line in (lanelet.left, lanelet.right)
    )
    return np.stack([shapely.get_coordinates(points) for points in sides])


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
            long = max(LineString(line).length for line in (lanelet.left, lanelet.right))
            shares = np.linspace(0, 1, max(2, int(np.ceil(long / SPACING)) + 1))
            left, right = points_along(lanelet, shares)
            middle, wide = (left + right) / 2, np.linalg.norm(left - right, axis=1)
            ahead = np.gradient(middle, axis=0)
            places.append(middle)
            directions.append(np.arctan2(ahead[:, 1], ahead[:, 0]))
            reaches.append(np.hypot(wide / 2, SPACING / 2))
    return np.concatenate(places), np.concatenate(directions), np.concatenate(reaches)


def write_area(area: MultiPolygon, world: World, path: str | os.PathLike[str]) -> None:
    """Write an area as GeoJSON, in longitude and latitude, or in metres of a plane of its own."""
    write_features([Feature(area)], world, path)


def read_area(path: str | os.PathLike[str], world: World) -> MultiPolygon:
    """Read hand-drawn polygons, GeoJSON, as one area in the world.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: it is no GeoJSON with polygons.
    """
    parts = [feature.geometry for feature in read_features(path, world)]
    flat = [part for part in parts if isinstance(part, Polygon | MultiPolygon)]
    if not flat:
        kinds = ", ".join(sorted({part.geom_type for part in parts})) or "nothing"
        raise MapError(f"{path} holds {kinds}; polygons are needed")
    return polygons_of(shapely.union_all([shapely.make_valid(part) for part in flat]))


def signed_distance(area: MultiPolygon, *, resolution: float = 0.2) -> SignedDistance:
    """Distances on a grid of so many metres a cell, within `MARGIN` around the area.

    They are those to the nearest cell of a mask `FINER` times as fine, which is half a cell of
    the mask from the edge on average.
    """
    low, high = np.array(area.bounds).reshape(2, 2)
    world_from_grid, height, width = north_up_grid(
        np.stack([low - MARGIN, high + MARGIN]), resolution
    )
    fine = resolution / FINER
    placed = Affine(*world_from_grid[:2].ravel()) * Affine.scale(1 / FINER)
    mask = rasterize([area], (height * FINER, width * FINER), transform=placed, dtype=np.uint8)
    inside, outside = (
        cv2.distanceTransform(part, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for part in (mask, 1 - mask)
    )
    signed = np.where(mask > 0, 0.5 - inside, outside - 0.5) * fine
    metres = cv2.resize(signed.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    return SignedDistance(metres, np.linalg.inv(world_from_grid))


def _closed(area: BaseGeometry) -> MultiPolygon:
    return polygons_of(
        area.buffer(GAP / 2, join_style="mitre").buffer(-GAP / 2, join_style="mitre")
    )


def polygons_of(area: BaseGeometry) -> MultiPolygon:
    """The polygons of any geometry."""
    parts = shapely.get_parts(shapely.get_parts(np.atleast_1d(area)))
    return MultiPolygon([part for part in parts if isinstance(part, Polygon) and not part.is_empty])
