from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import geoaim
from geoaim.aim.aim import AIM
from geoaim.web.explore import Contents, make_map_view
from tests.waiting import LIMIT_S
from tests.web.browser import SERVERS

SAMPLES = Path(__file__).parents[2] / "samples"


@pytest.fixture(scope="session")
def aim():
    """A map of 1200 x 900 px around the sample's tracks, with a hole and a contested part."""
    world = geoaim.read_tracks(SAMPLES / "tracks.csv").world
    rows, columns = np.mgrid[:900, :1200]
    image = np.stack([rows % 256, columns % 256, (rows + columns) % 256], -1).astype(np.uint8)
    coverage = np.full((900, 1200), 40, np.uint16)
    coverage[:50, :60] = 0
    contested = np.zeros((900, 1200), bool)
    contested[300:340, 400:480] = True
    matrix = np.array([[0.2, 0.0, 60.0], [0.0, -0.2, 330.0], [0.0, 0.0, 1.0]])
    return AIM(image, matrix, world, coverage, contested)


@pytest.fixture(scope="session")
def contents(aim):
    hdmap = geoaim.read_hdmap(SAMPLES / "map.osm", aim.world)
    return Contents(
        tracks=geoaim.read_tracks(SAMPLES / "tracks.csv"),
        lights=geoaim.read_lights(SAMPLES / "lights.csv", hdmap.stop_lines, aim.world),
        hdmap=hdmap,
        imagery=replace(aim, image=255 - aim.image),
    )


@pytest.fixture(scope="session")
def view(aim, contents):
    return make_map_view(aim, contents, ExitStack())


@pytest.fixture(scope="module")
def browser(chromium):
    """A browser for the tests of a file, since it takes longer to start than most of them."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        arguments = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(
            executable_path=chromium, args=arguments, timeout=1000 * LIMIT_S
        )
        yield browser
        browser.close()


@pytest.fixture
def page(browser):
    """An empty page; a script's error fails the test."""
    errors = []
    page = browser.new_page(viewport={"width": 1000, "height": 700})
    page.set_default_timeout(1000 * LIMIT_S)
    # once the server is closed, what the page still asks for fails
    page.on("pageerror", lambda error: errors.extend([error] * bool(SERVERS)))
    yield page
    page.context.close()
    assert not errors
