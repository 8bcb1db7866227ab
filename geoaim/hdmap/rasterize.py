"""An HD map drawn as an image in the world, so that models read it as they read an AIM."""

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from shapely import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from geoaim.aim import AIM
from geoaim.geometry import transform_points
from geoaim.grid import north_up_grid
from geoaim.hdmap.drivable import NOT_DRIVEN, outline, points_along, polygons_of
from geoaim.hdmap.lanelet2 import HDMap, Lanelet, MapLine

Colour = tuple[int, int, int]
GROUND: Colour = (40, 42, 46)
ROAD: Colour = (98, 98, 104)
ARROW: Colour = (120, 190, 255)
SURFACES: dict[str, Colour] = {
    "walkway": (150, 140, 124),
    "shared_walkway": (150, 140, 124),
    "crosswalk": (206, 200, 180),
    "bicycle_lane": (160, 84, 78),
    "bikelane": (160, 84, 78),
    "parking": (112, 112, 132),
}
LINES: dict[str, tuple[Colour, float]] = {  # kind, or kind and subtype: colour and metres wide
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
    "stop_line": ((235, 60, 60), 0.4),
}
FINER = 4  # pixels that are drawn for one, each way
MARGIN = 10.0  # m around the map
SPACING = 12.0  # m between arrows along a lane
HEAD = 1.2  # m, of an arrow
LARGEST = 400_000_000  # pixels that are drawn: more is a map to be cut, or a wrong resolution


def draw_hdmap(hdmap: HDMap, *, resolution: float = 0.2) -> AIM:
    """The map as an image, north up, of so many metres a pixel.

    Surfaces lie below lines, lines below stop lines; arrows show the direction of lanes that may
    be driven one way only. The colours are `SURFACES`, `LINES`, `ROAD`, `ARROW` and `GROUND`.

    Raises:
        ValueError: the resolution is not positive, or the image would be absurdly large.
    """
    points = np.concatenate([line.points for line in hdmap.lines])
    corners = np.stack([points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN])
    wide, high = corners[1] - corners[0]
    if resolution > 0 and wide * high / resolution**2 > LARGEST / FINER**2:
        raise ValueError(
            f"at {resolution} m a pixel the image would have {wide * high / resolution**2:.3g} "
            f"pixels; the map is {wide:.0f} by {high:.0f} m"
        )
    grid = north_up_grid(corners, resolution, hdmap.world)
    fine_from_world = np.diag([FINER, FINER, 1.0]) @ grid.grid_from_world
    fine = np.full((grid.height * FINER, grid.width * FINER, 3), GROUND, np.uint8)
    for shape, colour in _drawn(hdmap):
        _fill(fine, shape, fine_from_world, colour)
    image = cv2.resize(fine, grid.shape[::-1], interpolation=cv2.INTER_AREA)
    return AIM.from_image(image, grid.world_from_grid, hdmap.world, "HD map")


def _fill(
    image: UInt8[Array, "H W 3"],
    area: BaseGeometry,
    image_from_world: Float[Array, "3 3"],
    colour: Colour,
) -> None:
    """Fill polygons with their holes, to the 1/256 of a pixel."""
    rings = [
        np.asarray(ring.coords)[:, :2]
        for polygon in polygons_of(area).geoms
        for ring in (polygon.exterior, *polygon.interiors)
    ]
    corners = [transform_points(image_from_world, ring) - 0.5 for ring in rings]
    fixed = [np.rint(points * 256).astype(np.int32) for points in corners]
    if fixed:
        cv2.fillPoly(image, fixed, colour, lineType=cv2.LINE_AA, shift=8)


def _drawn(hdmap: HDMap) -> Iterator[tuple[BaseGeometry, Colour]]:
    """What is drawn, the lowest first."""
    lanes = [lanelet for lanelet in hdmap.lanelets if lanelet.subtype not in NOT_DRIVEN]
    for area in hdmap.areas:
        yield area.shape, SURFACES.get(area.subtype, ROAD)
    for lanelet in hdmap.lanelets:
        if lanelet.subtype == "walkway":
            yield outline(lanelet), SURFACES["walkway"]
    for lanelet in lanes:
        yield outline(lanelet), ROAD
    for lanelet in hdmap.lanelets:
        if lanelet.subtype in NOT_DRIVEN and lanelet.subtype != "walkway":
            yield outline(lanelet), SURFACES.get(lanelet.subtype, SURFACES["walkway"])
    for style, (colour, wide) in LINES.items():
        for line in hdmap.lines:
            if _style(line) == style:
                yield LineString(line.points).buffer(wide / 2, cap_style="flat"), colour
    for lanelet in lanes:
        if lanelet.one_way:
            yield from ((arrow, ARROW) for arrow in _arrows(lanelet))


def _style(line: MapLine) -> str | None:
    both = f"{line.kind} {line.subtype}"
    return both if both in LINES else line.kind if line.kind in LINES else None


def _arrows(lanelet: Lanelet) -> Iterator[Polygon]:
    """Heads of arrows along the middle of a lane."""
    long = sum(LineString(line).length for line in (lanelet.left, lanelet.right)) / 2
    count = max(1, round(long / SPACING))
    shares = (np.arange(count) + 0.5) / count
    starts, ends = (
        points_along(lanelet, at).mean(axis=0) for at in (shares, np.minimum(shares + 0.02, 1.0))
    )
    for here, ahead in zip(starts, ends, strict=True):
        along = (ahead - here) / max(np.linalg.norm(ahead - here), 1e-9) * HEAD
        aside = np.array([-along[1], along[0]]) * 0.35
        yield Polygon([here + along / 2, here - along / 2 + aside, here - along / 2 - aside])
