"""Does an HD map lie on the AIM of its place? Markings of the map, looked for in the picture.

    python -m geoaim.bench.overlay --json docs/bench/overlay.json

Across each line between lanes, the brightness of each metre of it is read; its excess over the
asphalt has its middle where the paint is. Between dashes, and where paint is worn off, nothing
narrow stands out, and nothing is counted. Lines at kerbs and stop lines are left out: maps put
these at the paint's edge.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np
import shapely
import typer
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import LineString

import geoaim
from geoaim.aim import AIM
from geoaim.bench.report import format_table, write_rows
from geoaim.geometry import transform_points
from geoaim.hdmap.drivable import find_drivable_area
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.synthetic import draw_place, make_place, world_from_image
from geoaim.synthetic.roads.lanelet import make_lanelet_map
from geoaim.synthetic.roads.layouts import STANDARD_KINDS, PlaceKind

FEWEST = 20  # places for a figure
REACH = 0.5  # m to each side
STEP = 0.02  # m
SAMPLES = 10  # in a metre along a line
WIDEST = 0.3  # m, of paint
STANDS_OUT = 40.0  # grey levels over the asphalt
KERB = 1.0  # m from the area's edge, where lines are not between lanes
RESOLUTION = 0.1  # m a pixel of a drawn place


def across(aim: AIM, line: Float[Array, "n 2"]) -> Float[Array, "m"]:
    """How far the paint lies to the left of the line, metres, in each metre in which it is seen."""
    way = LineString(line)
    at = np.arange(0, way.length, 1 / SAMPLES)
    at = at[: len(at) // SAMPLES * SAMPLES]
    here, ahead = (
        shapely.get_coordinates(shapely.line_interpolate_point(way, at + d)) for d in (-0.1, 0.1)
    )
    along = (ahead - here) / np.linalg.norm(ahead - here, axis=1, keepdims=True)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    sides = np.arange(-REACH, REACH + STEP / 2, STEP)
    places = (here + ahead)[:, None] / 2 + sides[:, None] * left[:, None]
    pixels = transform_points(np.linalg.inv(aim.world_from_image), places.reshape(-1, 2))
    u, v = (pixels - 0.5).astype(np.float32).T.reshape(2, len(at), len(sides))  # OpenCV's origin
    grey = cv2.cvtColor(aim.image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    seen = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen = seen.reshape(-1, SAMPLES, len(sides)).mean(axis=1)
    excess = seen - np.median(seen, axis=1, keepdims=True)
    peak = excess.max(axis=1, keepdims=True)
    paint = np.where(excess > peak / 2, excess, 0)
    found = (paint * sides).sum(axis=1) / paint.sum(axis=1).clip(1e-9)
    wide = (paint > 0).sum(axis=1) * STEP
    return found[(peak[:, 0] > STANDS_OUT) & (wide < WIDEST)]


def row(name: str, aim: AIM, hdmap: HDMap) -> dict[str, Any]:
    """How far the paint lies from the map's lines, in pixels of the background."""
    inner = find_drivable_area(hdmap).buffer(-KERB)
    lines = [
        line.points
        for line in hdmap.lines
        if line.kind == "line_thin"
        and inner.contains(LineString(line.points).interpolate(0.5, normalized=True))
    ]
    pixel = aim.resolution
    apart = np.concatenate([np.empty(0), *(across(aim, line) for line in lines)]) / pixel
    if len(apart) < FEWEST:
        return {"place": name, "m a pixel": pixel, "places": len(apart)}
    return {
        "place": name,
        "m a pixel": pixel,
        "places": len(apart),
        "median, px": float(np.median(np.abs(apart))),
        "95 %, px": float(np.percentile(np.abs(apart), 95)),
        "to the left, median, px": float(np.median(apart)),
    }


def drawn(kind: PlaceKind) -> tuple[AIM, HDMap]:
    """A place's picture, which lies where the place does, and its HD map by way of a file."""
    place = make_place(1, kind=kind)
    image = draw_place(place, resolution=RESOLUTION)
    aim = AIM.from_image(image, world_from_image(place, RESOLUTION), place.world, "drawn")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "map.osm"
        path.write_bytes(make_lanelet_map(place.roads, place.world_from_plan, place.world))
        return aim, read_hdmap(path, place.world)


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
) -> None:
    """Look for the HD maps' lines on the sample's AIM and on drawn places of each kind."""
    built = geoaim.build_aim("samples/hover.mp4", "samples/gcps.csv")
    rows = [row("sample, built of its video", built, read_hdmap("samples/map.osm", built.world))]
    rows += [row(f"{kind}, drawn", *drawn(kind)) for kind in STANDARD_KINDS]
    print(format_table(rows))
    write_rows(rows, json, command="python -m geoaim.bench.overlay")


if __name__ == "__main__":
    typer.run(main)
