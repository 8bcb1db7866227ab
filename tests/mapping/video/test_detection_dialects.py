"""Boxes in dialects and with slips: read rightly, or one line names the option that helps."""

import json
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from geoaim.base.errors import GeoaimError, GeoaimWarning
from geoaim.mapping.video.detection_checks import name_classes
from geoaim.mapping.video.detection_files import FORMATS
from geoaim.mapping.video.detections import read_detections
from geoaim.mapping.video.video import open_video

WIDTH, HEIGHT, FRAMES, RATE = 1280, 720, 30, 10.0


@pytest.fixture(scope="module")
def video():
    return open_video(np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8), rate=RATE)


@pytest.fixture(scope="module")
def truth():
    """Cars that drive across the frame, and are cut off by its border: left, top, right, bottom."""
    frames = []
    for step in range(FRAMES):
        x = np.linspace(0, WIDTH, 12) + 9.0 * step - 100
        y = np.linspace(5, HEIGHT - 5, 12)
        boxes = np.column_stack([x - 30, y - 12, x + 30, y + 12]).clip(0, [WIDTH, HEIGHT] * 2)
        frames.append(boxes[(boxes[:, 2:] - boxes[:, :2]).min(axis=1) > 3])
    return frames


def number(truth, first=0, stride=1):
    """Rows of frame, id and four numbers."""
    return np.array(
        [
            [step * stride + first, row + 1, *box]
            for step, boxes in enumerate(truth)
            for row, box in enumerate(boxes)
        ]
    )


def to_ltwh(boxes):
    return np.column_stack([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]])


def to_xywh(boxes):
    return np.column_stack([(boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]])


def read(source, video, **options):
    """Boxes of all frames, and what was said."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = read_detections(source, video=video, **options)
        frames = [found(frame) for frame in video]
    return frames, " ".join(str(w.message) for w in said if w.category is GeoaimWarning)


def check(frames, truth, atol=1.0):
    for found, boxes in zip(frames, truth, strict=True):
        np.testing.assert_allclose(found.boxes, boxes, atol=atol)


def write_rows(path, rows, header="", separator=","):
    lines = [separator.join(f"{value:g}" for value in row) for row in rows]
    path.write_text("\n".join([header] * bool(header) + lines) + "\n")
    return path


def write_csv(path, truth, names, convert=lambda boxes: boxes, clock=lambda step: step):
    rows = [
        [clock(step), *box] for step, boxes in enumerate(truth) for box in convert(boxes).tolist()
    ]
    return write_rows(path, rows, f"frame,{names}" if "frame" not in names else names)


@pytest.mark.parametrize("convert", [to_ltwh, to_xywh, lambda boxes: boxes])
def test_arrays_of_four_numbers_are_told_apart(truth, video, convert):
    frames, said = read([convert(boxes) for boxes in truth], video)
    check(frames, truth)
    assert bool(said) == (convert in (to_ltwh, to_xywh))


def test_a_score_and_a_class_may_follow_in_arrays(truth, video):
    entries = [np.column_stack([b, np.full(len(b), 0.7), np.full(len(b), 2.0)]) for b in truth]
    frames, _ = read(entries, video, classes=["2=bus"])
    check(frames, truth)
    assert (frames[3].scores[0], frames[3].types[0]) == (0.7, "bus")
    entries = [np.column_stack([boxes, np.arange(len(boxes)) + 3]) for boxes in truth]
    frames, said = read(entries, video)  # ids
    check(frames, truth)
    assert "scores are not used" in said


def test_columns_of_no_plain_meaning_are_refused(truth, video):
    for count, message in ((2, "the sixth column of boxes is no class"), (3, r"shape \(\d+, 7\)")):
        entries = [np.column_stack([b, np.full((len(b), count), 0.4)]) for b in truth]
        with pytest.raises(GeoaimError, match=f"{message}.*left, top, right, bottom.*two lines"):
            read(entries, video)


def test_results_in_a_stream_are_read(truth, video):
    part = [SimpleNamespace(xyxy=boxes, conf=np.full(len(boxes), 0.5)) for boxes in truth]
    frames, _ = read((SimpleNamespace(boxes=boxes, names={}) for boxes in part), video)
    check(frames, truth)
    with pytest.raises(GeoaimError, match="xyxy of the shape"):  # YOLOv5
        read([SimpleNamespace(xyxy=[boxes]) for boxes in truth], video)


@pytest.mark.parametrize(
    ("names", "convert"),
    [
        ("left,top,width,height", to_ltwh),
        ("x,y,w,h", to_xywh),
        ("x,y,w,h", to_ltwh),
        ("x1,y1,x2,y2", lambda boxes: boxes),
        ("x1,y1,x2,y2", lambda boxes: boxes / [WIDTH, HEIGHT, WIDTH, HEIGHT]),
        ("cx,cy,w,h", lambda boxes: to_xywh(boxes) / [WIDTH, HEIGHT, WIDTH, HEIGHT]),
    ],
)
def test_tables_in_any_form_and_unit(tmp_path, truth, video, names, convert):
    frames, said = read(write_csv(tmp_path / "a.csv", truth, names, convert), video)
    check(frames, truth)
    plain = names in ("left,top,width,height",) or (names == "x,y,w,h" and convert is to_xywh)
    assert plain or names == "x1,y1,x2,y2" or said


def test_sizes_that_do_not_fit_are_refused(tmp_path, truth, video):
    path = write_csv(tmp_path / "a.csv", truth, "x1,y1,x2,y2", lambda boxes: 2 * boxes)
    with pytest.raises(GeoaimError, match=r"do not lie in the picture of 1280 x 720.*--size"):
        read(path, video)
    check(read(path, video, size=(2 * WIDTH, 2 * HEIGHT))[0], truth)


@pytest.mark.parametrize("scale", [0.5, 100 / np.array([WIDTH, HEIGHT] * 2)])
def test_sizes_that_leave_the_picture_empty_are_said(tmp_path, truth, video, scale):
    path = write_csv(tmp_path / "a.csv", truth, "x1,y1,x2,y2", lambda boxes: scale * boxes)
    _, said = read(path, video)
    assert "of 1280 x 720 pixels only; if they are of pictures of another size" in said


def test_other_separators_decimals_and_clocks(tmp_path, truth, video):
    rows = number(truth)
    text = "\n".join(";".join(f"{v:.2f}".replace(".", ",") for v in row) for row in rows)
    path = tmp_path / "a.csv"
    path.write_text("frame;id;x1;y1;x2;y2\n" + text + "\n")
    check(read(path, video)[0], truth)
    seconds = np.column_stack([rows[:, 0] / RATE, rows[:, 2:]])
    frames, said = read(write_rows(path, seconds, "time,x1,y1,x2,y2"), video)
    check(frames, truth)
    assert said == ""
    unread = read_detections(path)
    with pytest.raises(GeoaimError, match="by time, and the times of the frames are not known"):
        unread(next(iter(video)))
    write_rows(path, seconds * [1e3, 1, 1, 1, 1], "time_ms,x1,y1,x2,y2")
    with pytest.raises(GeoaimError, match=r"time_ms, x1, .* time \(s\) .* is needed.*two lines"):
        read(path, video)


@pytest.mark.parametrize("clock", ["rate", "time", "stride"])
def test_boxes_of_some_frames_belong_to_their_nearest_one(tmp_path, truth, video, clock):
    kept = truth[::5]
    options = {"rate": RATE / 5} if clock == "rate" else {}
    factor = {"rate": 1, "time": 5 / RATE, "stride": 5}[clock]
    rows = [[factor * step, *box] for step, boxes in enumerate(kept) for box in boxes]
    name = "time" if clock == "time" else "frame"
    path = write_rows(tmp_path / "a.csv", rows, f"{name},x1,y1,x2,y2")
    frames, _ = read(path, video, **options)
    for step, found in enumerate(frames):
        assert (found is not None) == (step % 5 == 0)
    check(frames[::5], kept)


def test_files_of_every_third_frame_numbered_on_are_said_and_read_by_their_rate(
    tmp_path, truth, video
):
    for step in range(0, FRAMES, 3):
        rows = to_xywh(truth[step])
        lines = [f"0 {x / WIDTH} {y / HEIGHT} {w / WIDTH} {h / HEIGHT}" for x, y, w, h in rows]
        (tmp_path / f"{step // 3:06d}.txt").write_text("\n".join(lines))
    _, said = read(tmp_path, video)
    assert "give their --rate" in said
    frames, said = read(tmp_path, video, rate=RATE / 3)
    assert said == ""
    known = [step for step, boxes in enumerate(frames) if boxes is not None]
    assert known == list(range(0, FRAMES, 3))
    np.testing.assert_allclose(frames[27].boxes, truth[27], atol=0.1)


def test_boxes_after_the_end_of_the_video_are_said(tmp_path, truth, video):
    rows = number(truth + truth)
    table = pd.DataFrame(rows, columns=["time", "id", "left", "top", "right", "bottom"])
    table["time"] /= RATE
    table.to_csv(tmp_path / "boxes.csv", index=False)
    _, said = read(tmp_path / "boxes.csv", video)
    assert "after the video's end (2.9 s), up to 5.9 s" in said


def test_a_column_of_angles_is_said(tmp_path, truth, video):
    rows = number(truth)
    table = pd.DataFrame(rows, columns=["frame", "id", "left", "top", "right", "bottom"])
    table.assign(angle=20.0).to_csv(tmp_path / "boxes.csv", index=False)
    _, said = read(tmp_path / "boxes.csv", video)
    assert "its angle is not read" in said


def test_boxes_of_some_frames_without_a_rate_are_said(tmp_path, truth, video):
    path = write_csv(tmp_path / "a.csv", truth[::5], "x1,y1,x2,y2")
    _, said = read(path, video)
    assert "end at 5 and the video has 30 frames" in said
    assert "--rate" in said


def test_a_wrong_frame_number_does_not_fill_memory(tmp_path):
    path = write_rows(tmp_path / "a.csv", [[0, 1, 1, 5, 5], [2e9, 1, 1, 5, 5]], "frame,x1,y1,x2,y2")
    assert read_detections(path) is not None


@pytest.mark.parametrize("tail", [(1, 1, 1), (0, 0, 0), (-1, -1, -1)])
def test_the_tail_of_mot_is_no_class(tmp_path, truth, video, tail):
    rows = number(truth, first=1)
    values = np.column_stack([rows[:, :2], to_ltwh(rows[:, 2:]), np.full(len(rows), 0.9)])
    values = np.column_stack([values, np.tile(tail, (len(rows), 1))])
    frames, _ = read(write_rows(tmp_path / "det.txt", values), video)
    check(frames, truth)
    assert set(frames[0].types) == {""}


def test_classes_of_mot(tmp_path, truth, video):
    rows = number(truth, first=1)
    box = np.column_stack([rows[:, :2], to_ltwh(rows[:, 2:])])
    kinds = 1 + rows[:, 1:2] % 3
    ones = np.ones((len(rows), 1))
    names = ("car", "van", "bus")
    for values in ([box, ones, kinds], [box, ones, kinds, 0.5 * ones]):  # 8 and 9 columns
        frames, said = read(
            write_rows(tmp_path / "gt.txt", np.hstack(values)), video, classes=names
        )
        assert frames[0].types == tuple(names[int(kind) - 1] for kind in kinds[: len(truth[0]), 0])
        assert "count from 1" in said
    visdrone = np.hstack([box, ones, kinds, 0 * ones, kinds % 2])
    pairs = ["0=ignored", "1=ignored", "2=car", "3=van"]
    frames, said = read(write_rows(tmp_path / "a.txt", visdrone), video, classes=pairs)
    assert (set(frames[0].types), said) == ({"car", "van"}, "")


def test_classes_may_be_given_by_number(tmp_path, truth, video):
    table = pd.DataFrame(
        number(truth)[:, [0, 2, 3, 4, 5]], columns=["frame", "x1", "y1", "x2", "y2"]
    )
    frames, _ = read(table.assign(class_id=7), video, classes=["7=bus"])
    assert frames[0].types[0] == "bus"
    _, said = read(table.assign(class_id=7), video, classes=["car"])
    assert "7 have no name" in said


def make_coco(truth, convert, **fields):
    return [
        {"image_id": step, "category_id": 2, "bbox": box, "score": 0.5, **fields}
        for step, boxes in enumerate(truth)
        for box in convert(boxes).tolist()
    ]


@pytest.mark.parametrize("convert", [to_ltwh, lambda boxes: boxes])
def test_coco_results_have_classes_and_either_form(tmp_path, truth, video, convert):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(make_coco(truth, convert)))
    frames, said = read(path, video, classes=["car", "bus"])
    check(frames, truth)
    assert frames[0].types[0] == "bus"
    assert ("--form ltwh" in said) == (convert is not to_ltwh)


def test_coco_of_resized_pictures_is_scaled(tmp_path, truth, video):
    content = {
        "images": [
            {"id": step, "file_name": f"{step}.jpg", "width": WIDTH // 2, "height": HEIGHT // 2}
            for step in range(FRAMES)
        ],
        "annotations": make_coco(truth, lambda boxes: to_ltwh(boxes / 2)),
    }
    (tmp_path / "a.json").write_text(json.dumps(content))
    frames, said = read(tmp_path / "a.json", video)
    check(frames, truth)
    assert "640 x 360" in said


def test_json_of_other_programs_is_refused_with_the_way(tmp_path, truth, video):
    names = ["x_min", "y_min", "x_max", "y_max"]
    rows = [
        dict(zip(names, box, strict=True)) | {"class_id": 2, "frame_index": step}
        for step, boxes in enumerate(truth)
        for box in boxes.tolist()
    ]
    (tmp_path / "a.json").write_text(json.dumps(rows))
    with pytest.raises(GeoaimError, match=r"not COCO.*read_detections\(pandas\.read_json\('a.json"):
        read(tmp_path / "a.json", video)
    check(read(pd.read_json(tmp_path / "a.json"), video)[0], truth)


def test_polygons_of_four_points_are_no_oriented_boxes(tmp_path, video):
    (tmp_path / "0.txt").write_text("0 0.10 0.10 0.20 0.14 0.17 0.30 0.12 0.28\n" * 3)
    frames, said = read(tmp_path, video)
    assert frames[0].corners is None
    assert "no rectangles" in said


def test_scores_and_areas_that_cannot_be_are_said(truth, video):
    table = pd.DataFrame(number(truth), columns=["frame", "id", "x1", "y1", "x2", "y2"])
    for score in (85.0, -3.5):
        frames, said = read(table.assign(score=score), video)
        assert "scores are not used" in said
        assert np.isnan(frames[0].scores).all()
    table.loc[0, "x2"] = table.loc[0, "x1"]
    frames, said = read(table, video)
    assert "1 boxes without an area" in said
    assert len(frames[0].boxes) == len(truth[0]) - 1
    broken = [boxes.copy() for boxes in truth]
    broken[0][0, 0] = np.nan
    frames, said = read(broken, video)
    assert "values missing" in said
    assert len(frames[0].boxes) == len(truth[0]) - 1


def test_images_of_a_folder_may_be_named_in_a_table(tmp_path, truth, video):
    named = replace(video, names=tuple(f"img_{step:03d}.jpg" for step in range(FRAMES)))
    frames = [replace(frame, name=name) for frame, name in zip(video, named.names, strict=True)]
    rows = [[f"img_{int(row[0]):03d}.jpg", *row[2:]] for row in number(truth)]
    table = pd.DataFrame(rows, columns=["image", "x1", "y1", "x2", "y2"])
    found = read_detections(table, video=named)
    check([found(frame) for frame in frames], truth)


def test_the_docs_have_a_row_for_each_format():
    page = (Path(__file__).parents[3] / "docs/formats/detections.md").read_text()
    for known in FORMATS:
        assert f"\n| {known} |" in page


def test_numbers_of_classes_count_from_0_and_otherwise_by_pairs():
    names = ["car", "bus"]
    assert name_classes(["0", "1"], names, None) == (names, "")
    found, remark = name_classes(["1", "2"], names, None)
    assert (found, remark) == (["bus", "2"], "its classes 2 have no name in --classes")
    found, remark = name_classes(["1", "1"], names, None)
    assert found == ["bus", "bus"]
    assert "count from 0, it is assumed; --classes 1=... says otherwise" in remark
    found, remark = name_classes(["1", "2"], names, 1)
    assert found == names
    assert "count from 1" in remark
    assert name_classes(["7=", "7"], ["7=truck"], 0)[0] == ["7=", "truck"]
    found, remark = name_classes(["0", "5"], names, 0)
    assert found == ["car", "5"]
    assert "5 have no name" in remark
