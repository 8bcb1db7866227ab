"""How well HD maps match the AIM of their place: markings of the map, located in the image.

    python -m geoaim.bench.overlay --json docs/bench/overlay.json

The brightness across each line between lanes is averaged over each metre of it; the centroid of its
excess over the asphalt is where the paint is. Metres without a narrow bright peak, between dashes
or where paint is worn off, are not counted. Lines at kerbs and stop lines are left out, since maps
place these at the edge of the paint.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import shapely
import typer
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import LineString

import geoaim
from geoaim.aim import AIM
from geoaim.bench.report import JsonFile, print_rows, write_rows
from geoaim.geometry import transform_points
from geoaim.hdmap.drivable import find_drivable_area
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.synthetic import draw_place, make_place, world_from_image
from geoaim.synthetic.roads.lanelet import make_lanelet_map
from geoaim.synthetic.roads.layouts import STANDARD_KINDS, PlaceKind

MIN_SAMPLES = 20  # metres of paint for a statistic
REACH_M = 0.5  # to each side of a line
STEP_M = 0.02  # across a line
SAMPLES_PER_METRE = 10  # along a line
MAX_PAINT_WIDTH_M = 0.3
MIN_CONTRAST = 40.0  # grey levels over the asphalt
KERB_DISTANCE_M = 1.0  # from the area's edge: nearer lines are not between lanes
RESOLUTION = 0.1  # m a pixel of a drawn place


def measure_paint_offsets(aim: AIM, line: Float[Array, "n 2"]) -> Float[Array, "m"]:
    """Measure how far paint lies to the left of a line (m), in each metre where it is visible."""
    places, sides = _sample_across(line)
    pixels = transform_points(aim.grid.grid_from_world, places.reshape(-1, 2))
    u, v = (pixels - 0.5).astype(np.float32).T.reshape(2, *places.shape[:2])  # OpenCV's origin
    grey = cv2.cvtColor(aim.image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    values = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = values.reshape(-1, SAMPLES_PER_METRE, len(sides)).mean(axis=1)
    excess = values - np.median(values, axis=1, keepdims=True)
    peak = excess.max(axis=1, keepdims=True)
    paint = np.where(excess > peak / 2, excess, 0)
    offsets = (paint * sides).sum(axis=1) / paint.sum(axis=1).clip(1e-9)
    width = (paint > 0).sum(axis=1) * STEP_M
    return offsets[(peak[:, 0] > MIN_CONTRAST) & (width < MAX_PAINT_WIDTH_M)]


def _sample_across(line: Float[Array, "n 2"]) -> tuple[Float[Array, "m s 2"], Float[Array, "s"]]:
    """Points across a line at whole metres of samples, and their distances to its left."""
    curve = LineString(line)
    at = np.arange(0, curve.length, 1 / SAMPLES_PER_METRE)
    at = at[: len(at) // SAMPLES_PER_METRE * SAMPLES_PER_METRE]
    before, after = (
        shapely.get_coordinates(shapely.line_interpolate_point(curve, at + d)) for d in (-0.1, 0.1)
    )
    along = (after - before) / np.linalg.norm(after - before, axis=1, keepdims=True)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    sides = np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M)
    return (before + after)[:, None] / 2 + sides[:, None] * left[:, None], sides


def _measure_overlay(name: str, aim: AIM, hdmap: HDMap) -> dict[str, Any]:
    """Measure how far paint lies from the map's lines; no statistics where little is visible."""
    inner = find_drivable_area(hdmap).buffer(-KERB_DISTANCE_M)
    lines = [
        line.points
        for line in hdmap.lines
        if line.kind == "line_thin"
        and inner.contains(LineString(line.points).interpolate(0.5, normalized=True))
    ]
    offsets = [measure_paint_offsets(aim, line) for line in lines]
    pixels = np.concatenate([np.empty(0), *offsets]) / aim.resolution
    row = {"place": name, "m a pixel": aim.resolution, "places": len(pixels)}
    if len(pixels) < MIN_SAMPLES:
        return row
    return row | {
        "median, px": float(np.median(np.abs(pixels))),
        "95 %, px": float(np.percentile(np.abs(pixels), 95)),
        "to the left, median, px": float(np.median(pixels)),
    }


def draw_aim_and_map(kind: PlaceKind) -> tuple[AIM, HDMap]:
    """Draw a synthetic place as an AIM, and read its HD map from a file."""
    place = make_place(1, kind=kind)
    image = draw_place(place, resolution=RESOLUTION)
    aim = AIM.from_image(image, world_from_image(place, RESOLUTION), place.world, "drawn")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "map.osm"
        path.write_bytes(make_lanelet_map(place.roads, place.world_from_plan, place.world))
        return aim, read_hdmap(path, place.world)


def main(json: JsonFile = None) -> None:
    """Locate the lines of HD maps on the sample's AIM and on synthetic places of each kind."""
    built = geoaim.build_aim("samples/hover.mp4", "samples/gcps.csv")
    hdmap = read_hdmap("samples/map.osm", built.world)
    cases = [("sample, built of its video", built, hdmap)]
    cases += [(f"{kind}, drawn", *draw_aim_and_map(kind)) for kind in STANDARD_KINDS]
    rows = print_rows(_measure_overlay(*case) for case in cases)
    write_rows(rows, json, command="python -m geoaim.bench.overlay")


if __name__ == "__main__":
    typer.run(main)
