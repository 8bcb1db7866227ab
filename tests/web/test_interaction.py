"""The viewer answers real clicks, drags and keys."""

import io
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

import geoaim
from geoaim.prediction.futures import Futures
from geoaim.web.explore import make_map_view
from tests.web.browser import open_view, serve, wait_for

LINE = (0, 194, 255)


@pytest.fixture
def shown(page, view):
    with serve(view) as address:
        open_view(page, address)
        yield page


def take_picture(page):
    return np.array(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), float)


def locate(page, east, north):
    """Where a point of the world is on the screen."""
    page.evaluate("geoaim.map.renderSync()")
    return page.evaluate(f"geoaim.map.getPixelFromCoordinate([{east}, {north}])")


def cut_picture(page, place):
    """The colours around a place of the screen."""
    x, y = map(round, place)
    return take_picture(page)[y - 4 : y + 5, x - 4 : x + 5]


def measure_distance(page, place, colour):
    """How far the nearest colour around a place of the screen is from a colour, grey levels."""
    return np.abs(cut_picture(page, place) - colour).max(axis=2).min()


def find_colour(page, place, colour, seconds=20):
    """Wait until a colour is seen at a place of the screen."""
    for _ in range(10 * seconds):
        if measure_distance(page, place, colour) < 40:
            return True
        page.wait_for_timeout(100)
    return False


def test_the_measured_line_is_seen_with_north_up_and_turned(shown):
    for turn in (0.0, 0.5):
        shown.evaluate(f"geoaim.view.setRotation({turn})")
        shown.get_by_label("measure").check()
        shown.mouse.click(300, 300)
        shown.mouse.move(400, 350)
        shown.mouse.move(500, 400)
        wait_for(shown, "document.querySelector('.status').textContent.endsWith(' m')")
        assert find_colour(shown, (400, 350), LINE), turn
        shown.get_by_label("measure").uncheck()


def test_futures_are_drawn_at_their_times_and_of_predicted_agents_alone(page, aim, contents):
    scene = geoaim.make_scene(aim, contents.tracks)
    states = torch.zeros(2, len(scene.ids), 40, 4)
    states[..., :2] = torch.tensor([180.0, 240.0])  # all agents rest, but for the first one
    states[0, 0, :, 1] += torch.linspace(0.0, 40.0, 40)
    futures = Futures(states, scene, start=90, dt=0.1)
    view = make_map_view(aim, replace(contents, futures=futures), ExitStack())
    assert [agent["id"] for agent in view.description["moving"]["futures"]["agents"]] == [
        scene.ids[0]
    ]
    with serve(view) as address:
        open_view(page, address)
        wait_for(page, "Boolean(geoaim.timeline)")
        assert page.evaluate("geoaim.timeline.time") == 9
        assert page.get_by_text("futures, 9 to 13 s").is_visible()
        place = locate(page, 180, 270)
        page.evaluate("geoaim.timeline.set(0)")
        page.evaluate("geoaim.map.renderSync()")
        empty = cut_picture(page, place)
        for time, expected in ((9, True), (2, False), (12, True), (16, False)):
            page.evaluate(f"geoaim.timeline.set({time})")
            page.evaluate("geoaim.map.renderSync()")
            assert (np.abs(cut_picture(page, place) - empty).max() > 15) == expected, time


def test_space_plays_before_and_after_a_click_on_a_layer(shown):
    wait_for(shown, "Boolean(geoaim.timeline)")
    shown.keyboard.press("Space")
    assert shown.evaluate("geoaim.timeline.playing")
    box = shown.get_by_label("contested")
    box.click()
    shown.keyboard.press("Space")
    assert not shown.evaluate("geoaim.timeline.playing")
    assert box.is_checked()
    shown.locator(".play").click()
    shown.keyboard.press("Space")
    assert not shown.evaluate("geoaim.timeline.playing")


def test_a_control_that_was_reached_by_the_keyboard_keeps_its_keys(shown):
    box = shown.get_by_label("contested")
    box.focus()
    shown.keyboard.press("Tab")
    shown.keyboard.press("Shift+Tab")
    shown.keyboard.press("Space")
    assert box.is_checked()
    assert not shown.evaluate("geoaim.timeline.playing")


def test_a_click_on_a_mark_shows_its_agent_large_and_in_the_middle(shown):
    wait_for(shown, "document.querySelectorAll('.mark').length > 0")
    before = shown.evaluate("geoaim.view.getResolution()")
    # marks may cover each other, so the event is sent to the element itself
    shown.locator(".mark").first.dispatch_event("click")
    agent = shown.evaluate("[geoaim.state.selected.id, geoaim.state.selected.length]")
    mark = shown.evaluate("geoaim.marks[0]")
    assert agent[0] == mark["agent"]
    assert shown.evaluate("geoaim.timeline.time") == pytest.approx(mark["time"])
    resolution = shown.evaluate("geoaim.view.getResolution()")
    assert resolution < before
    assert agent[1] / resolution > 5  # its length in pixels
    found = shown.evaluate(
        "(() => { const [x, y] = geoaim.view.getCenter();"
        "return geoaim.map.getPixelFromCoordinate([x, y]); })()"
    )
    size = shown.evaluate("geoaim.map.getSize()")
    assert found == pytest.approx([size[0] / 2, size[1] / 2], abs=1)


def test_a_map_that_was_turned_by_hand_stays_so_when_an_agent_is_selected(shown):
    shown.evaluate("geoaim.view.setRotation(0.3); geoaim.select(geoaim.state.tracks.agents[0].id)")
    assert shown.evaluate("geoaim.view.getRotation()") == pytest.approx(0.3)


def test_the_swipe_is_a_line_that_can_be_dragged(shown, aim):
    line = shown.locator(".swipe")
    assert not line.is_visible()
    shown.get_by_label("swipe between the two").check()
    middle = line.bounding_box()["x"] + 1.5
    assert middle == pytest.approx(500, abs=3)
    shown.mouse.move(middle, 500)
    shown.mouse.down()
    shown.mouse.move(300, 500, steps=4)
    shown.mouse.up()
    assert line.bounding_box()["x"] + 1.5 == pytest.approx(300, abs=2)
    east, north = (aim.world_from_image @ [440.0, 640.0, 1.0])[:2]
    x, y = locate(shown, east, north)
    assert x > 300  # the map, where the imagery was before
    assert find_colour(shown, (x, y), (640 % 256, 440 % 256, 1080 % 256))
    assert take_picture(shown)[200, 300].min() > 200  # the white line
    line.focus()
    shown.keyboard.press("ArrowRight")
    assert line.bounding_box()["x"] > 302


def test_frames_per_pixel_have_a_legend(shown):
    legend = shown.locator(".legend")
    assert not legend.is_visible()
    shown.get_by_label("frames per pixel").check()
    assert legend.is_visible()
    assert " ".join(legend.inner_text().split()) == "0 40 frames"


def test_imagery_is_moved_by_hand_and_says_how_far(shown, aim):
    east, north = (aim.world_from_image @ [440.0, 640.0, 1.0])[:2]
    colour = 255 - np.array([640 % 256, 440 % 256, 1080 % 256])
    shown.get_by_label("AIM", exact=True).uncheck()
    shown.get_by_label("tracks", exact=True).uncheck()
    x, y = locate(shown, east, north)
    assert find_colour(shown, (x, y), colour)
    shown.get_by_label("move imagery by hand").check()
    shown.mouse.move(x, y)
    shown.mouse.down()
    shown.mouse.move(x + 40, y - 20, steps=4)
    assert find_colour(shown, (x + 40, y - 20), colour)  # while it is dragged
    shown.mouse.up()
    assert find_colour(shown, (x + 40, y - 20), colour)
    assert locate(shown, east, north) == pytest.approx([x, y], abs=0.5)  # the map stays
    metres = shown.evaluate("geoaim.view.getResolution()")
    text = shown.locator(".moved").text_content()
    moved = [float(number) for number in text.removeprefix("geoaim align --shift ").split(",")]
    assert moved == pytest.approx([40 * metres, 20 * metres], abs=0.02)
    shown.keyboard.press("ArrowRight")
    text = shown.locator(".moved").text_content()
    assert float(text.split()[-1].split(",")[0]) == pytest.approx(moved[0] + 0.1, abs=0.011)
    shown.get_by_label("move imagery by hand").uncheck()
    shown.mouse.move(x, y)
    shown.mouse.down()
    shown.mouse.move(x + 30, y, steps=4)
    shown.mouse.up()
    assert locate(shown, east, north)[0] > x + 10  # the map moves again
