import json
import xml.etree.ElementTree as ET

import av
import cv2
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely

import geoaim
from benchmarks.synthetic import (
    list_boxes,
    make_sample,
    render_background,
    render_frame,
    tracks_of,
    write_sample,
)
from benchmarks.synthetic.video_files import CLASSES
from geoaim.base.geometry import transform_points
from geoaim.base.world import lonlat_from_world, world_from_lonlat
from geoaim.mapping import open_video, read_detections
from geoaim.mapping.video.srt import read_srt


@pytest.fixture(scope="module")
def folder(sample, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample")
    write_sample(sample, folder)
    return folder


def test_every_file_is_named_in_the_readme(folder):
    text = (folder / "README.md").read_text()
    for path in folder.iterdir():
        assert path.name == "README.md" or path.name in text, path.name
    assert "$" not in text
    assert 'make_sample(3, kind="junction", minutes=0.3, video=(180, 320)' in text


def test_control_points_reproject_within_a_hundredth_of_a_pixel(sample, folder):
    table = pd.read_csv(folder / "gcps.csv")
    assert list(table.columns) == ["name", "u", "v", "lon", "lat"]
    assert len(table) >= 8
    truth = np.load(folder / "truth.npz")
    world = world_from_lonlat(sample.place.world, table[["lon", "lat"]].to_numpy())
    pixels = transform_points(truth["frame_from_world"][0], world)
    assert np.hypot(*(pixels - table[["u", "v"]].to_numpy()).T).max() < 0.01


def test_video_holds_the_frames(sample, folder):
    with av.open(str(folder / "hover.mp4")) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 25
    assert np.abs(frames[12].astype(int) - render_frame(sample.clip, 12)).mean() < 6


def test_boxes_are_those_of_the_frames(sample, folder):
    assert len(list((folder / "boxes").iterdir())) == 25
    rows = [line.split() for line in (folder / "boxes" / "000012.txt").read_text().splitlines()]
    wanted = list_boxes(sample.clip, 12)
    assert len(rows) == len(wanted)
    left, _, right, _ = wanted[0]
    assert float(rows[0][1]) == pytest.approx((left + right) / 2 / 320, abs=1e-5)
    assert {row[0] for row in rows} <= set("012345")
    frame = next(iter(open_video(folder / "hover.mp4").frames_at([6.0])))
    read = read_detections(folder / "boxes", classes=CLASSES)
    np.testing.assert_allclose(read(frame).boxes, wanted, atol=0.01)


def test_background_is_the_first_frame_without_traffic(sample, folder):
    image = cv2.imread(str(folder / "background.jpg"))[..., ::-1].astype(int)
    assert np.abs(image - render_background(sample.clip)).mean() < 3


def test_tracks_read_back_and_lie_where_the_vehicles_are_seen(sample, folder):
    tracks = geoaim.read_tracks(folder / "tracks.csv")
    wanted = tracks_of(sample)
    np.testing.assert_allclose(tracks.states, wanted.states, atol=1e-3)
    assert tracks.types == wanted.types
    truth = np.load(folder / "truth.npz")
    frame = 12  # at 6 s
    step = int(np.flatnonzero(np.isclose(tracks.times, truth["times"][frame]))[0])
    pixels = transform_points(truth["frame_from_world"][frame], tracks.states[:, step, :2])
    boxes = list_boxes(sample.clip, frame)
    middles = (boxes[:, :2] + boxes[:, 2:]) / 2
    inside = np.array([kind in ("car", "van", "bus", "truck") for kind in tracks.types])
    inside &= tracks.present[:, step] & (pixels > 5).all(axis=1) & (pixels < [315, 175]).all(axis=1)
    for pixel in pixels[inside]:
        assert np.hypot(*(middles - pixel).T).min() < 1.0


def test_lights_tell_each_change_once(sample, folder):
    table = pd.read_csv(folder / "lights.csv")
    assert list(table.columns) == ["time", "signal", "state"]
    assert set(table["state"]) <= {"green", "yellow", "red"}
    assert set(table[table["time"] == 0]["signal"]) == set(sample.traffic_model.signals.names)
    for _, changes in table.groupby("signal"):
        assert (changes["state"] != changes["state"].shift()).all()


def test_sample_that_fails_leaves_nothing(sample, tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.synthetic.files.write_imagery", _fail)
    with pytest.raises(OSError, match="no space left"):
        write_sample(sample, tmp_path / "sample")
    assert list(tmp_path.iterdir()) == []


def _fail(*_):
    raise OSError("no space left")


def test_folder_that_holds_files_is_refused(sample, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match="holds thesis\\.tex; name a new folder"):
        write_sample(sample, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_maps_name_the_lights(sample, folder):
    signals = {name for name in sample.traffic_model.signals.names if not name.startswith("walk")}
    root = ET.parse(folder / "map.osm").getroot()
    named = {
        tag.attrib["v"]
        for relation in root.findall("relation")
        if any(t.attrib["v"] == "traffic_light" for t in relation.findall("tag"))
        for tag in relation.findall("tag")
        if tag.attrib["k"] == "name"
    }
    assert named == signals
    assert (folder / "map_full.osm").stat().st_size > (folder / "map.osm").stat().st_size


def test_surfaces_are_polygons_of_the_place(sample, folder):
    content = json.loads((folder / "surfaces.geojson").read_text())
    kinds = {feature["properties"]["kind"] for feature in content["features"]}
    assert {"carriageway", "pavement", "crossing", "car park"} <= kinds
    shapes = [shapely.geometry.shape(feature["geometry"]) for feature in content["features"]]
    assert all(shape.is_valid for shape in shapes)
    tracks = tracks_of(sample)
    lonlat = lonlat_from_world(sample.place.world, tracks.states[tracks.present][:, :2])
    ground = shapely.union_all(shapes)
    assert shapely.contains_xy(ground.buffer(3e-6), *lonlat.T).mean() > 0.98


def test_orthophoto_has_another_crs_and_alpha(folder):
    with rasterio.open(folder / "ortho.tif") as dataset:
        assert dataset.crs.to_epsg() == 3035
        assert dataset.count == 4
        assert dataset.res[0] == pytest.approx(0.2, rel=0.01)
        alpha = dataset.read(4)
    assert set(np.unique(alpha)) == {0, 255}
    offset = json.loads((folder / "truth.json").read_text())["imagery"]["offset_east_north_m"]
    assert 2.0 <= np.hypot(*offset) <= 6.1


def test_tiles_lie_in_folders_by_zoom_column_and_row(folder):
    tiles = list((folder / "tiles" / "19").glob("*/*.jpg"))
    assert len(tiles) > 8
    assert cv2.imread(str(tiles[0])).shape == (256, 256, 3)


def test_telemetry_tells_where_the_camera_is(sample, folder):
    telemetry, truth = read_srt(folder / "hover.SRT"), np.load(folder / "truth.npz")
    below = transform_points(truth["world_from_frame"], np.array([[160.0, 90.0]]))[:, 0]
    places = lonlat_from_world(sample.place.world, below)
    np.testing.assert_allclose(telemetry.longitude, places[:, 0], atol=2e-6)
    np.testing.assert_allclose(telemetry.latitude, places[:, 1], atol=2e-6)
    np.testing.assert_allclose(telemetry.time, sample.clip.times, atol=2e-3)
    up = transform_points(truth["world_from_frame"], np.array([[160.0, 89.0]]))[:, 0] - below
    yaw = np.arctan2(up[:, 1], up[:, 0])
    apart = (telemetry.yaw - yaw + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(apart, 0, atol=2e-3)
    side = transform_points(truth["world_from_frame"], np.array([[0.0, 90.0], [320.0, 90.0]]))
    wide = np.hypot(*(side[:, 1] - side[:, 0]).T)
    np.testing.assert_allclose(telemetry.height, wide * 24 / 36, rtol=1e-3)


def test_map_of_the_video_lies_on_the_truth(sample, folder):
    """The whole way on made files: the map's stop lines are where the place has them."""
    aim = geoaim.build_aim(folder / "hover.mp4", folder / "gcps.csv")
    truth = np.load(folder / "truth.npz")
    world_from_frame = truth["world_from_frame"][0]
    corners = transform_points(world_from_frame, np.array([[20.0, 20], [300, 20], [300, 160]]))
    world = aim.world.origin - np.array(sample.place.world.origin)
    found = transform_points(np.linalg.inv(aim.world_from_image), corners - world)
    apart = found - np.array([[20.0, 20], [300, 20], [300, 160]])
    assert np.abs(apart).max() < 0.6  # px, of 0.55 m


def test_sample_without_video_or_lights_leaves_their_files_out(tmp_path):
    sample = make_sample(2, kind="roundabout", minutes=0.05, video=None, resolution=0.2)
    write_sample(sample, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert not names & {"hover.mp4", "gcps.csv", "lights.csv", "boxes"}
    assert {"tracks.csv", "map.osm", "ortho.tif", "tiles", "truth.json"} <= names
    text = (tmp_path / "README.md").read_text()
    assert "hover.mp4" not in text
    assert "lights.csv" not in text
