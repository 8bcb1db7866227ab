"""HD maps drawn as images in the world, which models read as they read an AIM."""

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from shapely import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from geoaim.aim.aim import AIM
from geoaim.base.errors import MapError
from geoaim.base.geometry import transform_points
from geoaim.base.grid import make_north_up_grid
from geoaim.hdmap.drivable import NOT_DRIVABLE, outline_lanelet, sample_borders, to_polygons
from geoaim.hdmap.lanelet2 import HDMap, Lanelet

Colour = tuple[int, int, int]
GROUND: Colour = (40, 42, 46)
ROAD: Colour = (98, 98, 104)
SURFACES: dict[str, Colour] = {
    "walkway": (150, 140, 124),
    "shared_walkway": (150, 140, 124),
    "crosswalk": (206, 200, 180),
    "bicycle_lane": (160, 84, 78),
    "bikelane": (160, 84, 78),
    "parking": (112, 112, 132),
}
LINES: dict[str, tuple[Colour, float]] = {  # kind, or kind and subtype: colour, width in m
    "virtual": ((78, 78, 90), 0.15),
    "curbstone": ((235, 170, 60), 0.2),
    "road_border": ((235, 170, 60), 0.2),
    "guard_rail": ((235, 170, 60), 0.2),
    "line_thin": ((245, 245, 245), 0.15),
    "line_thick": ((245, 245, 245), 0.3),
    "line_thin dashed": ((170, 170, 176), 0.15),
    "line_thick dashed": ((170, 170, 176), 0.3),
    "pedestrian_marking": ((206, 200, 180), 0.15),
    "zebra": ((206, 200, 180), 0.15),
    "zebra_marking": ((206, 200, 180), 0.15),
    "stop_line": ((235, 60, 60), 0.4),
}
SUPERSAMPLING = 4  # pixels that are drawn for one, each way
MARGIN_M = 10.0  # distance from the map to the edges of the image
MAX_DRAWN_PIXELS = 400_000_000  # beyond this, the map should be cut, or the resolution is wrong


def draw_hdmap(hdmap: HDMap, *, resolution: float = 0.2) -> AIM:
    """Draw an HD map as a north-up image in the map's world, `resolution` metres per pixel.

    Surfaces are painted first, then lines, then stop lines; arrows show the direction of one-way
    lanes. The colours are the constants of this module. Each pixel has a coverage of 1.

    Raises:
        ValueError: the resolution is not positive.
        MapError: the image would be too large.
        AimError: the image would have more than 30,000 pixels a side.
    """
    points = np.concatenate([line.points for line in hdmap.lines])
    corners = np.stack([points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M])
    width, height = corners[1] - corners[0]
    pixels = width * height / max(resolution, 1e-9) ** 2
    if resolution > 0 and pixels > MAX_DRAWN_PIXELS / SUPERSAMPLING**2:
        raise MapError(
            f"at {resolution} m a pixel the map of {width:.0f} by {height:.0f} m would have "
            f"{pixels:.3g} pixels; give a coarser resolution, or cut the map"
        )
    grid = make_north_up_grid(corners, resolution, hdmap.world)
    fine_from_world = np.diag([SUPERSAMPLING, SUPERSAMPLING, 1.0]) @ grid.grid_from_world
    fine = np.full((grid.height * SUPERSAMPLING, grid.width * SUPERSAMPLING, 3), GROUND, np.uint8)
    for shape, colour in _list_shapes(hdmap):
        _fill_polygons(fine, shape, fine_from_world, colour)
    image = cv2.resize(fine, grid.shape[::-1], interpolation=cv2.INTER_AREA)
    return AIM.from_image(image, grid.world_from_grid, hdmap.world, "HD map")


def _fill_polygons(
    image: UInt8[Array, "H W 3"],
    area: BaseGeometry,
    image_from_world: Float[Array, "3 3"],
    colour: Colour,
) -> None:
    """Fill polygons with their holes, to the 1/256 of a pixel."""
    rings = [
        np.asarray(ring.coords)[:, :2]
        for polygon in to_polygons(area).geoms
        for ring in (polygon.exterior, *polygon.interiors)
    ]
    corners = [transform_points(image_from_world, ring) - 0.5 for ring in rings]
    fixed = [np.rint(points * 256).astype(np.int32) for points in corners]
    if fixed:
        cv2.fillPoly(image, fixed, colour, lineType=cv2.LINE_AA, shift=8)


def _list_shapes(hdmap: HDMap) -> Iterator[tuple[BaseGeometry, Colour]]:
    """Shapes and their colours, the lowest first."""
    lanes = [lanelet for lanelet in hdmap.lanelets if lanelet.subtype not in NOT_DRIVABLE]
    for area in hdmap.areas:
        yield area.shape, SURFACES.get(area.subtype, ROAD)
    for lanelet in hdmap.lanelets:
        if lanelet.subtype == "walkway":
            yield outline_lanelet(lanelet), SURFACES["walkway"]
    for lanelet in lanes:
        yield outline_lanelet(lanelet), ROAD
    for lanelet in hdmap.lanelets:
        if lanelet.subtype in NOT_DRIVABLE and lanelet.subtype != "walkway":
            yield outline_lanelet(lanelet), SURFACES.get(lanelet.subtype, SURFACES["walkway"])
    for style, (colour, width) in LINES.items():
        for line in hdmap.lines:
            full = f"{line.kind} {line.subtype}"
            if style == (full if full in LINES else line.kind):
                yield LineString(line.points).buffer(width / 2, cap_style="flat"), colour
    for lanelet in lanes:
        if lanelet.one_way:
            yield from ((arrow, (120, 190, 255)) for arrow in _make_arrows(lanelet))


def _make_arrows(lanelet: Lanelet) -> Iterator[Polygon]:
    """Arrow heads along the middle of a lane."""
    length = sum(LineString(line).length for line in (lanelet.left, lanelet.right)) / 2
    count = max(1, round(length / 12.0))  # an arrow each 12 m
    shares = (np.arange(count) + 0.5) / count
    starts, ends = (
        sample_borders(lanelet, at).mean(axis=0) for at in (shares, np.minimum(shares + 0.02, 1.0))
    )
    for start, end in zip(starts, ends, strict=True):
        along = (end - start) / max(np.linalg.norm(end - start), 1e-9) * 1.2
        across = np.array([-along[1], along[0]]) * 0.35
        yield Polygon([start + along / 2, start - along / 2 + across, start - along / 2 - across])
