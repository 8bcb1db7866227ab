"""Inputs of unusual kinds and names: pipes are read once, and odd names give pictures."""

import os
import sys
import threading

import cv2
import numpy as np
import pytest

from geoaim.aim.files import read_aim
from geoaim.base.errors import GeoaimError
from geoaim.base.geojson import read_features
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.mapping.georeference.point_files import read_point_file
from geoaim.mapping.video.srt import read_srt
from geoaim.mapping.video.video import open_video
from geoaim.prediction.checkpoints import read_model
from geoaim.tracks.formats.formats import read_tracks
from geoaim.tracks.lights import StopLine, read_lights
from tests.faults.seeds import TABLES, WORLD
from tests.waiting import LIMIT_S

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no pipes with names")
LINE = StopLine("east", np.array([[0.0, 0.0], [0.0, 3.0]]))
READERS = {
    "map.osm": read_hdmap,
    "lines.geojson": lambda path: read_features(path, WORLD),
    "gcps.csv": read_point_file,
    "gcp_list.txt": read_point_file,
    "qgis.points": read_point_file,
    "lights.csv": lambda path: read_lights(path, [LINE], WORLD),
    "bracketed.srt": read_srt,
}
NAMES = ("1²2.jpg", "½.jpg", "٣.jpg", "a b\n.jpg", "[x]*?.jpg", "-1.jpg", "é\u0301.jpg")


@pytest.mark.parametrize("name", READERS)
def test_pipe_is_read_once(tmp_path, name):
    pipe = tmp_path / name
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=(TABLES[name],), daemon=True)
    writer.start()
    assert READERS[name](pipe)
    writer.join(LIMIT_S)
    assert not writer.is_alive()


@pytest.mark.parametrize("read", [read_aim, read_model, read_tracks, open_video])
def test_pipe_that_would_be_read_twice_is_refused(tmp_path, read):
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(GeoaimError, match="is a pipe or a device, which is read once; save it"):
        read(tmp_path / "pipe.csv")


@pytest.mark.parametrize("name", ["map.osm", "lines.geojson", "gcps.csv", "lights.csv"])
def test_folder_instead_of_a_file_is_named(tmp_path, name):
    with pytest.raises(GeoaimError, match=rf"{tmp_path.name} is "):
        READERS[name](tmp_path)


@pytest.mark.parametrize("name", NAMES)
def test_picture_with_an_odd_name_is_read(tmp_path, name):
    picture = cv2.imencode(".jpg", np.full((8, 9, 3), 70, np.uint8))[1].tobytes()
    (tmp_path / name).write_bytes(picture)
    (frame,) = open_video(tmp_path)
    assert frame.name == name
    assert abs(int(frame.image.mean()) - 70) < 3


def test_name_that_is_not_utf8_is_refused_in_a_line(tmp_path):
    (tmp_path / "\udcff.jpg").write_bytes(b"")
    with pytest.raises(GeoaimError, match="is not an image that can be read"):
        list(open_video(tmp_path))
