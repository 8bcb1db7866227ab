"""Small inputs whose harm was large: each gives one line that names the file."""

import json
from pathlib import Path

import numpy as np
import pytest

from geoaim.aim.texture_files import read_texture
from geoaim.base.errors import GeoaimError
from geoaim.catalog.recordings import read_recordings
from geoaim.cli.info import describe_file
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.mapping.georeference.control_points import read_control_points
from geoaim.mapping.texture import export_texture
from geoaim.mapping.video.detections import read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.srt import read_srt
from geoaim.mapping.video.video import open_video
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import read_light_changes
from tests.faults.seeds import make_aim

FRAME = Frame(0, 0.0, "000000", np.zeros((48, 64), np.uint8))
WINDOW = "frame,track,u_px,v_px\n" + "".join(f"{12 * k},1,{k},2\n" for k in range(20))
HUGE = "9" * 5000  # more digits than Python makes a number of


def read_boxes(path: Path):
    return read_detections(path)(FRAME)


POINTS = "u,v,x,y,crs\n"
TRACKS = "# crs: local\nid,type,time,x,y,heading,speed,length,width\n"
CASES = {  # the file at fault, its content, what reads it, and what is read if it is another one
    "too many points": ("p.csv", POINTS + "1,2,3,4,local\n" * 10_001, read_control_points),
    "points of Latin-1": ("p.csv", (POINTS + "1,2,3,é,local\n").encode("latin-1"), None),
    "a point's digits": ("p.csv", f"{POINTS}{HUGE},2,3,4,local\n", read_control_points),
    "a point's infinity": ("p.csv", f"{POINTS}inf,2,3,4,local\n", read_control_points),
    "a point's CRS": ("p.csv", f"{POINTS}1,2,3,4,EPSG:{HUGE}\n", read_control_points),
    "covariance": ("p.csv", f"# shared covariance: 1 9 1\n{POINTS}1,2,3,4,local\n", None),
    "typo in YOLO": ("b/000001.txt", "0 O.5 0.5 0.1 0.1\n", read_boxes, "b"),
    "YOLO in pixels": ("b/000001.txt", "0 50 50 10 10\n", read_boxes, "b"),
    "MOT's negative frame": ("m.txt", "-5,1,1,2,9,9,1,-1,-1,-1\n" * 2, read_boxes),
    "COCO without boxes": ("c.json", '{"annotations": [{"image_id": 1}], "images": []}', None),
    "JSON of digits": ("c.json", f"[{HUGE}]", read_boxes),
    "JSON of brackets": ("c.json", "[" * 100_000, read_boxes),
    "scale with a unit": ("scenes.csv", "scene,metres_per_pixel\nw,0.04 m\n", read_tracks, "w.csv"),
    "scenes of Latin-1": ("scenes.csv", "scene\né".encode("latin-1"), read_tracks, "w.csv"),
    "scenes without rows": ("scenes.csv", "scene,metres_per_pixel\n", read_tracks, "w.csv"),
    "scene twice": ("scenes.csv", "scene,metres_per_pixel\nw,1\nw,2\n", read_tracks, "w.csv"),
    "scale of 0": ("scenes.csv", "scene,metres_per_pixel\nw,0\n", read_tracks, "w.csv"),
    "tracks of digits": ("t.csv", f"{TRACKS}1,car,0,{HUGE},2,0,0,4,2\n", read_tracks),
    "tracks' format": ("t.csv", f"# format: {HUGE}\n{TRACKS}1,car,0,1,2,0,0,4,2\n", read_tracks),
    "tracks' origin": ("t.csv", f"# origin: a b\n{TRACKS}1,car,0,1,2,0,0,4,2\n", read_tracks),
    "lights of Latin-1": ("l.csv", "time,signal,state\n0,é,red\n".encode("latin-1"), None),
    "a map's digits": ("m.osm", f'<osm><node id="{HUGE}" lat="1" lon="{HUGE}"/></osm>', read_hdmap),
    "catalogue of Latin-1": ("r.csv", "name,video\né,a.mp4\n".encode("latin-1"), read_recordings),
    "catalogue of digits": ("r.csv", f"name,video,height\na,a.mp4,{HUGE}\n", read_recordings),
    "telemetry": ("s.srt", "1\n00:00:00,000 --> 00:00:00,033\n[latitude: 1" + HUGE, read_srt),
    "no video": ("v.mp4", "text", open_video),
    "no image": ("v.png", "text", open_video),
}
USUAL = {".csv": read_control_points, ".json": read_boxes}


def refuse(read, source: Path, named: str) -> str:
    with pytest.raises(GeoaimError) as caught:
        read(source)
    line = str(caught.value)
    assert named in line
    assert "\n" not in line
    assert len(line) < 1200
    return line


@pytest.mark.parametrize("name", CASES)
@pytest.mark.filterwarnings("ignore::geoaim.GeoaimWarning")
def test_one_line_names_the_file(name, tmp_path):
    file, content, read, *source = CASES[name]
    path = tmp_path / file
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    if file == "scenes.csv":
        (tmp_path / "w.csv").write_text(WINDOW)
    if name.startswith("lights"):
        read = read_light_changes
    refuse(read or USUAL[path.suffix], tmp_path.joinpath(*source or [file]), path.name)


READERS = {
    *(("p.csv", read_control_points), ("c.json", read_boxes), ("c.xml", read_boxes)),
    *(("l.csv", read_light_changes), ("m.osm", read_hdmap), ("r.csv", read_recordings)),
    *(("s.srt", read_srt), ("t.parquet", read_tracks), ("t.gpkg", read_tracks)),
    *(("t.csv", read_tracks), ("v.mp4", open_video), ("v.png", open_video)),
}


@pytest.mark.parametrize(("name", "read"), sorted(READERS, key=str))
def test_a_folder_in_place_of_a_file_is_named(name, read, tmp_path):
    (tmp_path / name).mkdir()
    refuse(read, tmp_path / name, name)


PLACES = {
    "empty": {},
    "a list": [],
    "a text": "here",
    "a number": 7,
    "nothing": None,
    "crs": {"crs": 7},
    "matrix": {"crs_from_image": [[1, 2], [3, 4]]},
    "singular": {"crs_from_image": [[0, 0, 0]] * 3},
    "infinite": {"crs_from_image": [[float("inf"), 0, 0], [0, 1, 0], [0, 0, 1]]},
    "words": {"crs_from_image": "abc"},
    "width": {"width": "a"},
    "height": {"height": 0},
}


@pytest.mark.parametrize("name", PLACES)
def test_a_texture_with_a_malformed_place_is_refused_by_all_alike(name, tmp_path):
    export_texture(make_aim(), tmp_path)
    path = tmp_path / "texture.json"
    frame = json.loads(path.read_text())
    wrong = PLACES[name]
    whole = isinstance(wrong, dict) and wrong
    place = {"crs": None, "crs_from_image": np.eye(3).tolist(), "height": 9, "width": 9}
    path.write_text(json.dumps({**frame, "place": place | wrong if whole else wrong}))
    line = refuse(read_texture, tmp_path, "texture.json")
    assert line == refuse(lambda folder: describe_file(str(folder)), tmp_path, "texture.json")


def test_a_part_of_a_video_may_have_a_thousand_digits():
    with pytest.raises(GeoaimError, match=r"missing\.mp4: there is no such file"):
        open_video(f"missing.mp4#t=0,{'9' * 1000}")
    with pytest.raises(GeoaimError, match="no such file"):
        open_video("9" * 1000)
