"""The viewer in a browser: time to the first picture, and pictures a second while it plays.

    python -m benchmarks.viewer --json docs/bench/viewer.json

A map of 100 megapixels is opened from its file, a 4K frame for picking, and 200 agents play for ten
minutes' tracks at 10 Hz. Needs Playwright and Debian's chromium, or another one by CHROMIUM, which
draws without a graphics card. Times of pages are those of the browser, from the request on.
"""

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import UInt8
from numpy import ndarray as Array

from benchmarks.results import JsonFile, Row, print_rows, write_rows
from geoaim.aim.aim import AIM
from geoaim.aim.files import write_aim
from geoaim.base.world import World
from geoaim.tracks.tracks import Tracks
from geoaim.web.explore import Contents, make_map_view
from geoaim.web.map_view import MapView
from geoaim.web.picking.page import make_picking_view
from geoaim.web.picking.session import PickingTask
from geoaim.web.server import ViewServer

RESOLUTION_M = 0.05
AGENTS, DURATION_S, RATE_HZ = 200, 600.0, 10.0
PAINTED = "performance.getEntriesByName('geoaim-painted')[0]?.startTime"
TIMEOUT_S, PLAYED_S = 120.0, 5.0


def make_texture(height: int, width: int) -> UInt8[Array, "H W 3"]:
    """Make a picture with detail of all sizes and little noise, as imagery has."""
    generator = np.random.default_rng(0)
    total = np.zeros((height, width, 3), np.float32)
    for side in (16, 128, 1024):
        coarse = generator.uniform(0, 80, (side, side, 3)).astype(np.float32)
        total += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(total, 0, 255).astype(np.uint8)


def _make_map(side: int) -> AIM:
    matrix = np.diag([RESOLUTION_M, -RESOLUTION_M, 1.0])
    return AIM.from_image(make_texture(side, side), matrix, World("EPSG:32635"), "benchmark")


def _make_tracks(side_m: float) -> Tracks:
    """Make agents that drive circles over the map all the time."""
    generator = np.random.default_rng(1)
    times = np.arange(0.0, DURATION_S, 1 / RATE_HZ)
    radius = generator.uniform(5.0, side_m / 4, (AGENTS, 1))
    angle = generator.uniform(0.0, 6.28, (AGENTS, 1)) + 8.0 * times / radius
    centre = generator.uniform(side_m / 4, 3 * side_m / 4, (AGENTS, 2, 1))
    x = centre[:, 0] + radius * np.cos(angle)
    y = -centre[:, 1] + radius * np.sin(angle)
    heading = (angle + np.pi / 2 + np.pi) % (2 * np.pi) - np.pi
    states = np.stack([x, y, heading, np.full_like(x, 8.0)], -1)
    names = tuple(map(str, range(AGENTS)))
    return Tracks(
        times=times,
        states=states,
        present=np.ones(x.shape, bool),
        sizes=np.tile([4.5, 1.9], (AGENTS, 1)),
        types=("car",) * AGENTS,
        ids=names,
        world=World("EPSG:32635"),
    )


@contextmanager
def open_page(view: MapView) -> Iterator[Any]:
    """Open a view in a browser; the page (of Playwright) has been painted once."""
    from playwright.sync_api import sync_playwright

    path = os.environ.get("CHROMIUM") or shutil.which("chromium")
    with ViewServer(view) as server, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(server.address)
        _wait(lambda: page.evaluate(f"Boolean(window.geoaim) && {PAINTED} > 0"))
        yield page
        browser.close()


def _wait(is_true: Callable[[], bool]) -> None:
    end = time.monotonic() + TIMEOUT_S
    while not is_true():
        if time.monotonic() > end:
            raise TimeoutError(f"the page was not painted within {TIMEOUT_S:g} s")
        time.sleep(0.02)


def _time_painting(case: str, make: Callable[[ExitStack], MapView], repeats: int) -> Row:
    """Time making a view and painting its page, seconds; medians."""
    opened, painted = [], []
    for _ in range(repeats):
        with ExitStack() as stack:
            begin = time.perf_counter()
            view = make(stack)
            opened.append(time.perf_counter() - begin)
            with open_page(view) as page:
                painted.append(float(page.evaluate(PAINTED)) / 1e3)
    total = median(a + b for a, b in zip(opened, painted, strict=True))
    return {"case": case, "open_s": median(opened), "paint_s": median(painted), "total_s": total}


def _count_pictures(view: MapView) -> Row:
    """Count the pictures a second while tracks play, and while the view follows an agent.

    The search for infractions, whose time is in the row too, is over by then.
    """
    rates: dict[str, float] = {}
    with open_page(view) as page:
        begin = time.perf_counter()
        _wait(lambda: bool(page.evaluate("Boolean(geoaim.marks)")))
        rates["infractions_s"] = time.perf_counter() - begin
        for name, act in (
            ("playing", "0"),
            ("following", "geoaim.select('0'); geoaim.follow(true)"),
        ):
            page.evaluate(act)
            page.evaluate("geoaim.timeline.set(1); geoaim.timeline.toggle(true)")
            page.wait_for_timeout(1000)
            first = page.evaluate("[geoaim.agentsLayer.framesDrawn, performance.now()]")
            page.wait_for_timeout(1000 * PLAYED_S)
            last = page.evaluate("[geoaim.agentsLayer.framesDrawn, performance.now()]")
            page.evaluate("geoaim.timeline.toggle(false)")
            rates[f"{name}_per_s"] = 1e3 * (last[0] - first[0]) / (last[1] - first[1])
    return {"case": f"{AGENTS} agents, {DURATION_S / 60:g} minutes at {RATE_HZ:g} Hz", **rates}


def main(
    json_path: JsonFile = None,
    side: Annotated[int, typer.Option(help="of the large map, px", min=512)] = 10_000,
    repeats: Annotated[int, typer.Option(help="of each timing", min=1)] = 3,
) -> None:
    """Time the viewer in a browser."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.tif"
        write_aim(_make_map(side), path)
        frame = PickingTask(make_texture(2160, 3840))
        rows = [
            _time_painting(
                f"map of {side**2 / 1e6:g} megapixels",
                lambda stack: make_map_view(path, Contents(), stack),
                repeats,
            ),
            _time_painting(
                "4K frame to pick on", lambda _: make_picking_view(frame, "frame"), repeats
            ),
        ]
        with ExitStack() as stack:
            tracks = _make_tracks(side * RESOLUTION_M)
            rows.append(_count_pictures(make_map_view(path, Contents(tracks), stack)))
    print_rows(rows)
    write_rows(rows, json_path, command="python -m benchmarks.viewer --json docs/bench/viewer.json")


if __name__ == "__main__":
    typer.run(main)
