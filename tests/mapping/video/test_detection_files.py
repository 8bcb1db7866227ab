"""Files of detections, each of a format that a detector or a dataset has."""

import json

import numpy as np
import pandas as pd
import pytest

from geoaim.base.errors import GeoaimError
from geoaim.mapping.video.detection_columns import parse_columns
from geoaim.mapping.video.detections import read_detections
from geoaim.mapping.video.frames import Frame

HEIGHT, WIDTH = 100, 200
BOX = [90.0, 40, 110, 60]


def read_frame(source, index=0, time=0.0, name=None, **options):
    frame = Frame(index, time, name, np.zeros((HEIGHT, WIDTH), np.uint8))
    return read_detections(source, **options)(frame)


def write(path, text):
    path.write_text(text)
    return path


def test_yolo_rows_have_confidence_and_id(tmp_path):
    write(tmp_path / "000000.txt", "2 0.5 0.5 0.1 0.2 0.75 12\n")
    write(tmp_path / "classes.txt", "person\nbus\ncar\n")
    found = read_frame(tmp_path)
    np.testing.assert_allclose(found.boxes, [BOX])
    assert (found.types, found.scores.tolist()) == (("car",), [0.75])


def test_the_only_further_field_of_yolo_is_an_id_where_it_is_whole(tmp_path):
    write(tmp_path / "0.txt", "0 0.5 0.5 0.1 0.2 1\n0 0.2 0.5 0.1 0.2 2\n")
    assert np.isnan(read_frame(tmp_path).scores).all()
    write(tmp_path / "0.txt", "0 0.5 0.5 0.1 0.2 0.9\n0 0.2 0.5 0.1 0.2 1\n")
    assert read_frame(tmp_path).scores.tolist() == [0.9, 1.0]


def test_oriented_yolo_boxes_keep_their_corners(tmp_path):
    write(tmp_path / "0.txt", "1 0.4 0.4 0.6 0.4 0.6 0.6 0.4 0.6 0.5 3\n")
    found = read_frame(tmp_path, classes=["car", "bus"])
    np.testing.assert_allclose(found.corners, [[[80, 40], [120, 40], [120, 60], [80, 60]]])
    np.testing.assert_allclose(found.boxes, [[80, 40, 120, 60]])
    assert found.types == ("bus",)


def test_mot_text_counts_frames_from_one(tmp_path):
    path = write(tmp_path / "det.txt", "1,7,90,40,20,20,0.5,-1,-1,-1\n3,7,0,0,2,2,0.5,-1,-1,-1\n")
    found = read_frame(path)
    np.testing.assert_allclose(found.boxes, [BOX])
    assert found.types == ("",)
    assert len(read_frame(path, index=1).boxes) == 0  # between frames with boxes
    assert read_frame(path, index=9) is None


def test_coco_images_are_found_by_name(tmp_path):
    content = {
        "images": [{"id": 4, "file_name": "a/f1.jpg"}, {"id": 5, "file_name": "f2.jpg"}],
        "categories": [{"id": 3, "name": "person"}],
        "annotations": [{"image_id": 4, "category_id": 3, "bbox": [90, 40, 20, 20], "track_id": 1}],
    }
    path = write(tmp_path / "a.json", json.dumps(content))
    found = read_frame(path, name="f1.jpg")
    np.testing.assert_allclose(found.boxes, [BOX])
    assert found.types == ("pedestrian",)
    assert len(read_frame(path, name="f2.jpg").boxes) == 0
    results = [{"image_id": 0, "category_id": 3, "bbox": [90, 40, 20, 20], "score": 0.5}]
    assert read_frame(write(tmp_path / "b.json", json.dumps(results))).scores.tolist() == [0.5]


def test_columns_of_any_table_may_be_named(tmp_path):
    path = write(tmp_path / "a.csv", "f,px,py,kind\n20,100,50,Car\n")
    found = read_frame(path, index=20, columns=parse_columns("frame=f,x=px,y=py,class=kind"))
    np.testing.assert_allclose(found.boxes, [[100, 50, 100, 50]])
    assert found.types == ("car",)


def test_unknown_columns_are_named_with_what_is_needed(tmp_path):
    path = write(tmp_path / "a.csv", "frame,foo,bar\n0,1,2\n")
    with pytest.raises(
        GeoaimError, match=r"foo, bar; x and y, .* is needed: .*--columns.*two lines"
    ):
        read_detections(path)
    with pytest.raises(GeoaimError, match="lacks the columns nope"):
        read_detections(path, columns={"x": "nope"})
    with pytest.raises(GeoaimError, match="x is 'a' in row 1; a number is needed"):
        read_detections(write(tmp_path / "b.csv", "frame,x,y\n0,a,2\n"))
    with pytest.raises(ValueError, match="columns 'x' are not of the form"):
        parse_columns("x")


def test_other_files_are_refused(tmp_path):
    for count in (5, 11, 14):  # geo-trax has 14
        with pytest.raises(GeoaimError, match=f"{count} columns and no header.*two lines"):
            read_detections(write(tmp_path / "a.txt", ",".join("1" * count)))
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_detections(tmp_path / "none")
    with pytest.raises(GeoaimError, match="has no annotations"):
        read_detections(write(tmp_path / "a.json", "[]"))


def test_names_of_supervisions_sink_are_known():
    values = {"x_min": 90, "y_min": 40, "x_max": 110, "y_max": 60, "class_id": 2}
    values |= {"confidence": 0.5, "tracker_id": 7, "class_name": "person", "frame_index": 0}
    found = read_frame(pd.DataFrame([values]))
    np.testing.assert_allclose(found.boxes, [BOX])
    assert (found.types, found.scores.tolist()) == (("pedestrian",), [0.5])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1e300,1,5,10,10,10,0.9,-1,-1,-1\n2,1,5,10,10,10,0.9,-1,-1,-1\n", "frame is missing"),
        ("1,1,5,10,10,10,inf,-1,-1,-1\n2,1,5,10,10,10,0.9,-1,-1,-1\n", "score is infinite"),
    ],
)
def test_numbers_that_no_frame_or_score_has_are_refused(tmp_path, text, reason):
    path = tmp_path / "mot.txt"
    path.write_text(text)
    with pytest.raises(GeoaimError, match=reason):
        read_detections(path)


def test_a_score_that_is_no_number_is_refused_when_the_file_is_read(tmp_path):
    path = tmp_path / "results.json"
    path.write_text('[{"image_id": 1, "category_id": 3, "bbox": [5, 5, 9, 9], "score": [1]}]')
    with pytest.raises(GeoaimError, match=r"results\.json"):
        read_detections(path)
