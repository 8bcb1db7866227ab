"""Map layers of the viewer: an AIM, imagery, HD map, and places of points."""

from collections.abc import Callable
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16
from matplotlib.colors import to_hex
from numpy import ndarray as Array
from shapely import MultiPolygon

from geoaim.aim.aim import AIM
from geoaim.aim.files import OpenAIM
from geoaim.aim.rectification import rectify
from geoaim.base.grid import Grid
from geoaim.base.world import World, lonlat_from_world
from geoaim.hdmap.lanelet2 import HDMap
from geoaim.web.tiles import Colours, TiledRaster, tile_array, tile_file

CONTESTED_COLOUR, CONTESTED_HEX = (255, 0, 200, 170), "#ff00c8"
COVERAGE_COLOURS = (matplotlib.colormaps["magma"](np.arange(256))[:, :3] * 255).astype(np.uint8)
LINE_COLOURS = {  # keys: lanelet2's kinds of line
    "curbstone": "#7c4a03",
    "stop_line": "#c1121f",
    "zebra": "#f5f5f5",
    "zebra_marking": "#f5f5f5",
    "virtual": "#8888aa",
}
Description = dict[str, Any]


def colour_coverage(coverage: UInt16[Array, "h w"], most: float) -> Colours:
    """Colour the coverage; brightest at `most` frames."""
    shade = COVERAGE_COLOURS[np.clip(coverage * (255 / max(most, 1)), 0, 255).astype(np.uint8)]
    return np.dstack([shade, np.where(coverage > 0, 200, 0).astype(np.uint8)])


def colour_contested(contested: Bool[Array, "h w"]) -> Colours:
    """Colour pixels where the frames show no clear ground."""
    return np.array([(0, 0, 0, 0), CONTESTED_COLOUR], np.uint8)[contested.astype(np.intp)]


def colour_image(image: UInt8[Array, "h w 3"], mask: Bool[Array, "h w"]) -> Colours:
    """Make an image transparent where no frame saw the ground."""
    return np.dstack([image, mask * np.uint8(255)])


def is_north_up(grid: Grid) -> bool:
    """Whether pixels are squares whose sides go east and south."""
    matrix = grid.world_from_grid
    expected = np.array([[matrix[0, 0], 0.0], [0.0, -matrix[0, 0]], [0.0, 0.0]])
    return matrix[0, 0] > 0 and bool(np.array_equal(matrix[:, :2], expected))


def tile_aim(aim: AIM) -> dict[str, TiledRaster]:
    """Make tiles of an AIM in memory, by the paths of its layers."""
    if not is_north_up(aim.grid):
        aim = rectify(aim)
    layers = {
        "aim_image": colour_image(aim.image, aim.coverage > 0),
        "aim_contested": colour_contested(aim.contested),
        "aim_coverage": colour_coverage(aim.coverage, float(aim.coverage.max())),
    }
    return {path: tile_array(pixels, aim.grid) for path, pixels in layers.items()}


def tile_aim_file(file: OpenAIM, most: float) -> dict[str, TiledRaster]:
    """Make the tiles of `tile_aim` from an open AIM file, by its overviews."""
    layers: dict[str, Callable[..., Colours]] = {
        "aim_image": lambda **part: colour_image(file.read_image(**part), file.read_mask(**part)),
        "aim_contested": lambda **part: colour_contested(file.read_contested(**part)),
        "aim_coverage": lambda **part: colour_coverage(file.read_coverage(**part), most),
    }
    return {path: tile_file(read, file.grid) for path, read in layers.items()}


def describe_raster(name: str, path: str, raster: TiledRaster, **options: object) -> Description:
    """Describe tiles for the viewer, with options of its panel of layers (`colour`, `legend`)."""
    shown: Description = {"name": name, "path": path, "visible": True, "opacity": 1.0}
    return shown | raster.describe() | options


def describe_legend(most: float) -> Description:
    """Describe the colours of `colour_coverage`, from 0 to `most` frames."""
    # between nine colours the legend is linear
    chosen = COVERAGE_COLOURS[np.linspace(0, 255, 9).astype(int)]
    colours = [to_hex(tuple(colour)) for colour in chosen / 255]
    return {"from": 0, "to": round(most), "unit": "frames", "colours": colours}


def describe_lines(hdmap: HDMap) -> list[Description]:
    """Describe the lines of an HD map by their kind, in its world."""
    kinds: dict[str, list[list[list[float]]]] = {}
    for line in hdmap.lines:
        kinds.setdefault(line.kind, []).append(_round(line.points))
    shapes = []
    for kind, lines in sorted(kinds.items()):
        colour = LINE_COLOURS.get(kind, "#ffffff")
        dash = [4, 4] if kind == "virtual" else None
        name = kind.replace("_", " ") or "line"
        shown = {"name": name, "lines": lines, "colour": colour, "dash": dash, "visible": True}
        shapes.append(shown)
    return shapes


def describe_area(area: MultiPolygon) -> Description:
    """Describe a drivable area."""
    polygons = [
        [_round(np.array(ring.coords)) for ring in (polygon.exterior, *polygon.interiors)]
        for polygon in area.geoms
    ]
    colours = {"colour": "#1f6feb", "fill": "rgba(31, 111, 235, 0.22)"}
    return {"name": "drivable area", "polygons": polygons, "visible": False, **colours}


def describe_lonlat(world: World, points: Float[Array, "n 2"]) -> Description | None:
    """Fit longitude and latitude over the bounds of points by quadratics; None without a CRS."""
    if world.crs is None:
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    center, scale = (low + high) / 2, float(max(high - low) / 2)
    line = np.linspace(-1.0, 1.0, 9)  # places at which longitude and latitude are fitted
    u, v = (axis.ravel() for axis in np.meshgrid(line, line))
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    lonlat = lonlat_from_world(world, center + scale * np.stack([u, v], axis=1))
    coefficients = np.linalg.lstsq(terms, lonlat, rcond=None)[0].T
    return {"center": center.tolist(), "scale": scale, "coefficients": coefficients.tolist()}


def _round(points: Float[Array, "n 2"]) -> list[list[float]]:
    rounded: list[list[float]] = np.round(points, 3).tolist()
    return rounded
