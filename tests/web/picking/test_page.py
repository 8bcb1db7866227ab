"""Picking by real clicks and drags in a browser."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import geoaim
from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import transform_points
from geoaim.base.world import world_from_lonlat
from geoaim.imagery.mosaic import read_imagery
from geoaim.mapping.georeference.control_points import select_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import world_from_pixels
from geoaim.mapping.video.video import open_video, read_frame
from geoaim.web.picking.actions import handle
from geoaim.web.picking.candidates import PairCandidate
from geoaim.web.picking.page import draw_overlay, find_pairs, make_picking_view
from geoaim.web.picking.session import PickingTask, open_session
from tests.web.browser import open_view, serve, wait_for

SAMPLES = Path(__file__).parents[3] / "samples"
CHOSEN = [0, 2, 5, 8, 11, 14]  # of the sample's control points


@pytest.fixture(scope="module")
def task():
    frame = read_frame(open_video(SAMPLES / "hover.mp4"), 0.0).image
    return PickingTask(frame, imagery=read_imagery(SAMPLES / "ortho.tif"))


@pytest.fixture(scope="module")
def truth(task):
    """The chosen control points, and their pixels on the imagery."""
    points = select_points(geoaim.read_control_points(SAMPLES / "gcps.csv"), CHOSEN)
    places = world_from_lonlat(task.imagery.world, points.coordinates)
    return points, transform_points(np.linalg.inv(task.imagery.world_from_image), places)


def aim_at(page, side, pixel):
    """Bring a pixel of a side to the middle, at 100 screen pixels each; its place on the screen."""
    u, v = pixel
    view = f"geoaim.{side}.map.getView()"
    page.evaluate(f"{view}.setCenter([{u}, {-v}]); {view}.setResolution(0.01)")
    page.evaluate(f"geoaim.{side}.map.renderSync()")
    box = page.locator(".sides .map").nth(("frame", "imagery").index(side)).bounding_box()
    x, y = page.evaluate(f"geoaim.{side}.map.getPixelFromCoordinate([{u}, {-v}])")
    return box["x"] + x, box["y"] + y


def pick_pairs(page, truth, indices):
    points, on_imagery = truth
    for index in indices:
        page.mouse.click(*aim_at(page, "frame", points.pixels[index]))
        wait_for(page, f"geoaim.state.points.filter((p) => p.u !== null).length === {index + 1}")
        page.mouse.click(*aim_at(page, "imagery", on_imagery[index]))
        wait_for(page, f"geoaim.state.points.filter((p) => p.x !== null).length === {index + 1}")


def test_six_pairs_by_clicks_give_the_georeference_of_the_csv(page, task, truth, tmp_path):
    path = tmp_path / "points.csv"
    with serve(make_picking_view(replace(task, path=path), "sample")) as address:
        open_view(page, address)
        page.get_by_label("snap clicks to corners").uncheck()
        pick_pairs(page, truth, range(6))
        assert page.locator("table.points tr").count() == 7
    size, world = task.frame.shape[:2], task.imagery.world
    given, picked = (
        estimate_georeference(points, height=size[0], width=size[1], world=world)
        for points in (truth[0], geoaim.read_control_points(path))
    )
    corners = np.array([[0.0, 0.0], [size[1], 0.0], [size[1], size[0]], [0.0, size[0]]])
    metres = world_from_pixels(picked, corners) - world_from_pixels(given, corners)
    scale = np.sqrt(abs(np.linalg.det(given.world_from_image[:2, :2])))
    assert np.linalg.norm(metres, axis=1).max() / scale < 0.1


def test_points_are_dragged_undone_deleted_saved_and_loaded_again(page, task, truth, tmp_path):
    path = tmp_path / "points.csv"
    saved = replace(task, path=path)
    with serve(make_picking_view(saved, "sample")) as address:
        open_view(page, address)
        page.get_by_label("snap clicks to corners").uncheck()
        pick_pairs(page, truth, range(2))
        u, v = truth[0].pixels[0]
        x, y = aim_at(page, "frame", (u, v))
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 200, y, steps=4)
        page.mouse.up()
        wait_for(page, f"Math.abs(geoaim.state.points[0].u - {u} - 2) < 0.2")
        page.locator(".geoaim").first.evaluate("element => element.focus()")
        page.keyboard.press("Control+z")
        wait_for(page, f"Math.abs(geoaim.state.points[0].u - {u}) < 0.2")
        name = page.locator("table.points input").first
        name.fill("kerb, east")
        name.press("Enter")
        wait_for(page, "geoaim.state.points[0].name === 'kerb, east'")
        page.get_by_title("Delete").nth(1).click()
        wait_for(page, "geoaim.state.points.length === 1")
    assert [point.name for point in open_session(saved).points] == ["kerb, east"]
    with serve(make_picking_view(saved, "sample")) as address:
        open_view(page, address)
        assert page.evaluate("geoaim.state.points.map((point) => point.name)") == ["kerb, east"]


def test_proposed_pairs_are_accepted_by_a_click(page, task, truth, monkeypatch):
    """Pairs of the truth stand for those of a search, which has tests of its own."""
    points, on_imagery = truth
    places = transform_points(task.imagery.world_from_image, on_imagery)
    found = zip(points.pixels[3:].tolist(), places[3:].tolist(), strict=True)
    pairs = tuple(PairCandidate(tuple(pixel), tuple(place), 0.1) for pixel, place in found)
    monkeypatch.setattr("geoaim.web.picking.page.propose_pairs", lambda *_, **given: pairs)
    with serve(make_picking_view(task, "sample")) as address:
        open_view(page, address)
        page.get_by_label("snap clicks to corners").uncheck()
        pick_pairs(page, truth, range(3))
        page.get_by_role("button", name="Propose pairs").click()
        wait_for(page, "geoaim.state.candidates.length === 3")
        first = page.evaluate("geoaim.state.candidates[0]")
        page.mouse.click(*aim_at(page, "imagery", (first["image_u"], first["image_v"])))
        wait_for(page, "geoaim.state.points.length === 4")
        added = page.evaluate("geoaim.state.points[3]")
        assert added["u"] == pytest.approx(first["u"])


def test_the_overlay_lies_where_the_points_say(task, truth):
    session = open_session(replace(task, path=None))
    assert draw_overlay(session) == {}
    points, on_imagery = truth
    pairs = zip(points.pixels.tolist(), points.coordinates.tolist(), strict=True)
    for (u, v), (lon, lat) in pairs:
        action = {"action": "add", "u": u, "v": v, "lon": lon, "lat": lat}
        session, reply = handle(session, action)
        assert "error" not in reply
    left, top, right, bottom = draw_overlay(session)["extent"]
    inside = (on_imagery > [left, top]) & (on_imagery < [right, bottom])
    assert inside.all()
    assert draw_overlay(session)["url"].startswith("data:image")


def test_pairs_are_not_proposed_where_imagery_and_points_disagree(task, truth):
    session, moved = open_session(task), truth[0].coordinates + np.array([2e-4, 0.0])  # 13 m
    for (u, v), (lon, lat) in zip(truth[0].pixels.tolist(), moved.tolist(), strict=True):
        session, _ = handle(session, {"action": "add", "u": u, "v": v, "lon": lon, "lat": lat})
    with pytest.raises(AlignmentError, match=r"^no pairs: the imagery does not show the frame"):
        find_pairs(session)


def test_the_pictures_stay_in_place_while_points_are_added(page, task, truth):
    get_boxes = (
        "Array.from(document.querySelectorAll('.map'), (e) => e.getBoundingClientRect().top)"
    )
    with serve(make_picking_view(task, "sample")) as address:
        open_view(page, address)
        before = page.evaluate(f"{get_boxes}.concat(window.innerHeight)")
        assert "Click a mark on the frame" in page.locator(".message").inner_text()
        heights = "Array.from(document.querySelectorAll('.map'), (e) => e.clientHeight)"
        first = page.evaluate(heights)
        page.get_by_label("snap clicks to corners").uncheck()
        pick_pairs(page, truth, range(5))
        assert page.evaluate(f"{get_boxes}.concat(window.innerHeight)") == before
        assert page.evaluate(heights) == first


def test_a_drag_is_not_snapped_and_unreadable_coordinates_are_named(page, task, truth):
    with serve(make_picking_view(task, "sample")) as address:
        open_view(page, address)
        x, y = aim_at(page, "frame", truth[0].pixels[0])
        page.mouse.click(x, y)
        wait_for(page, "geoaim.state.points.length === 1")
        snapped = page.evaluate("[geoaim.state.points[0].u, geoaim.state.points[0].v]")
        begin = aim_at(page, "frame", snapped)
        page.mouse.move(*begin)
        page.mouse.down()
        page.mouse.move(begin[0] + 3, begin[1], steps=3)
        page.mouse.up()
        wait_for(page, f"Math.abs(geoaim.state.points[0].u - {snapped[0]}) > 0.01")
        field = page.locator("table.points input").nth(1)
        for text, found in (("36,3035", "is not saved"), ("200.5, 36.5", "lies outside the area")):
            field.fill(text)
            field.press("Enter")
            wait_for(page, f"document.querySelector('.message').textContent.includes('{found}')")
            assert page.evaluate("geoaim.state.points[0].x") is None


def test_a_place_copied_from_a_map_service_is_latitude_and_longitude(page, task):
    with serve(make_picking_view(task, "sample")) as address:
        open_view(page, address)
        page.evaluate("geoaim.ask({action: 'add', u: 100, v: 100})")
        field = page.locator("table.points input").nth(1)
        field.fill("49.9672, 36.3035")
        field.press("Enter")
        wait_for(page, "geoaim.state.points[0].x !== null")
        assert page.evaluate("[geoaim.state.points[0].lon, geoaim.state.points[0].lat]") == [
            36.3035,
            49.9672,
        ]
        message = page.locator(".message").inner_text()
        assert message.startswith("Read as latitude 49.9672, longitude 36.3035.")


def test_imagery_follows_a_click_on_the_frame_turned_alike(page, task, truth):
    frame = np.ascontiguousarray(np.rot90(task.frame))  # (u, v) becomes (v, width - u)
    width = task.frame.shape[1]
    points, on_imagery = truth
    pixels = np.column_stack([points.pixels[:, 1], width - points.pixels[:, 0]])
    with serve(make_picking_view(replace(task, frame=frame), "sample")) as address:
        open_view(page, address)
        page.get_by_label("snap clicks to corners").uncheck()
        pick_pairs(page, (replace(points, pixels=pixels), on_imagery), range(4))
        page.mouse.click(*aim_at(page, "frame", pixels[4]))
        wait_for(page, "geoaim.state.points.length === 5")
        u, v = page.evaluate("geoaim.imagery.map.getView().getCenter()")
        assert np.hypot(u - on_imagery[4, 0], -v - on_imagery[4, 1]) < 1.0
        # on the screen, the ground right of the point lies in the same direction on both sides
        directions = [
            np.subtract(*(_locate(page, side, place) for place in (ends[3], ends[4])))
            for side, ends in (("frame", pixels), ("imagery", on_imagery))
        ]
        assert directions[0] == pytest.approx(directions[1], rel=0.05, abs=20)
        shown = page.get_by_label("turn imagery").input_value()
        turned = np.rad2deg(page.evaluate("geoaim.imagery.map.getView().getRotation()"))
        assert float(shown) == pytest.approx(turned, abs=2.5)


def _locate(page, side, pixel):
    """Where a pixel of a side lies on the screen, also beyond its border."""
    u, v = pixel
    page.evaluate(f"geoaim.{side}.map.renderSync()")
    return page.evaluate(f"geoaim.{side}.map.getPixelFromCoordinate([{u}, {-v}])")
