from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.background import benchmark as background_results
from benchmarks.background import crops, hover, long_queues, own_boxes
from benchmarks.background import real as background_real
from benchmarks.background.drawn_queue import draw_queue
from benchmarks.background.methods import (
    METHODS,
    damage_boxes,
    divide_zones,
    list_frames,
    measure_background,
    measure_gradient_energy,
    measure_methods,
)
from benchmarks.background.queue_clips import QueueClip, paste_queue
from benchmarks.background.signal_queue import film_signal
from geoaim.base.errors import RegistrationError
from geoaim.base.progress import no_progress
from geoaim.mapping.background.running_mean import Background
from geoaim.mapping.video.detections import read_detections
from geoaim.mapping.video.frames import Frame
from tests.mapping.background.clips import make_ground, queue

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def clip():
    return draw_queue(standing=0.6, seed=0, count=24)


@pytest.fixture(scope="module")
def small():
    """A clip with boxes in which a car stands for 60 % of the time."""
    ground = make_ground()
    share = np.zeros(ground.shape[:2], np.float32)
    share[40:60, 60:100], share[80:100], share[:10] = 0.6, 0.2, np.nan
    boxes = tuple(np.array([[60.0, 40.0, 100.0, 60.0]]) for _ in range(16))
    transforms = np.tile(np.eye(3), (16, 1, 1))
    return QueueClip(np.stack(queue(ground, count=16)), ground, share, transforms, boxes)


def test_each_method_is_measured_in_each_zone(small):
    rows = {row["method"]: row for row in measure_methods(small)}
    assert list(rows) == list(METHODS)
    for row in rows.values():
        assert np.isfinite([row[key] for key in ("static", "passed", "stood", "ms")]).all()
        assert row["static"] < 10


def test_clips_without_boxes_leave_out_the_method_that_needs_them(clip):
    assert "geoaim with boxes" not in [row["method"] for row in measure_methods(clip)]


def test_zones_leave_out_what_is_unknown():
    zones = divide_zones(np.array([[np.nan, 0.0, 0.1, 0.7]], np.float32))
    assert [int(np.flatnonzero(zone)[0]) for zone in zones.values()] == [1, 2, 3]
    assert sum(zone.sum() for zone in zones.values()) == 3


def test_gradient_energy_of_the_frame_itself_is_one(small):
    where = np.isfinite(small.share)
    same = QueueClip(small.ground[None], small.ground, small.share)
    assert measure_gradient_energy(small.ground, same, where) == pytest.approx(1)


def test_ground_of_a_drawn_queue_shows_where_no_car_is(clip):
    free = clip.share == 0
    error = np.abs(np.median(clip.frames, axis=0) - clip.ground)[free]
    assert error.mean() < 2
    assert (clip.share > 0.5).mean() > 0.02


def test_standing_queue_is_removed_and_most_wrong_pixels_are_marked(clip):
    ours = measure_background(clip, METHODS["geoaim"])
    assert ours["stood"] < 20
    assert ours["wrong marked %"] > 50
    assert ours["good marked %"] < 4  # 6 % of this map are wrong
    assert measure_background(clip, METHODS["median"])["stood"] > 2 * ours["stood"]


def test_pasted_queue_has_ground_that_its_frames_show(data_folder):
    clip = paste_queue("munich_mos074", standing=0.6, seed=0, count=8)
    free = clip.share == 0
    assert np.abs(clip.frames[0][free].astype(int) - clip.ground[free]).mean() < 8
    assert 0.01 < (clip.share >= 0.5).mean() < 0.3


def test_real_sequences_are_compared(data_folder, monkeypatch):
    monkeypatch.setattr(background_real, "PLACES", ("hover/minsk_junction",))
    row = next(background_real.measure_real(data_folder))
    assert row["registered"] == "26 of 26"
    assert 0 < row["differs from boxes %"] < 10


def test_the_benchmark_has_tables_and_charts(monkeypatch, small):
    monkeypatch.delenv("GEOAIM_DATA", raising=False)
    monkeypatch.setattr(background_results, "COUNTS", (8, 16))
    monkeypatch.setattr(background_results, "FRAMES", 16)
    monkeypatch.setattr(background_results, "make_clips", lambda *_, **__: [("small", 1, small)])
    results = background_results.measure_backgrounds(True, no_progress)
    assert [row["method"] for row in results.tables["rows"]] == list(METHODS)
    assert [row["setting"] for row in results.tables["defaults"]] == ["frames"]
    [case] = results.tables["cases"]
    assert len(case["errors"]) == 2
    assert list(results.charts) == ["fronts", "sizes"]


def test_a_signal_holds_a_queue_in_the_middle_of_the_clip_and_the_ground_is_seen_around():
    clip = film_signal(standing=0.6, seed=0, count=20)
    assert np.abs(clip.frames.astype(int) - clip.ground)[:, clip.share == 0].mean() < 3
    same = np.abs(np.diff(clip.frames.astype(int), axis=0)).max(-1) < 25
    stood = clip.share > 0.8  # before, while and after the signal is red
    shares = [same[part][:, stood].mean() for part in (slice(0, 3), slice(8, 11), slice(16, 19))]
    assert shares[1] > 0.9 > 0.7 > max(shares[0], shares[2])


def test_crops_show_a_frame_the_median_and_the_background(monkeypatch, tmp_path):
    short = film_signal(standing=0.6, seed=0, count=6)
    monkeypatch.setattr(crops, "film_signal", lambda **_: short)
    crops.main(tmp_path / "crops.png")
    picture = cv2.imread(str(tmp_path / "crops.png"))[..., ::-1]
    assert (picture[:200] == short.frames[3][crops.CROP]).all()
    assert picture.shape == (3 * 200 + 2 * crops.GAP_PX, 480, 3)


def test_a_hover_scene_is_compared_with_its_masked_median(clip, monkeypatch, tmp_path):
    boxes = read_detections([np.array([[100.0, 100, 200, 150]])] * len(clip.frames))
    scene = hover.Scene("drawn", list_frames(clip), clip.share > 0, boxes, "all")
    _, judged, passed = hover.compute_masked_median(scene)
    assert not judged[110:140, 110:190].any()  # boxes hide it in every frame
    assert not judged[: hover.RIM_PX].any()
    assert judged[300, 300]
    assert passed[125, 150]
    assert passed.sum() == pytest.approx(1.12**2 * 100 * 50, rel=0.05)
    monkeypatch.setattr(hover, "read_scenes", lambda: [scene])
    rows = list(hover.measure_scenes(tmp_path))
    assert [row["boxes"] for row in rows] == ["none", "all", "10 % missing", "10 % too small"]
    crop = cv2.imread(str(tmp_path / "drawn_none.png"))
    assert crop.shape == (hover.CROP_PX, 3 * hover.CROP_PX, 3)


def test_missed_pixels_differ_and_are_not_contested():
    median = np.full((200, 200, 3), 90, np.uint8)
    coverage, contested = np.ones((200, 200), np.uint16), np.zeros((200, 200), bool)
    everywhere = np.ones((200, 200), bool)
    image = median.copy()
    image[100:110, 100:110] += 20
    image[50:60, 50:60] += 20
    contested[40:70, 40:70] = True
    ground = Background(image, coverage, contested, 1, np.ones(1))
    missed = hover.find_unmarked_errors(ground, median, everywhere)
    assert missed[101:109, 101:109].all()
    assert missed.sum() <= 12 * 12
    assert hover.measure_rms(image, median, everywhere) == pytest.approx(20 * (200 / 200**2) ** 0.5)
    assert np.isnan(hover.measure_rms(image, median, ~everywhere))


def test_damaged_boxes_are_fewer_or_smaller():
    boxes = np.tile([[10.0, 10, 38, 38]], (200, 1))
    detections = read_detections([boxes])
    frame = Frame(0, 0.0, None, np.zeros((40, 40, 3), np.uint8))
    fewer = damage_boxes(detections, missing=0.1)(frame)
    assert 160 < len(fewer.boxes) < 198
    smaller = damage_boxes(detections, scale=0.9)(frame)
    assert smaller.boxes[0] == pytest.approx([11.4, 11.4, 36.6, 36.6])


@pytest.mark.parametrize("speed", [14.0, 9.0])
def test_boxes_of_a_signal_hold_its_vehicles(speed):
    clip = film_signal(standing=0.6, seed=1, count=6, speed=speed)
    for image, boxes in zip(clip.frames, clip.boxes, strict=True):
        outside = np.ones(image.shape[:2], bool)
        for left, top, right, bottom in boxes.astype(int).tolist():
            outside[max(top - 1, 0) : bottom + 8, max(left - 1, 0) : right + 5] = False  # shadows
        assert np.abs(image.astype(int) - clip.ground)[outside].max() < 40


def test_a_sequence_that_is_refused_is_a_row_of_the_table(monkeypatch, tmp_path):
    def refuse(*_, **__):
        raise RegistrationError("a part moves by itself in 18 of 20 frames, so that ...")

    monkeypatch.setattr(background_real, "PLACES", ("place",))
    for name in ("open_video", "read_detections"):
        monkeypatch.setattr(background_real, name, lambda path: None)
    monkeypatch.setattr(background_real, "register", refuse)
    row = {"sequence": "place", "registered": "refused: a part moves by itself in 18 of 20 frames"}
    assert list(background_real.measure_real(tmp_path)) == [row]


def test_found_boxes_are_left_out_of_a_second_map(tmp_path):
    clip = draw_queue(standing=0.5, seed=1, count=40)
    rows = list(own_boxes.measure_clip(clip, own_boxes.CLIPS["drawn"][1], tmp_path))
    assert [row["boxes"] for row in rows] == ["none", "found"]
    assert rows[0]["stood"] != rows[1]["stood"]
    assert max(row["passed"] for row in rows) < 10


def test_ground_that_is_never_bare_is_not_judged(small):
    share, ground = small.share.copy(), small.ground.copy()
    share[40:60, 60:70] = 1.0
    ground[40:60, 60:70] = 255  # far from what any frame shows
    clip = replace(small, share=share, ground=ground)
    rows = {row["boxes"]: row for row in long_queues.measure_clip(clip)}
    assert list(rows) == ["median", "none", "all", "10 % missing"]
    assert rows["none"]["never bare %"] == pytest.approx(25.0)
    assert rows["none"]["stood"] < 10
