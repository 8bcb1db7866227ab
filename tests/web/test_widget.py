from pathlib import Path

import pytest

import geoaim
from geoaim.aim.files import write_aim
from geoaim.web.explore import read_contents
from geoaim.web.map_view import MapView
from geoaim.web.widget import answer_message, explore, pick

SAMPLES = Path("samples")


@pytest.fixture
def sent():
    return []


def test_messages_are_answered_with_bytes_replies_or_errors(view, sent):
    def send(*message):
        sent.append(message)

    answer_message(view, send, {"id": 1, "path": "description.json"})
    answer_message(view, send, {"id": 2, "path": "nothing"})
    calling = MapView({}, call=lambda action: {"twice": 2 * action["value"]})
    answer_message(calling, send, {"id": 3, "action": {"value": 4}})
    assert sent[0][0] == {"id": 1}
    assert sent[0][1][0].startswith(b"{")
    assert sent[1][0] == {"id": 2, "error": "there is nothing at nothing"}
    assert sent[2][0] == {"id": 3, "reply": {"twice": 8}}


def test_the_widget_carries_the_viewer(aim, contents):
    pytest.importorskip("anywidget")
    widget = explore(aim, tracks=contents.tracks)
    assert "geoaim-painted" in widget._esm
    assert explore(aim, tracks=contents.tracks)._esm == widget._esm


def test_points_are_picked_in_a_notebook(tmp_path, monkeypatch, sent):
    views = []
    monkeypatch.setattr("geoaim.web.widget.make_widget", lambda view, _: views.append(view))
    path = tmp_path / "points.csv"
    pick(SAMPLES / "hover.mp4", path, imagery=SAMPLES / "ortho.tif")
    action = {"action": "add", "side": "frame", "u": 100.0, "v": 80.0}
    answer_message(views[0], lambda *message: sent.append(message), {"id": 1, "action": action})
    assert sent[0][0]["reply"]["points"][0]["u"] == 100.0
    assert "100" in path.read_text()


def test_everything_is_explored_by_the_paths_of_its_files(aim, contents, tmp_path):
    pytest.importorskip("anywidget")
    write_aim(aim, tmp_path / "aim.tif")
    paths = {
        "tracks": str(SAMPLES / "tracks.csv"),
        "lights": SAMPLES / "lights.csv",
        "hdmap": str(SAMPLES / "map.osm"),
    }
    read = read_contents(tmp_path / "aim.tif", **paths)
    assert read.tracks.ids == contents.tracks.ids
    assert len(read.lights.names) == len(contents.lights.names) > 0
    assert len(read.hdmap.lines) == len(contents.hdmap.lines)
    assert "geoaim-painted" in explore(str(tmp_path / "aim.tif"), **paths)._esm
    with pytest.raises(ValueError, match=r"lights\.csv has no places of its lights: give hdmap="):
        geoaim.explore(aim, lights=SAMPLES / "lights.csv")
    with pytest.raises(FileNotFoundError, match=r"none\.csv"):
        explore(aim, tracks="none.csv")
