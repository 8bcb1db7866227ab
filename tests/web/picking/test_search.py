"""The search for pairs goes on while points are picked."""

import threading
from dataclasses import replace
from pathlib import Path

import pytest

from geoaim.imagery.mosaic import read_imagery
from geoaim.mapping.video.video import open_video, read_frame
from geoaim.web.picking import page as searched
from geoaim.web.picking.candidates import PairCandidate
from geoaim.web.picking.page import STAGES, find_pairs, make_picking_view
from geoaim.web.picking.session import PickingTask, open_session
from tests.web.browser import open_view, serve, wait_for

SAMPLES = Path(__file__).parents[3] / "samples"


@pytest.fixture(scope="module")
def task():
    frame = read_frame(open_video(SAMPLES / "hover.mp4"), 0.0).image
    return PickingTask(frame, imagery=read_imagery(SAMPLES / "ortho.tif"))


@pytest.fixture
def slow_search(monkeypatch):
    """A search that is two thirds done, and ends when it is told to."""
    may_end = threading.Event()

    def search(session, progress):
        progress("refine", 2, 2)
        may_end.wait(60)
        place = session.task.imagery.world_from_image @ [50.0, 40.0, 1.0]
        return (PairCandidate((300.0, 200.0), (place[0], place[1]), 0.1),)

    monkeypatch.setattr(searched, "find_pairs", search)
    yield may_end
    may_end.set()


def test_points_are_picked_while_pairs_are_searched(page, task, slow_search):
    with serve(make_picking_view(task, "sample")) as address:
        open_view(page, address)
        page.get_by_label("snap clicks to corners").uncheck()
        button = page.get_by_role("button", name="Propose pairs")
        button.click()
        wait_for(page, "!document.querySelector('.searching').hidden")
        assert page.evaluate("document.querySelector('.searching progress').value") == 2
        assert page.locator(".searching").inner_text().startswith("searching, ")
        assert button.is_disabled()
        page.mouse.click(250, 200)
        wait_for(page, "geoaim.state.points.length === 1")
        slow_search.set()
        wait_for(page, "geoaim.state.candidates.length === 1")
        wait_for(page, "document.querySelector('.searching').hidden")
        assert button.is_enabled()
        assert page.evaluate("geoaim.state.points.length") == 1


def test_a_search_without_points_says_what_it_needs(task):
    view = make_picking_view(task, "sample")
    reply = view.call({"action": "propose"})
    while "search" in reply:
        reply = view.call({"action": "proposed"})
    assert reply == {"error": "pairs are proposed from the second point on; pick two first"}
    assert "points" in view.call({"action": "proposed"})  # no search goes on
    with pytest.raises(ValueError, match="no imagery was given"):
        find_pairs(open_session(replace(task, imagery=None)))


def test_the_stages_of_a_search_are_those_that_matching_reports(place):
    from tests.web.picking.test_candidates import make_rough_georeference, propose_pairs

    frame, imagery, _ = place
    seen = []
    propose_pairs(
        frame,
        imagery,
        make_rough_georeference(place, 0),
        progress=lambda stage, done, total: seen.append((stage, done / total)),
    )
    assert tuple(dict(seen)) == STAGES
    assert dict(seen) == dict.fromkeys(STAGES, 1.0)


def test_undo_works_after_a_button_and_after_a_slider(page, task):
    with serve(make_picking_view(task, "sample")) as address:
        open_view(page, address)
        page.get_by_label("snap clicks to corners").uncheck()
        for count, control in enumerate(("button", "slider", "checkbox"), 1):
            page.evaluate(f"geoaim.ask({{action: 'add', u: {100 * count}, v: 100}})")
            wait_for(page, "geoaim.state.points.length === 1")
            if control == "button":
                page.get_by_role("button", name="Fit").click()
            elif control == "slider":
                page.get_by_label("frame over imagery").click()
            else:
                page.get_by_label("snap clicks to corners").click()
            page.keyboard.press("Control+z")
            wait_for(page, "geoaim.state.points.length === 0")


def test_undo_in_a_text_field_is_that_of_the_text(page, task):
    with serve(make_picking_view(task, "sample")) as address:
        open_view(page, address)
        page.evaluate("geoaim.ask({action: 'add', u: 100, v: 100})")
        field = page.locator("table.points input").first
        field.click()
        field.press("End")
        field.type("x")
        field.press("Control+z")
        assert page.evaluate("geoaim.state.points.length") == 1


def read_lens(page):
    """A pixel of the imagery's lens, just beside its cross."""
    lens = "document.querySelectorAll('.lens')[1].getContext('2d').getImageData(78, 78, 1, 1)"
    return page.evaluate(f"Array.from({lens}.data)")[:3]


def test_the_lens_shows_what_is_under_the_pointer_after_a_zoom_and_a_turn(page, task):
    with serve(make_picking_view(task, "sample")) as address:
        open_view(page, address)
        box = page.locator(".sides .map").nth(1).bounding_box()
        x, y = round(0.4 * box["width"]), round(0.4 * box["height"])
        page.mouse.move(box["x"] + x - 3, box["y"] + y)
        page.mouse.move(box["x"] + x, box["y"] + y)
        view = "geoaim.imagery.map.getView()"
        for change in (f"{view}.setResolution(0.1)", "geoaim.imagery.turn(40)"):
            page.evaluate(change)
            drawn = "geoaim.imagery.map.once('rendercomplete', () => (window.drawn = true))"
            page.evaluate(f"window.drawn = false; {drawn}; geoaim.imagery.map.render()")
            wait_for(page, "window.drawn")
            u, v = page.evaluate(f"geoaim.imagery.map.getCoordinateFromPixel([{x} + 1, {y} + 1])")
            row, column = int(-v), int(u)
            around = task.imagery.image[row - 2 : row + 3, column - 2 : column + 3].astype(int)
            found = read_lens(page)
            assert (around.min(axis=(0, 1)) - 8 <= found).all(), change
            assert (around.max(axis=(0, 1)) + 8 >= found).all(), change
