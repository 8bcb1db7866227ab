"""Pictures of the viewer's pages, of the bundled sample; needs Playwright and chromium.

python docs/screenshots.py AIM.tif docs/images
"""

import io
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import typer
from PIL import Image

import geoaim
from benchmarks.viewer import open_page
from geoaim.base.geometry import transform_points
from geoaim.base.world import world_from_lonlat
from geoaim.mapping.video.video import read_frame
from geoaim.tracks.changes import to_world
from geoaim.web.explore import Contents, make_map_view
from geoaim.web.picking.page import make_picking_view
from geoaim.web.picking.session import PickingTask

SAMPLES = Path("samples")
TIME_S = 14.0
NEAR_M = 60.0  # how far from the middle of the map the selected car may be
COMPLETE_S = 120.0
# every map has drawn all its tiles
DRAWN = """Promise.all([geoaim.map, geoaim.frame?.map, geoaim.imagery?.map].filter(Boolean).map(
    (map) => new Promise((done) => { map.once("rendercomplete", done); map.render(); })))"""
# the marks of infractions and the agent's view are there
LOADED = """(!geoaim.state?.tracks || Boolean(geoaim.marks))
    && [...document.images].every((image) => image.hidden || image.naturalWidth > 0)"""
PICKED = (0, 3, 5, 8, 12)  # of the sample's control points


def wait_until_complete(page: Any) -> None:
    """Wait until the page has loaded everything and its picture no longer changes."""
    page.evaluate(DRAWN)
    limit, last = time.monotonic() + COMPLETE_S, None
    while True:
        picture = page.screenshot()
        if picture == last and page.evaluate(LOADED):
            return
        if time.monotonic() > limit:
            raise TimeoutError(f"the page still changes after {COMPLETE_S:g} s")
        last = picture
        page.wait_for_timeout(500)


def save(page: Any, path: Path) -> None:
    """Save what a page shows as a JPEG."""
    wait_until_complete(page)
    Image.open(io.BytesIO(page.screenshot())).convert("RGB").save(path, quality=85)


def show_view(aim: Path, folder: Path) -> None:
    """Save the viewer's page with a car selected."""
    world = geoaim.read_aim(aim).world
    hdmap = geoaim.read_hdmap(SAMPLES / "map.osm", world)
    lights = geoaim.read_lights(SAMPLES / "lights.csv", hdmap.stop_lines, world)
    tracks = geoaim.read_tracks(SAMPLES / "tracks.csv")
    contents = Contents(tracks, lights, hdmap)
    with ExitStack() as stack, open_page(make_map_view(aim, contents, stack)) as page:
        step = int(np.searchsorted(tracks.times, TIME_S))
        states = to_world(tracks, world).states[:, step]
        middle = geoaim.read_aim(aim).corners.mean(axis=0)
        near = np.linalg.norm(states[:, :2] - middle, axis=1) < NEAR_M  # NaN where absent
        ego = tracks.ids[np.argmax(np.where(near, states[:, 3], 0))]
        page.evaluate(f"geoaim.timeline.set({TIME_S}); geoaim.select('{ego}')")
        page.evaluate("geoaim.view.setResolution(geoaim.view.getResolution() * 0.6)")
        save(page, folder / "view.jpg")


def show_picking(folder: Path) -> None:
    """Save the page of picking with some points."""
    imagery = geoaim.read_imagery(SAMPLES / "ortho.tif")
    frame = read_frame(geoaim.open_video(SAMPLES / "hover.mp4"), 0.0).image
    points = geoaim.read_control_points(SAMPLES / "gcps.csv")
    places = world_from_lonlat(imagery.world, points.coordinates)
    pixels = transform_points(np.linalg.inv(imagery.world_from_image), places)
    view = make_picking_view(PickingTask(frame, imagery=imagery), "control points")
    with open_page(view) as page:
        for index in PICKED:
            (u, v), (east, north) = points.pixels[index], pixels[index]
            ask = f"geoaim.ask({{action: 'add', name: '{points.names[index]}', u: {u}, v: {v}}})"
            move = f"{{action: 'move', id: reply.added, side: 'imagery', u: {east}, v: {north}}}"
            page.evaluate(f"{ask}.then((reply) => geoaim.ask({move}))")
        page.mouse.move(330, 300)
        save(page, folder / "pick.jpg")


def main(aim: Path, folder: Path) -> None:
    """Save pictures of the pages."""
    show_view(aim, folder)
    show_picking(folder)


if __name__ == "__main__":
    typer.run(main)
