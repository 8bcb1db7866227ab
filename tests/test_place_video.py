"""A video all the way: a folder with map, tracks, film and report, which other commands take."""

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from shapely import LineString
from typer.testing import CliRunner

import geoaim
from geoaim import pipeline
from geoaim.base.encode import write_video
from geoaim.base.errors import AlignmentError, GeoaimError, GeoaimWarning, VideoError, warn
from geoaim.base.geojson import Feature
from geoaim.base.geometry import transform_points
from geoaim.base.world import World
from geoaim.cli import app
from geoaim.cli.inputs import find_video
from geoaim.mapping.video.video import open_video
from geoaim.tracking import pipeline as tracking
from geoaim.tracking.box_checks import check_standing, find_askew
from geoaim.tracking.pipeline import FollowedVideo
from geoaim.tracking.scale import check_scale
from geoaim.tracking.verdicts import judge_map, judge_scale, judge_tracks
from geoaim.tracks.changes import select_agents
from tests.geojson_files import write_features

SAMPLES = Path(__file__).parents[1] / "samples"
RESOLUTION = 0.264  # metres per pixel of the sample's video at half its size
FILES = ["film.mp4", "map.png", "map.tif", "report.json", "tracks.csv"]
run = CliRunner().invoke


@pytest.fixture(scope="module")
def video():
    """Two seconds of the sample at half its size, without its telemetry."""
    whole = open_video(SAMPLES / "hover.mp4")
    frames = [shrink(frame.image) for frame in islice(whole, 0, 60, 3)]
    return open_video(frames, rate=whole.rate / 3)


def shrink(image):
    return cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


@pytest.fixture(scope="module")
def junction(video, tmp_path_factory):
    folder = tmp_path_factory.mktemp("place") / "junction"
    return folder, geoaim.place_video(video, folder)


def test_a_video_alone_gives_a_folder_with_all(junction):
    folder, result = junction
    assert sorted(path.name for path in folder.iterdir()) == FILES
    aim, tracks = geoaim.read_aim(folder), geoaim.read_tracks(folder)
    assert aim.resolution == pytest.approx(RESOLUTION, rel=0.25)
    assert len(tracks.ids) >= 5
    np.testing.assert_allclose(np.diff(tracks.times), 0.1, atol=1e-6)  # of 8 frames a second
    length = np.median(tracks.sizes[[kind == "car" for kind in tracks.types], 0])
    assert 3.5 < length < 5.5
    film = open_video(folder / "film.mp4")
    assert film.frame_count == len(tracks.times)
    assert film.height == 720
    assert film.width > 2 * 720  # the video beside the map
    assert "proposed" in result.known["scale"]
    report = json.loads((folder / "report.json").read_text("utf-8"))
    assert report["video"] is None  # these frames are in no file
    assert report["known"] == result.known
    assert report["missing"] == result.missing
    assert {name: one["grade"] for name, one in report["verdicts"].items()} == {
        "map": "good",
        "scale": "doubtful",
        "tracks": "good",
    }
    assert report["warnings"] == []
    assert report["shares"]["registration_m"] < 0.1
    assert 0 <= report["shares"]["unused_boxes"] < 0.25
    assert 0.1 < report["shares"]["observed"] <= 1  # states are known a second after the first
    assert {"a place in the world", "an exact scale", "training"} <= set(result.missing)
    assert "60 s" in result.missing["training"]


def test_the_report_tells_the_viewer_where_the_video_is(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"")
    for source, video in (("a.mp4", "a.mp4"), ("a.mp4#t=8.5,24", "a.mp4"), ("b.mp4", None)):
        report = {"video": str(tmp_path / source)}
        (tmp_path / "report.json").write_text(json.dumps(report))
        expected = None if video is None else tmp_path / video
        assert find_video(tmp_path / "map.tif") == expected
    (tmp_path / "report.json").write_text('["of another program"]')
    assert find_video(tmp_path / "map.tif") is None


def test_the_film_shows_the_boxes_on_the_video_too(video, junction):
    folder, result = junction
    film = next(iter(open_video(folder / "film.mp4"))).image.astype(float)
    first = next(iter(video)).image
    plain = cv2.resize(first, (1280, 720), interpolation=cv2.INTER_AREA).astype(float)
    changed = np.abs(film[:, :1280] - plain).max(axis=2) > 60
    assert 0.0005 < changed.mean() < 0.05
    there = result.tracks.present[:, 0]
    place = result.tracks.states[there, 0, :2]
    height, width = result.aim.coverage.shape
    pixels = transform_points(np.linalg.inv(result.aim.world_from_image), place)
    columns, rows = (pixels * [1280 / width, 720 / height]).astype(int).T
    near = cv2.dilate(changed.astype(np.uint8), np.ones((61, 61))) > 0
    inside = (columns >= 0) & (columns < 1280) & (rows >= 0) & (rows < 720)
    assert near[rows[inside], columns[inside]].all()


def test_what_cannot_be_used_is_said(junction):
    result = junction[1]
    rare = judge_tracks(8.0, 0.0, 0.95, ())
    assert rare.grade == "unusable"
    assert "8 s apart" in str(rare)
    assert judge_tracks(8.0, 0.0, None, ()).grade == "doubtful"
    assert judge_tracks(0.08, 0.0, 0.95, ()).grade == "good"
    unsure = judge_tracks(0.08, 0.0, 0.78, ())
    assert (unsure.grade, "78% of the tracks" in str(unsure)) == ("doubtful", True)
    assert "70%" in str(judge_tracks(0.08, 0.7, None, ()))
    registration = {**result.aim.report["registration"], "uncertainty_px": 5.0}
    shaken = replace(result.aim, report={**result.aim.report, "registration": registration})
    assert judge_map(shaken, ()).grade == "unusable"
    followed = FollowedVideo(result.tracks, SimpleNamespace(times=np.arange(9.0) / 9), 0.0, 0.95)
    grades = []
    for aim in (result.aim, shaken):
        judged = pipeline._judge(replace(result, aim=aim), followed, ((), ()))
        grades.append(judged.verdicts["tracks"].grade)
    assert grades == ["good", "unusable"]
    assert judge_map(result.aim, ("contested",)).grade == "doubtful"
    small = replace(result.tracks, sizes=result.tracks.sizes / 8)
    assert judge_scale(result.aim, small).grade == "unusable"


def test_people_who_are_taken_for_cars_tell_no_scale(junction):
    result = junction[1]
    assert find_askew(result.tracks) == ""
    across = replace(result.tracks, sizes=result.tracks.sizes[:, ::-1])  # as shoulders lie
    askew = replace(result.tracks, sizes=result.tracks.sizes * [4, 0.2])  # as fitted to any turn
    times = SimpleNamespace(times=np.arange(9.0) / 9)
    for people in (across, askew):
        with pytest.warns(GeoaimWarning, match="across their paths .* people look like cars"):
            check_scale(people, result.aim)
        followed = FollowedVideo(people, times, 0.0, 0.95)
        judged = pipeline._judge(replace(result, tracks=people), followed, ((), ()))
        assert judged.verdicts["scale"].grade == judged.verdicts["tracks"].grade == "unusable"


def test_what_stands_and_comes_or_goes_is_doubted(junction):
    tracks = junction[1].tracks
    check_standing(tracks)
    still = tracks.states.copy()
    first = tracks.present.argmax(axis=1)
    still[:] = still[np.arange(len(first)), first][:, None]
    half = tracks.present & (np.arange(len(tracks.times)) < len(tracks.times) / 2)[None]
    shown = half.any(axis=1)  # as the first of two stills
    part = replace(select_agents(tracks, shown), states=still[shown], present=half[shown])
    with pytest.warns(GeoaimWarning, match="stand, and come or go nevertheless"):
        check_standing(part)


def test_frames_that_lie_on_no_map_are_said(junction):
    matrices = np.full((5, 3, 3), np.nan)
    matrices[:2] = np.eye(3)
    with pytest.warns(GeoaimWarning, match="only 40% of the frames lie on the map"):
        tracking._warn_of_lost_frames(SimpleNamespace(world_from_frame=matrices))


def test_pictures_a_second_apart_are_followed_as_they_are_and_judged(video, tmp_path):
    frames = [frame.image for frame in islice(video, 0, 20, 5)]
    result = geoaim.place_video(open_video(frames, rate=1.0), tmp_path / "slides")
    assert set(np.diff(result.tracks.times)) == {1.0}
    assert "1 s apart" in result.known["verdict: tracks"]


def test_warnings_of_the_run_are_in_the_report(video, tmp_path, monkeypatch):
    build = pipeline.build_aim

    def build_with_a_warning(*given, **options):
        warn("the ground is uncertain")
        return build(*given, **options)

    monkeypatch.setattr(pipeline, "build_aim", build_with_a_warning)
    blind = geoaim.Evidence(frame_resolution=RESOLUTION / 8)  # at which cars are lorries
    file = write_video([frame.image for frame in video], tmp_path / "a.mp4", frame_rate=video.rate)
    with pytest.warns(GeoaimWarning, match="the ground is uncertain"):
        result = geoaim.place_video(file, tmp_path / "small", blind)
    report = json.loads((tmp_path / "small" / "report.json").read_text("utf-8"))
    assert report["video"] == str(file)
    assert report["warnings"] == ["the ground is uncertain"]
    assert result.verdicts["map"].grade == "doubtful"
    assert result.verdicts["tracks"].grade == "unusable"


def test_commands_take_the_folder(junction, tmp_path):
    folder = str(junction[0])
    result = run(app, ["info", folder])
    assert "folder of geoaim place" in result.output
    result = run(app, ["view", folder, "--html", str(tmp_path / "view.html")])
    assert result.exit_code == 0, result.output
    result = run(app, ["convert", folder, "-o", str(tmp_path / "tracks.gpkg")])
    assert result.exit_code == 0, result.output
    result = run(app, ["texture", folder, str(tmp_path / "texture")])
    assert result.exit_code == 0, result.output
    agent = geoaim.read_tracks(folder).ids[0]
    command = ["render", folder, "--ego", agent, "--size", "64"]
    result = run(app, [*command, "-o", str(tmp_path / "view.png")])
    assert result.exit_code == 0, result.output
    result = run(app, ["render", f"{folder}/map.tif", *command[2:], "-o", f"{tmp_path}/a.png"])
    assert "needs --tracks" in " ".join(result.output.split())


def test_lights_go_into_the_folder_and_other_commands_show_them(video, junction, tmp_path):
    (left, top), _, (right, bottom), _ = junction[1].aim.corners
    x, y = (left + right) / 2, (top + bottom) / 2
    stop_line = Feature(LineString([[x - 2, y], [x + 2, y]]), {"signal": "a"})
    lines, lights = tmp_path / "lines.geojson", tmp_path / "states.csv"
    write_features([stop_line], World(None), lines)
    lights.write_text("time,signal,state\n0,a,red\n")
    given = {"lights": lights, "stop_lines": lines, "frame_resolution": RESOLUTION}
    folder = tmp_path / "junction"
    result = geoaim.place_video(video, folder, geoaim.Evidence(**given))
    assert result.known["lights: signals"] == "a"
    names = {path.name for path in folder.iterdir()}
    assert names == {*FILES, "lights.csv", "stop_lines.geojson"}
    output = ["-o", str(tmp_path / "simulated.csv")]
    simulated = run(app, ["simulate", str(folder), "--policy", "replay", *output])
    assert "red light" in simulated.output, simulated.output
    alone = run(app, ["simulate", str(junction[0]), "--policy", "replay", *output])
    assert alone.exit_code == 0
    assert "red light" not in alone.output


def test_a_folder_that_holds_files_and_a_single_frame_are_refused(junction, video):
    folder, _ = junction
    with pytest.raises(ValueError, match="name a new folder"):
        geoaim.place_video(video, folder)
    result = run(app, ["place", str(SAMPLES / "hover.mp4"), "-o", str(folder)])
    assert result.exit_code == 1
    still = open_video([next(iter(video)).image])
    with pytest.raises(VideoError, match="one frame"):
        geoaim.place_video(still, folder.parent / "still")
    assert not (folder.parent / "still").exists()


def test_evidence_that_contradicts_itself_is_refused(video, tmp_path):
    for evidence, message in (
        (geoaim.Evidence(near=(49.0, 36.0)), "need imagery"),
        (geoaim.Evidence(imagery="ortho.tif"), "no telemetry"),
        (geoaim.Evidence(imagery="ortho.tif", points="points.csv"), "give one"),
        (geoaim.Evidence(lights="lights.csv"), "need an HD map or stop lines"),
        (geoaim.Evidence(stop_lines="lines.geojson"), "need lights"),
        (geoaim.Evidence(frame_resolution=13.0), "narrower than a pixel"),
        (geoaim.Evidence(frame_resolution=-1.0), "positive number"),
    ):
        with pytest.raises(ValueError, match=message):
            geoaim.place_video(video, tmp_path / "folder", evidence)
    latitude, longitude = 54.7005, 28.291
    ortho = {"imagery": SAMPLES / "ortho.tif"}
    for near, message in (
        ((longitude, latitude), "give the latitude first"),
        ((10.0, 10.0), "another place"),
    ):
        with pytest.raises(AlignmentError, match=message):
            geoaim.place_video(video, tmp_path / "folder", geoaim.Evidence(near=near, **ortho))
    result = run(app, ["place", "samples/hover.mp4", "--near", "north", "-o", f"{tmp_path}/f"])
    assert "not latitude,longitude" in result.output


def test_without_vehicles_there_is_a_map_that_says_so_or_no_scale(video, tmp_path):
    shape = next(iter(video)).image.shape
    grain = np.random.default_rng(0).uniform(0, 255, shape)
    bare = cv2.GaussianBlur(grain, (0, 0), 2).astype(np.uint8)
    empty = open_video([bare] * 8, rate=8.0)
    with pytest.raises(GeoaimError, match="the scale is not known"):
        geoaim.place_video(empty, tmp_path / "unknown")
    evidence = geoaim.Evidence(frame_resolution=RESOLUTION)
    result = geoaim.place_video(empty, tmp_path / "empty", evidence)
    assert result.tracks is None
    assert "--detections" in result.missing["tracks"]
    names = sorted(path.name for path in (tmp_path / "empty").iterdir())
    assert names == ["map.png", "map.tif", "report.json"]


def test_a_scale_that_is_wrong_by_eight_is_named(junction):
    result = junction[1]
    tracks, aim = result.tracks, result.aim
    assert check_scale(tracks, aim) is None
    small = replace(tracks, sizes=tracks.sizes / 8)  # as if pixels were an eighth
    with pytest.warns(GeoaimWarning, match="as many metres"):
        assert check_scale(small, aim) == pytest.approx(8, rel=0.3)
