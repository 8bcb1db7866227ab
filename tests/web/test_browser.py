"""The viewer in a real browser."""

import io
import json
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import geoaim
from geoaim.web.explore import Contents, make_map_view
from geoaim.web.map_view import write_html
from tests.waiting import wait_until
from tests.web.browser import open_view, serve, wait_for


def read_colour(page, x, y):
    """Mean colour of a few pixels of a screenshot."""
    picture = np.array(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), float)
    return picture[y - 3 : y + 4, x - 3 : x + 4].mean(axis=(0, 1))


@pytest.fixture
def shown(page, view):
    with serve(view) as address:
        open_view(page, address)
        yield page


def test_it_paints_the_map_where_it_lies(shown, aim):
    for u, v in ((300.0, 700.0), (1000.0, 200.0)):
        east, north = (aim.world_from_image @ [u, v, 1.0])[:2]
        x, y = shown.evaluate(f"geoaim.map.getPixelFromCoordinate([{east}, {north}])")
        # the gradient of the picture in red and green; blue wraps
        expected = np.array([v % 256, u % 256])
        found = read_colour(shown, round(x), round(y))[:2]
        assert np.abs(found - expected).max() < 12


def test_it_plays_and_seeks(shown):
    shown.evaluate("geoaim.timeline.set(9)")
    shown.keyboard.press("Tab")
    shown.evaluate("document.querySelector('.geoaim').focus()")
    shown.keyboard.press("Space")
    wait_for(shown, "geoaim.timeline.time > 9.3")
    shown.keyboard.press("Space")
    assert not shown.evaluate("geoaim.timeline.playing")


def test_a_click_selects_an_agent_and_following_turns_its_heading_up(shown, contents):
    tracks = contents.tracks
    present = tracks.present[:, 90]
    speeds = np.where(present, tracks.states[:, 90, 3], 0)
    row = int(np.argmax(speeds))
    x, y, heading = tracks.states[row, 90, :3]
    shown.evaluate("geoaim.timeline.set(9)")
    pixel = shown.evaluate(f"geoaim.map.getPixelFromCoordinate([{x}, {y}])")
    shown.mouse.click(*pixel)
    wait_for(shown, "geoaim.state.selected !== null")
    assert shown.evaluate("geoaim.state.selected.id") == tracks.ids[row]
    shown.locator(".selection input").check()
    assert shown.evaluate("geoaim.view.getCenter()") == pytest.approx([x, y], abs=0.01)
    assert shown.evaluate("geoaim.view.getRotation()") == pytest.approx(heading - np.pi / 2)
    wait_for(shown, "document.querySelector('.agent-view').naturalWidth === 48")


def test_layers_switch_on_and_off(shown, aim):
    east, north = (aim.world_from_image @ [440.0, 320.0, 1.0])[:2]  # contested
    x, y = shown.evaluate(f"geoaim.map.getPixelFromCoordinate([{east}, {north}])")
    before = read_colour(shown, round(x), round(y))
    shown.get_by_label("contested").check()

    def is_redder():
        after = read_colour(shown, round(x), round(y))
        return after[0] > before[0] + 50 and after[1] < before[1] - 30

    wait_until(is_redder, "the contested part is red")


def test_the_swipe_shows_imagery_on_one_side(shown, aim):
    shown.get_by_label("swipe between the two").check()

    def is_inverted(u):
        east, north = (aim.world_from_image @ [u, 640.0, 1.0])[:2]
        x, y = shown.evaluate(f"geoaim.map.getPixelFromCoordinate([{east}, {north}])")
        red = read_colour(shown, round(x), round(y))[0]
        return abs(red - (255 - 640 % 256)) < abs(red - 640 % 256)

    wait_until(lambda: is_inverted(200.0) + is_inverted(1000.0) == 1, "one side is inverted")


def test_the_address_restores_the_view(shown):
    shown.evaluate("geoaim.timeline.set(12.5); geoaim.view.setZoom(geoaim.view.getZoom() + 1)")
    shown.evaluate("geoaim.view.setCenter([150, 250])")
    wait_for(shown, "location.hash.includes('time=12.50') && location.hash.includes('x=150')")
    resolution = shown.evaluate("geoaim.view.getResolution()")
    shown.reload()
    wait_for(shown, "Boolean(window.geoaim)")
    assert shown.evaluate("geoaim.timeline.time") == pytest.approx(12.5)
    assert shown.evaluate("geoaim.view.getCenter()") == pytest.approx([150, 250], abs=0.01)
    assert shown.evaluate("geoaim.view.getResolution()") == pytest.approx(resolution, rel=1e-3)


def test_one_html_file_shows_it_without_a_server(page, view, tmp_path):
    write_html(view, tmp_path / "view.html")
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    open_view(page, (tmp_path / "view.html").as_uri())
    assert page.evaluate("geoaim.state.tracks.agents.length") > 10
    assert all(url.startswith(("file:", "blob:", "data:")) for url in asked)


MARKUP = "</script><img src=x onerror=\"document.body.dataset.acted='yes'\">\u202e${1}"


def test_markup_in_ids_types_and_file_names_is_shown_as_text(page, aim, contents, tmp_path):
    given = contents.tracks
    tracks = replace(given, ids=(MARKUP, *given.ids[1:]), types=(MARKUP,) * len(given.types))
    path = tmp_path / f"{MARKUP.replace('/', '')}.tif"
    geoaim.write_aim(aim, path)
    with ExitStack() as stack:
        view = make_map_view(path, Contents(tracks=tracks), stack)
        write_html(view, tmp_path / "view.html")
        with serve(view) as address:
            for place in (address, (tmp_path / "view.html").as_uri()):
                open_view(page, place)
                page.evaluate(f"geoaim.select({json.dumps(MARKUP)})")
                assert page.evaluate("document.body.innerText").count("onerror") > 0
                assert page.title() == path.name
                assert page.evaluate("document.body.dataset.acted") is None
                assert page.evaluate("document.querySelector('img[src=x]')") is None
