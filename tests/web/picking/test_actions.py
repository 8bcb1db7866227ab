import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geoaim.aim.aim import AIM
from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.base.geometry import transform_points
from geoaim.base.world import World
from geoaim.mapping.georeference.control_points import read_control_points
from geoaim.web.picking.actions import handle
from geoaim.web.picking.page import find_pairs
from geoaim.web.picking.session import PickingTask, open_session
from tests.web.picking.test_candidates import PIXELS

SAMPLE = Path(__file__).parents[3] / "samples"
GCPS = read_control_points(SAMPLE / "gcps.csv")
FRAME = np.zeros((720, 1280, 3), np.uint8)


def squares(height=720, width=1280):
    image = np.full((height, width, 3), 90, np.uint8)
    image[300:, 400:] = image[:300, :400] = 170
    return image


@pytest.fixture
def task(tmp_path):
    return PickingTask(FRAME, path=tmp_path / "points.csv")


def run(session, *actions):
    """The session and the last reply, each of which is plain JSON and no error."""
    for action in actions:
        session, reply = handle(session, json.loads(json.dumps(action)))
        assert "error" not in reply, reply
        json.dumps(reply, allow_nan=False)
    return session, reply


def test_coordinates_off_the_earth_are_refused_at_once(task):
    _, reply = handle(open_session(task), {"action": "add", "lon": 200.0, "lat": 95.0})
    assert "lies outside the area where that is used" in reply["error"]


def test_imagery_of_another_place_gives_a_warning(task):
    run(open_session(task), add(0), add(1))
    elsewhere = AIM.from_image(squares(), np.diag([0.1, -0.1, 1.0]), World("EPSG:32635"), "made")
    with pytest.warns(GeoaimWarning, match=r"shows none of the 2 points in .*points\.csv"):
        open_session(replace(task, imagery=elsewhere))


def test_points_on_coarse_imagery_are_saved_with_its_accuracy(task):
    coarse = AIM.from_image(squares(), np.diag([0.4, -0.4, 1.0]), World(None), "made")
    run(
        open_session(replace(task, crs=None, imagery=coarse)),
        {"action": "add", "side": "imagery", "u": 10.0, "v": 10.0},
        {"action": "add", "u": 10.0, "v": 10.0},
    )
    assert "# accuracy: 0.4\n" in task.path.read_text()


def test_a_stated_accuracy_is_saved_and_read_again(task):
    given = {"action": "accuracy", "m": 1.5}
    _, reply = run(open_session(task), {"action": "add", "u": 10.0, "v": 10.0}, given)
    assert reply["accuracy"] == 1.5
    assert "# accuracy: 1.5\n" in task.path.read_text()
    session, again = run(open_session(task), {"action": "state"})
    assert again["accuracy"] == 1.5
    for wrong in (-1, None, "1", float("nan")):
        assert (
            "metres, 0 or more" in handle(session, {"action": "accuracy", "m": wrong})[1]["error"]
        )


def add(index):
    (u, v), (lon, lat) = GCPS.pixels[index].tolist(), GCPS.coordinates[index].tolist()
    return {"action": "add", "u": u, "v": v, "lon": lon, "lat": lat, "name": GCPS.names[index]}


def test_picking_what_the_csv_has_gives_its_georeference_and_saves_it(task):
    _, reply = run(open_session(task), *(add(i) for i in range(16)))
    assert reply["feedback"]["problem"] is None
    assert reply["feedback"]["georeference"]["model"] in ("similarity", "homography")
    saved = read_control_points(task.path)
    np.testing.assert_array_equal(saved.pixels, GCPS.pixels)
    np.testing.assert_array_equal(saved.coordinates, GCPS.coordinates)
    assert saved.names == GCPS.names
    _, again = run(open_session(task), {"action": "state"})
    assert again["points"] == reply["points"]
    assert again["feedback"] == reply["feedback"]


def test_every_change_is_saved_and_can_be_undone_and_redone(task):
    session, _ = run(open_session(task), *(add(i) for i in range(5)))
    states = [task.path.read_text()]
    for change in (
        {"action": "move", "id": 2, "u": 12.5, "v": 20},
        {"action": "rename", "id": 2, "name": "kerb, north"},
        {"action": "delete", "id": 1},
    ):
        session, reply = run(session, change)
        states.append(task.path.read_text())
        assert (reply["can_undo"], reply["can_redo"]) == (True, False)
    assert len(set(states)) == 4
    for state in states[2::-1]:
        session, reply = run(session, {"action": "undo"})
        assert task.path.read_text() == state
        assert reply["can_redo"]
    for state in states[1:]:
        session, _ = run(session, {"action": "redo"})
        assert task.path.read_text() == state
    session, _ = run(session, {"action": "undo"})
    session, reply = run(session, add(7))
    assert not reply["can_redo"]
    assert len({point["id"] for point in reply["points"]}) == len(reply["points"])


def test_incomplete_points_survive_saving_and_loading(task):
    run(
        open_session(task),
        {"action": "add", "u": 5, "v": 6},
        {"action": "add", "lon": 28.29, "lat": 54.7, "name": "#surveyed"},
    )
    session, reply = run(open_session(task), {"action": "state"})
    first, second = reply["points"]
    assert (first["name"], first["u"], first["lon"]) == ("point 1", 5.0, None)
    assert (second["name"], second["u"], second["lon"]) == ("#surveyed", None, 28.29)
    _, reply = run(session, {"action": "move", "id": 1, "lon": 28.3, "lat": 54.71})
    assert (reply["points"][0]["u"], reply["points"][0]["lat"]) == (5.0, 54.71)


def test_all_points_deleted_is_no_damaged_file(task):
    run(open_session(task), add(0), {"action": "delete", "id": 1})
    assert open_session(task).points == ()


def test_a_damaged_file_is_refused_and_stays(task):
    task.path.write_text("no points")
    with pytest.raises(GeoreferenceError):
        open_session(task)
    assert task.path.read_text() == "no points"


def test_points_of_other_frames_are_kept_and_not_fitted(tmp_path):
    (tmp_path / "points.csv").write_text("u,v,lon,lat,frame\n1,2,28.29,54.7,40\n3,4,28.3,54.7,0\n")
    task = PickingTask(FRAME, path=tmp_path / "points.csv")
    _, reply = run(open_session(task), add(2))
    assert reply["feedback"]["missing"] == 2
    assert read_control_points(task.path).frames == (40, 0, None)


def test_clicks_on_imagery_give_places_and_pixels_of_it(tmp_path):
    world = World("EPSG:32635", (583000.0, 6062000.0))
    matrix = np.array([[0.2, 0.0, 100.0], [0.0, -0.2, 300.0], [0.0, 0.0, 1.0]])
    imagery = AIM.from_image(squares(), matrix, world, "made")
    task = PickingTask(squares(), imagery=imagery, path=tmp_path / "points.csv")
    session, reply = run(
        open_session(task),
        *(
            {"action": "add", "u": u, "v": v}
            for u, v in [(100, 100), (1200, 120), (1100, 650), (90, 600), (640, 300)]
        ),
        *(
            {"action": "move", "id": i, "side": "imagery", "u": u, "v": v}
            for i, (u, v) in enumerate(
                [(150, 130), (1250, 150), (1150, 680), (140, 630), (690, 330)], 1
            )
        ),
    )
    point = reply["points"][1]
    assert (point["image_u"], point["image_v"]) == pytest.approx((1250, 150), abs=1e-6)
    assert reply["feedback"]["georeference"]["crs"] == "EPSG:32635"
    shift = np.array(reply["imagery_from_frame"])
    np.testing.assert_allclose(shift, [[1, 0, 50], [0, 1, 30], [0, 0, 1]], atol=1e-6)
    _, reply = run(session, {"action": "snap", "side": "imagery", "u": 402, "v": 297})
    assert (reply["snapped"]["u"], reply["snapped"]["v"]) == pytest.approx((400, 300), abs=0.05)
    near = {"action": "snap", "side": "imagery", "u": 402, "v": 297, "radius": 2.0}
    assert run(session, near)[1]["snapped"] is None  # beyond what an exact click may mean
    _, reply = run(session, {"action": "snap", "u": 200, "v": 100})
    assert reply["snapped"] is None


def test_candidates_are_accepted_one_by_one(place, tmp_path):
    frame, imagery, matrix = place
    task = PickingTask(frame, imagery=imagery, path=tmp_path / "points.csv")
    world_pixels = np.linalg.inv(imagery.world_from_image) @ matrix
    clicks = []
    for u, v in PIXELS.tolist():
        x, y, w = world_pixels @ [u, v, 1.0]
        clicks.append({"action": "add", "u": u, "v": v})
        clicks.append(
            {
                "action": "move",
                "id": len(clicks) // 2 + 1,
                "side": "imagery",
                "u": x / w,
                "v": y / w,
            }
        )
    session, _ = run(open_session(task), *clicks)
    session, reply = run(replace(session, candidates=find_pairs(session)), {"action": "state"})
    count = len(reply["candidates"])
    assert count >= 8
    assert len(reply["points"]) == 3
    first = reply["candidates"][0]
    session, reply = run(session, {"action": "accept", "candidate": 0})
    assert len(reply["candidates"]) == count - 1
    assert reply["points"][3]["u"] == first["u"]
    assert reply["points"][3]["image_u"] == pytest.approx(first["image_u"], abs=1e-4)
    _, reply = run(session, *[{"action": "accept", "candidate": 0}] * (count - 1))
    assert reply["feedback"]["problem"] is None
    assert all(row["distance_m"] < 0.5 for row in reply["feedback"]["residuals"])


@pytest.mark.parametrize("format", ["csv", "txt", "points"])
def test_export_gives_the_text_of_a_file(task, tmp_path, format):
    session, _ = run(open_session(task), *(add(i) for i in range(6)))
    _, reply = run(session, {"action": "export", "format": format})
    path = tmp_path / f"other.{format}"
    path.write_text(reply["text"])
    np.testing.assert_allclose(read_control_points(path).pixels, GCPS.pixels[:6], atol=1e-9)
    session, _ = run(session, {"action": "add", "u": 5, "v": 6, "name": "no place"})
    _, reply = run(session, {"action": "export", "format": format})
    assert any("no place" in note for note in reply["notes"]) == (format != "csv")


@pytest.mark.parametrize(
    "action",
    [
        None,
        [],
        {},
        {"action": "drop"},
        {"action": ["add"]},
        {"action": "add"},
        {"action": "add", "u": 5},
        {"action": "add", "u": "5", "v": 6},
        {"action": "add", "u": True, "v": 6},
        {"action": "add", "u": float("nan"), "v": 6},
        {"action": "add", "u": 10**400, "v": 6},
        {"action": "add", "u": -3, "v": 6},
        {"action": "add", "u": 5, "v": 6, "side": "imagery"},
        {"action": "add", "u": 5, "v": 6, "name": "taken"},
        {"action": "move", "id": 99, "u": 5, "v": 6},
        {"action": "rename", "id": 2, "name": "taken"},
        {"action": "delete"},
        {"action": "snap", "u": -5, "v": 6},
        {"action": "snap", "u": 5, "v": 6, "radius": 0},
        {"action": "snap", "u": 5, "v": 6, "radius": "8"},
        {"action": "accept", "candidate": 0},
        {"action": "accept", "candidate": "0"},
        {"action": "export", "format": "../points.csv"},
    ],
)
def test_a_bad_action_gives_one_line_and_changes_nothing(task, action):
    session, _ = run(open_session(task), {"action": "add", "u": 1, "v": 2, "name": "taken"}, add(1))
    before = task.path.read_text()
    after, reply = handle(session, action)
    assert set(reply) == {"error"}
    assert 0 < len(reply["error"]) < 400
    assert "\n" not in reply["error"]
    assert after is session
    assert task.path.read_text() == before


def test_a_file_that_cannot_be_written_is_an_error(tmp_path):
    (tmp_path / "folder").mkdir()
    session = open_session(PickingTask(FRAME, path=tmp_path / "folder" / "points.csv"))
    (tmp_path / "folder").rmdir()
    (tmp_path / "folder").write_text("a file now")
    after, reply = handle(session, add(0))
    assert set(reply) == {"error"}
    assert after is session


def test_a_point_that_the_proposed_pairs_disagree_with_is_named(place):
    frame, imagery, matrix = place
    session = open_session(PickingTask(frame, imagery=imagery, path=None))
    imagery_from_frame = np.linalg.inv(imagery.world_from_image) @ matrix
    for pixel, shift in zip(PIXELS, (0.0, 0.0, 30.0), strict=True):
        u, v = (transform_points(imagery_from_frame, pixel[None])[0] + [shift, 0.0]).tolist()
        on_imagery = {"action": "add", "side": "imagery", "u": u, "v": v}
        session, reply = run(session, on_imagery)
        number, (u, v) = reply["added"], pixel.tolist()
        session, _ = run(session, {"action": "move", "id": number, "u": u, "v": v})
    session, reply = run(replace(session, candidates=find_pairs(session)), {"action": "state"})
    (doubted,) = reply["disagreeing"]
    assert doubted["name"] == session.points[2].name
    assert doubted["distance_m"] == pytest.approx(30.0 * imagery.resolution, rel=0.2)
    u, v = transform_points(imagery_from_frame, PIXELS[2:])[0].tolist()
    _, reply = run(session, {"action": "move", "id": number, "side": "imagery", "u": u, "v": v})
    assert reply["disagreeing"] == []
    # 90 degrees from the middle of the UTM zone, where it has no metres
    _, reply = run(session, {"action": "move", "id": number, "lon": 117.0, "lat": 0.0})
    assert "cannot be expressed" in reply["feedback"]["problem"]["text"]


def test_a_file_that_was_changed_by_another_page_is_not_overwritten(task):
    first, second = open_session(task), open_session(task)
    first, _ = run(first, *({"action": "add", "u": 10.0 + i, "v": 20.0} for i in range(4)))
    written = task.path.read_bytes()
    same, reply = handle(second, {"action": "add", "u": 99.0, "v": 99.0})
    assert "was changed by another page or program" in reply["error"]
    assert (same, task.path.read_bytes()) == (second, written)
    again, _ = run(open_session(task), {"action": "add", "u": 99.0, "v": 99.0})
    assert len(again.points) == 5


def test_a_file_that_became_unreadable_is_not_overwritten(task):
    session, _ = run(open_session(task), {"action": "add", "u": 1.0, "v": 2.0})
    task.path.write_text("something else\n")
    _, reply = handle(session, {"action": "add", "u": 3.0, "v": 4.0})
    assert "points.csv" in reply["error"]
    assert task.path.read_text() == "something else\n"
