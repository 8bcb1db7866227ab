"""Where vehicles may drive, by an HD map or a drawn polygon, and how far from its edge one is."""

import os
import warnings

import cv2
import numpy as np
import shapely
from affine import Affine
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array
from rasterio.features import rasterize
from shapely import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from geoaim.errors import GeoaimWarning, MapError
from geoaim.geojson import Feature, read_features, write_features
from geoaim.grid import Grid, north_up_grid
from geoaim.hdmap.lanelet2 import HDMap, Lanelet
from geoaim.world import World

NOT_DRIVEN = ("walkway", "crosswalk", "stairs", "bicycle_lane", "bikelane", "shared_walkway")
DRIVEN_AREAS = ("parking",)
GAP = 0.3  # m: gaps between lanes that are narrower are driven over
FINER = 4  # cells of the mask in one of the distance, each way
SPACING = 1.0  # m between places along a lane
MARGIN = 20.0  # m around the area in which distances are told
SMALLEST = 0.1  # m² of a drawn area: degrees taken for metres enclose less
MOST = 9_000_000  # cells of the distance: about a gigabyte while it is made


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
    parks = [a.shape for a in hdmap.areas if a.subtype in DRIVEN_AREAS]
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
        MapError: it is no GeoJSON with polygons, or they enclose nothing.
    """
    parts = [feature.geometry for feature in read_features(path, world)]
    flat = [part for part in parts if isinstance(part, Polygon | MultiPolygon)]
    if not flat:
        kinds = ", ".join(sorted({part.geom_type for part in parts})) or "nothing"
        raise MapError(f"{path} holds {kinds}; polygons are needed")
    area = polygons_of(shapely.union_all([shapely.make_valid(part) for part in flat]))
    if not area.area > SMALLEST:
        raise MapError(
            f"{path} encloses {area.area:.1g} m², and more than {SMALLEST} m² are needed; its "
            f"numbers are taken for {'metres' if world.crs is None else 'longitude and latitude'}"
        )
    return area


def signed_distance(
    area: MultiPolygon, *, resolution: float = 0.2
) -> tuple[Float32[Array, "H W"], Grid]:
    """Distance from the edge of an area, on a grid of so many metres a cell around it.

    A distance is that to the nearest cell of a mask `FINER` times as fine, which is half a cell
    of the mask from the edge on average. Cells are coarser where there would be more than `MOST`.

    Args:
        area: metres in some world.
        resolution: metres a cell.

    Returns:
        Metres at the middles of the cells, positive outside the area and negative inside; and the
        grid, which reaches `MARGIN` beyond the area.

    Raises:
        MapError: the area is empty, or too narrow for a cell of the mask.
    """
    if area.is_empty:
        raise MapError("the area is empty; polygons are needed")
    low, high = np.array(area.bounds).reshape(2, 2)
    resolution = _affordable(high - low + 2 * MARGIN, resolution)
    grid = north_up_grid(np.stack([low - MARGIN, high + MARGIN]), resolution)
    fine = resolution / FINER
    placed = Affine(*grid.world_from_grid[:2].ravel()) * Affine.scale(1 / FINER)
    size = grid.height * FINER, grid.width * FINER
    mask = rasterize([area], size, transform=placed, dtype=np.uint8)
    if not mask.any():
        raise MapError(f"the area is narrower than {fine:g} m; draw it wider, or take finer cells")
    outside, inside = (_distance(part, grid.height, grid.width) for part in (1 - mask, mask))
    return (outside - inside) * np.float32(fine), grid


def _affordable(size: Float[Array, "2"], resolution: float) -> float:
    least = float(np.sqrt(size.prod() / MOST))
    if not 0 < resolution < least:
        return resolution
    warnings.warn(
        f"{size[0]:.0f} x {size[1]:.0f} m are too large for distances every {resolution:g} m; "
        f"they are told every {least:.2g} m. Cut the area to what the tracks need",
        GeoaimWarning,
        stacklevel=3,
    )
    return least


def _distance(mask: UInt8[Array, "h w"], height: int, width: int) -> Float32[Array, "H W"]:
    """Cells of the mask to its edge, 0 beyond it, averaged over a coarser grid's cells."""
    found = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    np.subtract(found, 0.5, out=found, where=mask > 0)
    coarse = cv2.resize(found, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(coarse, np.float32)


def _closed(area: BaseGeometry) -> MultiPolygon:
    return polygons_of(
        area.buffer(GAP / 2, join_style="mitre").buffer(-GAP / 2, join_style="mitre")
    )


def polygons_of(area: BaseGeometry) -> MultiPolygon:
    """The polygons of any geometry."""
    parts = shapely.get_parts(shapely.get_parts(np.atleast_1d(area)))
    return MultiPolygon([part for part in parts if isinstance(part, Polygon) and not part.is_empty])
