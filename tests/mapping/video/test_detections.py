from types import SimpleNamespace

import numpy as np
import pytest

from geoaim.base.errors import GeoaimError
from geoaim.mapping.video.detections import DetectedBoxes, mask_boxes, read_detections
from geoaim.mapping.video.video import open_video


@pytest.fixture
def frame():
    return next(iter(open_video(np.zeros((2, 100, 200, 3), np.uint8))))


def test_yolo_rows_become_pixel_boxes(tmp_path, frame):
    (tmp_path / "000000.txt").write_text("2 0.5 0.5 0.1 0.2\n")
    np.testing.assert_allclose(read_detections(tmp_path)(frame).boxes, [[90, 40, 110, 60]])


def test_a_frame_without_a_file_has_no_boxes(tmp_path, frame):
    (tmp_path / "7.txt").write_text("")
    assert read_detections(tmp_path)(frame) is None


def test_pixels_in_place_of_shares_are_refused(tmp_path, frame):
    (tmp_path / "0.txt").write_text("0 90 40 20 20\n")
    with pytest.raises(GeoaimError, match="shares of the size"):
        read_detections(tmp_path)(frame)


def test_a_folder_without_text_files_is_refused(tmp_path):
    with pytest.raises(GeoaimError, match=r"no \.txt files"):
        read_detections(tmp_path)


def test_mask_covers_the_grown_box_and_no_more():
    mask = mask_boxes(np.array([[40.0, 40, 60, 60]]), (100, 100))
    assert mask[38:62, 38:62].all()
    assert mask.sum() == 24 * 24


def test_results_of_ultralytics_and_supervision_are_read_by_their_attributes(frame):
    boxes = np.array([[1.0, 2, 3, 4]])
    of_supervision = SimpleNamespace(
        xyxy=boxes,
        confidence=np.array([0.5]),
        class_id=np.array([2]),
        data={"class_name": np.array(["person"])},
    )
    part = SimpleNamespace(xyxy=boxes, conf=np.array([0.5]), cls=np.array([0]))
    of_ultralytics = SimpleNamespace(boxes=part, obb=None, names={0: "person"})
    for value in (of_supervision, of_ultralytics):
        found = read_detections([value])(frame)
        np.testing.assert_array_equal(found.boxes, boxes)
        assert (found.types, found.scores.tolist()) == (("pedestrian",), [0.5])


def test_classes_of_aerial_data_sets_are_types_or_left_to_the_size(frame):
    corners = np.array([[[0.0, 0], [1, 0], [1, 4], [0, 4]]] * 2)
    cls, names = np.array([0, 1]), {0: "small vehicle", 1: "large vehicle"}
    obb = SimpleNamespace(xyxy=corners[:, ::2].reshape(-1, 4), xyxyxyxy=corners, cls=cls, conf=None)
    found = read_detections(lambda _: SimpleNamespace(obb=obb, names=names))(frame)
    assert found.types == ("car", "")


def test_boxes_made_in_python_have_types_by_any_usual_name(frame):
    boxes = DetectedBoxes(np.array([[1.0, 2, 3, 5]]), types=("Person",))
    for source in ([boxes], lambda _: boxes):
        assert read_detections(source)(frame).types == ("pedestrian",)


def test_oriented_boxes_begin_with_a_long_side(frame):
    corners = np.array([[[0.0, 0], [1, 0], [1, 4], [0, 4]]])
    obb = SimpleNamespace(xyxy=np.array([[0.0, 0, 1, 4]]), xyxyxyxy=corners, cls=None)
    found = read_detections(lambda _: SimpleNamespace(obb=obb, names={}))(frame)
    np.testing.assert_array_equal(found.corners[0, :2], [[1, 0], [1, 4]])


def test_an_entry_of_none_has_no_labels(frame):
    assert read_detections([None])(frame) is None
    assert read_detections([])(frame) is None
