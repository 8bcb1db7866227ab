"""An HD map drawn as an image in the world, so that models read it as they read an AIM."""

from collections.abc import Iterator

import cv2
import numpy as np
from shapely import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from geoaim.aim import AIM
from geoaim.mapping.drivable import NOT_DRIVEN, fill_area, outline
from geoaim.mapping.hdmap import HDMap, Lanelet, MapLine

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
    low = np.floor((points.min(axis=0) - MARGIN) / resolution) * resolution
    size = np.ceil((points.max(axis=0) + MARGIN - low) / resolution)
    if not resolution > 0 or size.prod() * FINER**2 > LARGEST:
        raise ValueError(
            f"at {resolution} m a pixel the image would have {size.prod():.3g} pixels; the map is "
            f"{size[0] * resolution:.0f} by {size[1] * resolution:.0f} m"
        )
    width, height = size.astype(int)
    top = low[1] + height * resolution
    world_from_image = np.array([[resolution, 0, low[0]], [0, -resolution, top], [0, 0, 1]])
    fine_from_world = np.linalg.inv(world_from_image)[:2] * FINER
    fine = np.full((height * FINER, width * FINER, 3), GROUND, np.uint8)
    for shape, colour in _drawn(hdmap):
        fill_area(fine, shape, fine_from_world, colour)
    image = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    return AIM(
        image,
        world_from_image,
        hdmap.world,
        coverage=np.ones((height, width), np.uint16),
        contested=np.zeros((height, width), bool),
        report={"source": "HD map"},
    )


def _drawn(hdmap: HDMap) -> Iterator[tuple[BaseGeometry, Colour]]:
    """What is drawn, the lowest first."""
    lanes = [lanelet for lanelet in hdmap.lanelets if lanelet.subtype not in NOT_DRIVEN]
    for area in hdmap.areas:
        yield Polygon(area.points), SURFACES.get(area.subtype, ROAD)
    for lanelet in hdmap.lanelets:
        if lanelet.subtype == "walkway":
            yield outline(lanelet), SURFACES["walkway"]
    for lanelet in lanes:
        yield outline(lanelet), ROAD
    for lanelet in hdmap.lanelets:
        if lanelet.subtype in NOT_DRIVEN and lanelet.subtype != "walkway":
            yield outline(lanelet), SURFACES.get(lanelet.subtype, SURFACES["walkway"])
    known = [line for line in hdmap.lines if _style(line) is not None]
    for line in sorted(known, key=lambda line: list(LINES).index(_style(line) or "")):
        colour, wide = LINES[_style(line) or ""]
        yield LineString(line.points).buffer(wide / 2, cap_style="flat"), colour
    for lanelet in lanes:
        if lanelet.one_way:
            yield from ((arrow, ARROW) for arrow in _arrows(lanelet))


def _style(line: MapLine) -> str | None:
    both = f"{line.kind} {line.subtype}"
    return both if both in LINES else line.kind if line.kind in LINES else None


def _arrows(lanelet: Lanelet) -> Iterator[Polygon]:
    """Heads of arrows along the middle of a lane."""
    left, right = LineString(lanelet.left), LineString(lanelet.right)
    count = max(1, round((left.length + right.length) / 2 / SPACING))
    for share in (np.arange(count) + 0.5) / count:
        here, ahead = (
            np.mean([side.interpolate(x, normalized=True).coords[0] for side in (left, right)], 0)
            for x in (share, min(share + 0.02, 1.0))
        )
        along = (ahead - here) / max(np.linalg.norm(ahead - here), 1e-9) * HEAD
        aside = np.array([-along[1], along[0]]) * 0.35
        yield Polygon([here + along / 2, here - along / 2 + aside, here - along / 2 - aside])
