"""The drivable area and the lane directions of an HD map, and drivable areas drawn by hand."""

import os
from typing import TYPE_CHECKING

import numpy as np
import shapely
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array
from shapely import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from geoaim.base.errors import MapError, warn
from geoaim.base.geojson import read_features
from geoaim.base.grid import Grid, make_north_up_grid
from geoaim.base.world import World, world_from_crs
from geoaim.hdmap.lanelet2 import HDMap, Lanelet

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


NOT_DRIVABLE = ("walkway", "crosswalk", "stairs", "bicycle_lane", "bikelane", "shared_walkway")
MAX_GAP_M = 0.3  # narrower gaps between lanes count as drivable
LANE_SPACING_M = 1.0  # distance between points along a lane
MIN_AREA_M2 = 0.1  # smallest area that may be drawn: degrees taken for metres enclose less


def outline_lanelet(lanelet: Lanelet) -> Polygon:
    """Make the polygon between the borders of a lanelet; several where it crosses itself."""
    ring = Polygon(np.concatenate([lanelet.left, lanelet.right[::-1]]))
    return ring if ring.is_valid else shapely.make_valid(ring)


def sample_borders(lanelet: Lanelet, shares: Float[Array, "n"]) -> Float[Array, "2 n 2"]:
    """Sample the left and the right border of a lanelet at shares (0 to 1) of their lengths."""
    sides = (
        shapely.line_interpolate_point(LineString(line), shares, normalized=True)
        for line in (lanelet.left, lanelet.right)
    )
    return np.stack([shapely.get_coordinates(points) for points in sides])


def find_drivable_area(hdmap: HDMap) -> MultiPolygon:
    """Unite the lanes and car parks of a map, in metres; gaps up to `MAX_GAP_M` are closed.

    Raises:
        MapError: the map has no lane for vehicles.
    """
    lanes = [outline_lanelet(x) for x in hdmap.lanelets if x.subtype not in NOT_DRIVABLE]
    parks = [area.shape for area in hdmap.areas if area.subtype == "parking"]
    if not lanes:
        subtypes = sorted({lanelet.subtype for lanelet in hdmap.lanelets})
        raise MapError(f"the map has no lane for vehicles, only {', '.join(subtypes)}")
    area = shapely.union_all([shapely.make_valid(part) for part in lanes + parks])
    half = MAX_GAP_M / 2
    return to_polygons(area.buffer(half, join_style="mitre").buffer(-half, join_style="mitre"))


def sample_lane_directions(
    hdmap: HDMap,
) -> tuple[Float[Array, "m 2"], Float[Array, "m"], Float[Array, "m"]]:
    """Sample the directions of one-way lanes for vehicles.

    Returns:
        (m, 2) points about `LANE_SPACING_M` apart along the middles of lanes (m), (m,) directions
        there (rad), and (m,) the radius around each point (m) that covers its piece of the lane.
    """
    points, directions, reaches = [np.empty((0, 2))], [np.empty(0)], [np.empty(0)]
    for lanelet in hdmap.lanelets:
        if lanelet.one_way and lanelet.subtype not in NOT_DRIVABLE:
            length = max(LineString(line).length for line in (lanelet.left, lanelet.right))
            shares = np.linspace(0, 1, max(2, int(np.ceil(length / LANE_SPACING_M)) + 1))
            left, right = sample_borders(lanelet, shares)
            middle, width = (left + right) / 2, np.linalg.norm(left - right, axis=1)
            tangent = np.gradient(middle, axis=0)
            points.append(middle)
            directions.append(np.arctan2(tangent[:, 1], tangent[:, 0]))
            reaches.append(np.hypot(width / 2, LANE_SPACING_M / 2))
    return np.concatenate(points), np.concatenate(directions), np.concatenate(reaches)


def read_drivable_area(
    path: "str | os.PathLike[str] | BaseGeometry | GeoDataFrame", world: World
) -> MultiPolygon:
    """Read polygons drawn by hand as one area, in metres of the world.

    Args:
        path: GeoJSON (see `read_features`); or an object: a geometry of shapely, in metres of the
            world, or a GeoDataFrame, in its own CRS (without one in metres of the world).
        world: the plane of the area.

    Raises:
        FileNotFoundError: there is no such file.
        MapError: it is not GeoJSON with polygons, or they enclose nothing.
        GeoreferenceError: only one of the world and the GeoDataFrame has a CRS.
    """
    parts = _read_shapes(path, world)
    path = path if isinstance(path, str | os.PathLike) else f"the {type(path).__name__}"
    polygons = [part for part in parts if isinstance(part, Polygon | MultiPolygon)]
    if not polygons:
        kinds = ", ".join(sorted({part.geom_type for part in parts})) or "nothing"
        raise MapError(f"{path} holds {kinds}; polygons are needed")
    area = to_polygons(shapely.union_all([shapely.make_valid(part) for part in polygons]))
    if not area.area > MIN_AREA_M2:
        unit = "metres" if world.crs is None else "longitude and latitude"
        raise MapError(
            f"{path} encloses {area.area:.1g} m², and more than {MIN_AREA_M2} m² are needed; its "
            f"numbers are taken for {unit}"
        )
    return area


def _read_shapes(
    source: "str | os.PathLike[str] | BaseGeometry | GeoDataFrame", world: World
) -> list[BaseGeometry]:
    """The shapes of a file or an object, in metres of the world."""
    if isinstance(source, BaseGeometry):
        return [source]
    if isinstance(source, str | os.PathLike):
        return [feature.geometry for feature in read_features(source, world)]
    shapes = list(source.geometry)
    if source.crs is None:
        return shapes
    crs = source.crs.to_string()
    return [shapely.transform(x, lambda points: world_from_crs(world, points, crs)) for x in shapes]


def to_polygons(geometry: BaseGeometry) -> MultiPolygon:
    """Select the polygons among the parts of any geometry; lines and points are dropped."""
    parts = shapely.get_parts(shapely.get_parts(np.atleast_1d(geometry)))
    return MultiPolygon([part for part in parts if isinstance(part, Polygon) and not part.is_empty])


SUPERSAMPLING = 4  # cells of the mask in one of the distance, each way
MARGIN_M = 20.0  # distance from the area to the edges of the grid
MAX_CELLS = 9_000_000  # about a gigabyte of memory during the computation


def compute_signed_distance(
    area: MultiPolygon, *, resolution: float
) -> tuple[Float32[Array, "H W"], Grid]:
    """Compute the distance to the edge of an area, on a grid of `resolution` metres per cell.

    Distances are measured to the nearest cell of a mask `SUPERSAMPLING` times as fine, less half
    such a cell. For more than `MAX_CELLS`, cells are made coarser, with a warning.

    Returns:
        (H, W) metres at the centres of cells, positive outside the area and negative inside; and
        the north-up grid, which reaches `MARGIN_M` beyond the area.

    Raises:
        MapError: the area is empty, or too narrow for a cell of the mask.
    """
    from affine import Affine
    from rasterio.features import rasterize

    if area.is_empty:
        raise MapError("the area is empty; polygons are needed")
    low, high = np.array(area.bounds).reshape(2, 2)
    resolution = _limit_resolution(high - low + 2 * MARGIN_M, resolution)
    grid = make_north_up_grid(np.stack([low - MARGIN_M, high + MARGIN_M]), resolution)
    cell = resolution / SUPERSAMPLING
    transform = Affine(*grid.world_from_grid[:2].ravel()) * Affine.scale(1 / SUPERSAMPLING)
    shape = grid.height * SUPERSAMPLING, grid.width * SUPERSAMPLING
    mask = rasterize([area], shape, transform=transform, dtype=np.uint8)
    if not mask.any():
        raise MapError(f"the area is narrower than {cell:g} m; draw it wider, or take finer cells")
    outside, inside = (_measure_distance(part, grid) for part in (1 - mask, mask))
    return (outside - inside) * np.float32(cell), grid


def _limit_resolution(size: Float[Array, "2"], resolution: float) -> float:
    """The resolution, or a coarser one at which the size has at most `MAX_CELLS`."""
    finest = float(np.sqrt(size.prod() / MAX_CELLS))
    if not 0 < resolution < finest:
        return resolution
    warn(
        f"{size[0]:.0f} x {size[1]:.0f} m are too large for distances every {resolution:g} m; "
        f"they are computed every {finest:.2g} m. Cut the area to what the tracks need"
    )
    return finest


def _measure_distance(mask: UInt8[Array, "h w"], grid: Grid) -> Float32[Array, "H W"]:
    """Cells of the mask to its edge, 0 beyond it, averaged over the cells of the grid."""
    import cv2

    distance = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    np.subtract(distance, 0.5, out=distance, where=mask > 0)
    coarse = cv2.resize(distance, grid.shape[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(coarse, np.float32)
