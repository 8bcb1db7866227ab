import json
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from shapely import MultiPolygon, box

import geoaim
from geoaim.aim.aim import AIM
from geoaim.base.errors import TracksError
from geoaim.base.world import World, lonlat_from_world
from geoaim.prediction.futures import Futures
from geoaim.prediction.pictures import write_futures
from geoaim.rendering.scene import make_scene
from geoaim.simulation.road_rules import NO_ROAD_RULES
from geoaim.tracks.tracks import Tracks
from geoaim.web.explore import Contents, make_map_view
from geoaim.web.map_layers import describe_lines, describe_lonlat
from geoaim.web.map_view import read_embedded
from geoaim.web.moving_layers import (
    describe_futures,
    describe_futures_file,
    describe_tracks,
    list_infractions,
)


def test_the_description_names_only_what_can_be_read(view):
    shown = json.loads(view.read("description.json"))
    for raster in shown["rasters"]:
        assert len(view.read(f"{raster['path']}/0/0/0")) > 100
    tracks = shown["moving"]["tracks"]
    states = np.frombuffer(view.read(tracks["path"]), "<f4")
    assert len(states) == 4 * sum(agent["steps"] for agent in tracks["agents"])
    assert len(view.read(tracks["times"])) == 8 * 601
    for path in ("nothing", "aim_image/9/0/0", "aim_image/0/0", "agent_views/none/0", "../aim"):
        with pytest.raises((KeyError, TracksError)):
            view.read(path)


def test_packed_tracks_are_those_given(contents):
    described, data = describe_tracks(contents.tracks)
    states = np.frombuffer(data["tracks"](), "<f4").reshape(-1, 4)
    begin = 0
    for row, agent in enumerate(described["agents"]):
        origin = np.array([*described["origin"], 0.0, 0.0])
        part = states[begin : begin + agent["steps"]] + origin
        begin += agent["steps"]
        true = contents.tracks.states[row, agent["first"] : agent["first"] + agent["steps"]]
        np.testing.assert_allclose(part, true, atol=1e-4)


def test_infractions_are_marked_where_they_begin(view):
    marks = json.loads(view.read("marks.json"))
    assert {mark["kind"] for mark in marks} <= {"collision", "off road", "red light"}
    assert marks == sorted(marks, key=lambda mark: mark["time"])
    keys = [(mark["time"], mark["agent"], mark["kind"]) for mark in marks]
    assert len(set(keys)) == len(keys) > 0


def test_collisions_of_estimated_boxes_are_not_listed(contents):
    states = np.tile([0.0, 0.0, 0.0, 5.0], (2, 11, 1))
    states[:, :, 0] = 5.0 * np.arange(11) / 10 + np.array([[0.0], [1.0]])  # one in the other
    tracks = Tracks(
        times=np.arange(11) / 10,
        states=states,
        present=np.ones((2, 11), bool),
        sizes=np.tile([4.5, 1.8], (2, 1)),
        types=("car", "car"),
        ids=("1", "2"),
        world=World(None),
    )
    estimated = replace(tracks, uncertainty=np.full((2, 11, 2), 0.2))
    aim = AIM.from_image(
        np.zeros((50, 50, 3), np.uint8),
        np.array([[1.0, 0, -10], [0, -1, 25], [0, 0, 1]]),
        World(None),
        "made",
    )
    kinds = [
        {mark["kind"] for mark in list_infractions(make_scene(aim, one), NO_ROAD_RULES)}
        for one in (tracks, estimated)
    ]
    assert kinds == [{"collision"}, set()]


def test_longitude_and_latitude_are_fitted_to_a_millimetre():
    world = World("EPSG:32635", (583000.0, 6062000.0))
    corners = np.array([[-500.0, -300.0], [1500.0, 900.0]])
    fitted = describe_lonlat(world, corners)
    points = np.array([[-400.0, 800.0], [0.0, 0.0], [1400.0, 850.0]])
    u, v = ((points - fitted["center"]) / fitted["scale"]).T
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    degrees = (np.array(fitted["coefficients"]) @ terms).T
    assert np.abs(degrees - lonlat_from_world(world, points)).max() < 1e-8  # 1 mm
    assert describe_lonlat(World(None), corners) is None


def test_the_drivable_area_is_the_given_one_or_that_of_the_hd_map(aim, contents):
    square = MultiPolygon([box(0, 0, 9, 9)])
    areas = []
    for given in (Contents(hdmap=contents.hdmap), Contents(drivable=square), Contents()):
        with ExitStack() as stack:
            shapes = make_map_view(aim, given, stack).description["shapes"]
        areas.append([item["polygons"] for item in shapes if item["name"] == "drivable area"])
    assert len(areas[0]) == 1
    assert areas[1] == [[[[list(p) for p in square.geoms[0].exterior.coords]]]]
    assert areas[2] == []


def test_a_map_is_described_by_its_kinds_of_lines(contents):
    shapes = describe_lines(contents.hdmap)
    assert len({item["name"] for item in shapes}) == len(shapes)
    assert sum(len(item.get("lines", [])) for item in shapes) == len(contents.hdmap.lines)


def test_futures_are_described_alike_from_memory_and_from_a_file(aim, contents, tmp_path):
    scene = geoaim.make_scene(aim, contents.tracks)
    states = scene.states[None, :, 91:95].repeat(2, 1, 1, 1)
    states[1, :, :, 0] += 1.0
    futures = Futures(states, scene, start=90, dt=0.1)
    described = describe_futures(futures)
    assert described["start"] == 9.0
    first = described["agents"][0]
    row = scene.ids.index(first["id"])
    np.testing.assert_allclose(first["samples"][1], states[1, row, :, :2], atol=0.01)
    write_futures(futures, tmp_path / "futures.csv")
    filed = describe_futures_file(tmp_path / "futures.csv")
    assert [agent["id"] for agent in filed["agents"]] == [a["id"] for a in described["agents"]]
    np.testing.assert_allclose(filed["agents"][0]["samples"], first["samples"], atol=0.011)
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(TracksError, match=r"other\.csv"):
        describe_futures_file(tmp_path / "other.csv")


def test_a_file_holds_what_its_description_names(view):
    files = read_embedded(view)
    shown = json.loads(files["description.json"])
    assert not shown["agent_views"]
    for raster in shown["rasters"]:
        assert f"{raster['path']}/{len(raster['resolutions']) - 1}/0/0" in files
    assert shown["moving"]["tracks"]["path"] in files


def test_the_view_of_an_agent_is_a_picture(view, contents):
    step = int(np.flatnonzero(contents.tracks.present[0])[5])
    assert view.read(f"agent_views/{contents.tracks.ids[0]}/{step}")[:2] == b"\xff\xd8"
