"""What the viewer tells of traffic: facts, speeds, trails, counts, and the video beside the map."""

import csv
import io
from collections import Counter
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shapely import Polygon, contains_xy

from geoaim.base.world import World
from geoaim.web.explore import Contents, make_map_view
from tests.web.browser import open_view, serve, wait_for
from tests.web.test_interaction import cut_picture, find_colour, locate

VIDEO = Path(__file__).parents[2] / "samples/hover.mp4"
STEP = 90


@pytest.fixture
def shown(page, view):
    with serve(view) as address:
        open_view(page, address)
        wait_for(page, "Boolean(geoaim.timeline)")
        page.evaluate("geoaim.timeline.set(9)")
        yield page


def find_fastest(tracks):
    return int(np.argmax(np.where(tracks.present[:, STEP], tracks.states[:, STEP, 3], 0)))


def list_expected(tracks, row):
    """Words that must be said of an agent at STEP."""
    speed, seen = tracks.states[row, STEP, 3], tracks.times[tracks.present[row]]
    length, width = tracks.sizes[row]
    return [
        f"{tracks.types[row]} {tracks.ids[row]}",
        f"{speed:.1f} m/s ({3.6 * speed:.0f} km/h)",
        f"{length:.1f} × {width:.1f} m",
        f"{seen[0]:.1f} to {seen[-1]:.1f} s",
    ]


def test_the_pointer_over_an_agent_tells_what_it_is(shown, contents):
    row = find_fastest(contents.tracks)
    x, y = locate(shown, *contents.tracks.states[row, STEP, :2])
    shown.mouse.move(x, y)
    text = shown.locator(".hover").inner_text()
    assert [words for words in list_expected(contents.tracks, row) if words not in text] == []
    shown.mouse.move(x, y - 200)
    assert not shown.locator(".hover").is_visible()


def test_the_selected_agent_has_the_same_facts_and_they_follow_the_time(shown, contents):
    row = find_fastest(contents.tracks)
    shown.evaluate(f"geoaim.select('{contents.tracks.ids[row]}')")
    text = shown.locator(".selection").inner_text().replace("\n", " ")
    assert [words for words in list_expected(contents.tracks, row) if words not in text] == []
    absent = contents.tracks.times[~contents.tracks.present[row]][0]
    shown.evaluate(f"geoaim.timeline.set({absent})")
    assert "not seen now" in shown.locator(".selection").inner_text()
    shown.get_by_label("select nothing").click()
    assert not shown.locator(".selection").is_visible()


def test_colours_of_speeds_are_those_of_their_legend(shown, contents):
    tracks = contents.tracks
    row = find_fastest(tracks)
    shown.evaluate("geoaim.view.setResolution(0.05)")
    x, y = tracks.states[row, STEP, :2]
    shown.evaluate(f"geoaim.view.setCenter([{x}, {y}])")
    shown.get_by_label("colour by").select_option("speed")
    scale = shown.evaluate("geoaim.state.tracks.speeds")
    fastest = 3.6 * tracks.states[..., 3][tracks.present].max()
    assert scale["to"] - 10 < fastest <= scale["to"]
    share = 3.6 * tracks.states[row, STEP, 3] / scale["to"]
    wanted = scale["colours"][round(share * (len(scale["colours"]) - 1))]
    colour = [int(wanted[at : at + 2], 16) for at in (1, 3, 5)]
    assert find_colour(shown, locate(shown, x, y), colour)
    legends = shown.locator(".legend:visible").inner_text()
    assert " ".join(legends.split()) == f"0 {scale['to']} km/h"


def test_trails_show_where_agents_were(shown, contents):
    tracks = contents.tracks
    row = find_fastest(tracks)
    place = locate(shown, *tracks.states[row, STEP - 20, :2])  # 2 s ago
    before = cut_picture(shown, place)
    shown.get_by_label("trails").check()
    shown.evaluate("geoaim.map.renderSync()")
    after = cut_picture(shown, place)
    assert np.abs(after - before).max() > 30


def test_agents_stay_visible_from_far(shown, contents):
    tracks = contents.tracks
    place = tracks.states[find_fastest(tracks), STEP, :2]
    shown.evaluate(f"geoaim.view.setCenter([{place[0]}, {place[1]}]); geoaim.view.setResolution(4)")
    colour = shown.evaluate("geoaim.state.tracks.colours.car")
    wanted = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)])
    assert find_colour(shown, locate(shown, *place), wanted)
    cut = cut_picture(shown, locate(shown, *place))
    assert (np.abs(cut - wanted).max(axis=2) < 40).sum() > 12  # a car of 4.5 m would have 1 px


def count_crossings(tracks, a, b):
    """Crossings of a line by the middles of agents: from its left (A) or its right (B)."""
    a, b = np.asarray(a), np.asarray(b)
    (ex, ey), length = (b - a) / np.linalg.norm(b - a), np.linalg.norm(b - a)
    found = Counter()
    for row, present in enumerate(tracks.present):
        east, north = (tracks.states[row, present, :2] - a).T
        along, left = east * ex + north * ey, north * ex - east * ey
        for at in np.flatnonzero((left[:-1] > 0) != (left[1:] > 0)):
            share = left[at] / (left[at] - left[at + 1])
            if 0 <= along[at] + share * (along[at + 1] - along[at]) <= length:
                found[tracks.ids[row], "A" if left[at] > 0 else "B"] += 1
    return found


def test_counts_over_a_drawn_line_are_those_of_the_tracks(shown, contents):
    shown.get_by_label("count over a line").check()
    ends = (250, 250), (720, 520)
    for x, y in ends:
        shown.mouse.click(x, y)
        shown.wait_for_timeout(400)  # a quick second click would be a double click
    a, b = (shown.evaluate(f"geoaim.map.getCoordinateFromPixel([{x}, {y}])") for x, y in ends)
    expected = count_crossings(contents.tracks, a, b)
    assert min(Counter(side for _, side in expected.elements()).values()) > 1
    text = shown.locator(".counts:visible").inner_text()
    for side, words in (("A", "A → B: "), ("B", "B → A: ")):
        assert f"{words}{sum(n for (_, s), n in expected.items() if s == side)} (" in text
    with shown.expect_download() as waiting:
        shown.get_by_role("button", name="save counts.csv").click()
    rows = list(csv.DictReader(io.StringIO(Path(waiting.value.path()).read_text("utf-8"))))
    assert Counter((row["id"], row["from"]) for row in rows) == expected
    times = [float(row["time"]) for row in rows]
    assert times == sorted(times)
    for row in rows:
        agent = contents.tracks.ids.index(row["id"])
        step = int(np.searchsorted(contents.tracks.times, float(row["time"])))
        states = contents.tracks.states[agent, [step - 1, step]]
        assert np.linalg.norm(states[:, :2] - [float(row["x"]), float(row["y"])], axis=1).max() < 3
        assert min(states[:, 3]) - 0.01 <= float(row["speed_m_s"]) <= max(states[:, 3]) + 0.01


def draw_shape(page, tool, corners):
    page.get_by_label(tool).check()
    for x, y in corners:
        page.mouse.click(x, y)
        page.wait_for_timeout(400)  # a quick second click would be a double click
    find = "([x, y]) => geoaim.map.getCoordinateFromPixel([x, y])"
    return [page.evaluate(find, corner) for corner in corners]


def list_visits(tracks, corners):
    """Who was in a polygon, from when until when."""
    inside = contains_xy(Polygon(corners), tracks.states[..., 0], tracks.states[..., 1])
    found = []
    for name, here, present in zip(
        tracks.ids, inside & tracks.present, tracks.present, strict=True
    ):
        edges = np.diff(np.r_[0, here.astype(int), 0])
        for first, last in zip(
            np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1, strict=True
        ):
            whole = first > 0 and present[first - 1] and last + 1 < len(here) and present[last + 1]
            found.append((name, tracks.times[first], tracks.times[last], bool(whole)))
    return sorted(found, key=lambda visit: (visit[1], visit[0]))


def test_visits_of_a_drawn_zone_are_those_of_the_tracks(shown, contents):
    corners = (330, 250), (700, 230), (660, 480), (300, 440)
    zone = draw_shape(shown, "count in a zone", corners)
    shown.mouse.click(*corners[0])
    expected = list_visits(contents.tracks, zone)
    assert {whole for *_, whole in expected} == {True, False}
    agents = {name for name, *_ in expected}
    assert f"in the zone: {len(agents)} (" in shown.locator(".counts:visible").inner_text()
    with shown.expect_download() as waiting:
        shown.get_by_role("button", name="save visits.csv").click()
    rows = list(csv.DictReader(io.StringIO(Path(waiting.value.path()).read_text("utf-8"))))
    visits = [
        (row["id"], float(row["entered"]), float(row["left"]), row["whole"] == "true")
        for row in rows
    ]
    assert sorted(visits, key=lambda visit: (visit[1], visit[0])) == expected


def test_a_known_length_gives_the_scale_of_a_map_without_a_crs(page, aim):
    view = make_map_view(replace(aim, world=World(None)), Contents(), ExitStack())
    with serve(view) as address:
        open_view(page, address)
        a, b = draw_shape(page, "measure", [(300, 300), (500, 300)])
        page.get_by_label("its true length, m").fill("10")
        wanted = 0.2 * 10 / np.hypot(a[0] - b[0], a[1] - b[1])  # 0.2 m a pixel is the map's
        text = page.locator(".counts:visible code").inner_text()
        assert float(text.split()[-1]) == pytest.approx(wanted, rel=0.002)
        assert "--frame-resolution" in text


def test_who_waits_on_the_line_is_not_counted_twice(shown):
    counts = """(places) => {
        const states = new Float32Array(places.flatMap((x) => [x, 0, 0, 1]));
        const times = new Float64Array(places.map((_, index) => index));
        const steps = places.length;
        const agent = { id: "1", type: "car", length: 4, width: 2, first: 0, steps, states };
        const tracks = { times, agents: [agent], origin: [0, 0] };
        return geoaim.findCrossings(tracks, [0, -5], [0, 5]).map((crossing) => crossing.forward);
    }"""
    assert shown.evaluate(counts, [-3, -1, 0.2, -0.2, 0.2, 3]) == [True]
    assert shown.evaluate(counts, [-3, 0.2, -0.2, -3]) == []
    assert shown.evaluate(counts, [-3, 3, -3]) == [True, False]


def test_one_tool_at_a_time_has_the_clicks(shown):
    shown.get_by_label("measure").check()
    shown.get_by_label("count over a line").check()
    assert not shown.get_by_label("measure").is_checked()


def test_keys_step_select_and_go_to_marks(shown, contents):
    wait_for(shown, "Boolean(geoaim.marks)")
    shown.keyboard.press(".")
    times = contents.tracks.times
    assert shown.evaluate("geoaim.timeline.time") == pytest.approx(times[STEP + 1])
    shown.keyboard.press("n")
    first = shown.evaluate("geoaim.state.selected.id")
    shown.keyboard.press("n")
    assert shown.evaluate("geoaim.state.selected.id") != first
    shown.keyboard.press("p")
    assert shown.evaluate("geoaim.state.selected.id") == first
    shown.keyboard.press("m")
    marks = [mark["time"] for mark in shown.evaluate("geoaim.marks")]
    following = next((time for time in marks if time > times[STEP + 1]), marks[0])
    assert shown.evaluate("geoaim.timeline.time") == pytest.approx(following)
    shown.locator(".map").focus()
    resolution = shown.evaluate("geoaim.view.getResolution()")
    shown.keyboard.press("+")
    wait_for(shown, f"geoaim.view.getResolution() < {0.9 * resolution}")
    shown.get_by_label("trails").focus()
    shown.keyboard.press("Tab")  # a control with the focus leaves letters to the page
    shown.keyboard.press("Shift+Tab")
    shown.keyboard.press("f")
    assert shown.evaluate("geoaim.state.follow")


@pytest.fixture
def with_video(page, aim, contents):
    view = make_map_view(aim, replace(contents, video=VIDEO), ExitStack())
    with serve(view) as address:
        open_view(page, address)
        wait_for(page, "geoaim.beside.video.readyState >= 2")
        yield page


def measure_lag(page):
    return page.evaluate("Math.abs(geoaim.beside.video.currentTime - geoaim.timeline.time)")


def test_the_video_is_in_step_at_rest_and_while_it_plays(with_video):
    page = with_video
    page.evaluate("for (const time of [2, 9, 7.3]) geoaim.timeline.set(time)")
    wait_for(page, "Math.abs(geoaim.beside.video.currentTime - 7.3) < 0.021")
    page.keyboard.press("Space")
    wait_for(page, "geoaim.timeline.time > 8 && !geoaim.beside.video.paused")
    # a busy machine delays both, so that they are in step now and then
    wait_for(page, "Math.abs(geoaim.beside.video.currentTime - geoaim.timeline.time) < 0.1")
    page.evaluate("geoaim.timeline.set(4)")  # a seek while it plays
    wait_for(page, "geoaim.timeline.time > 4.2")
    assert page.evaluate("geoaim.timeline.time") < 7
    page.keyboard.press("Space")
    wait_for(page, "geoaim.beside.video.paused && !geoaim.beside.video.seeking")
    assert measure_lag(page) < 0.021


def test_the_map_plays_on_where_the_video_ends_or_is_put_away(with_video):
    page = with_video
    end = page.evaluate("geoaim.beside.video.duration")
    page.evaluate(f"geoaim.timeline.set({end} - 0.3); geoaim.timeline.toggle(true)")
    wait_for(page, f"geoaim.timeline.time > {end} + 0.3")
    page.evaluate("geoaim.timeline.toggle(false)")
    width = page.locator(".map").bounding_box()["width"]
    page.get_by_role("checkbox", name=f"video {VIDEO.name}").uncheck()
    assert not page.locator("video").is_visible()
    assert page.locator(".map").bounding_box()["width"] > 1.5 * width


def test_a_video_that_the_browser_cannot_play_is_said(page, aim, contents, tmp_path):
    (tmp_path / "odd.mp4").write_bytes(b"no video")
    video = replace(contents, video=tmp_path / "odd.mp4")
    with serve(make_map_view(aim, video, ExitStack())) as address:
        open_view(page, address)
        wait_for(page, "document.querySelector('figcaption').textContent.includes('cannot play')")
        page.evaluate("geoaim.timeline.set(1); geoaim.timeline.toggle(true)")
        wait_for(page, "geoaim.timeline.time > 1.2")


def test_the_colouring_and_shown_layers_are_in_the_address(shown):
    shown.get_by_label("trails").check()
    shown.evaluate("geoaim.colour('speed')")
    wait_for(shown, "location.hash.includes('colour=speed')")
    shown.reload()
    wait_for(shown, "Boolean(window.geoaim)")
    assert shown.get_by_label("trails").is_checked()
    assert shown.get_by_label("colour by").input_value() == "speed"
    assert not shown.get_by_label("contested").is_checked()
