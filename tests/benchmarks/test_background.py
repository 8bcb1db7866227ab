import cv2
import numpy as np
import pytest

from benchmarks.background import benchmark as background_results
from benchmarks.background import crops
from benchmarks.background import real as background_real
from benchmarks.background.drawn_queue import draw_queue
from benchmarks.background.methods import (
    METHODS,
    divide_zones,
    measure_background,
    measure_gradient_energy,
    measure_methods,
)
from benchmarks.background.queue_clips import QueueClip, paste_queue
from benchmarks.background.signal_queue import film_signal
from geoaim.base.progress import no_progress
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
    assert ours["good marked %"] < 3  # 6 % of this map are wrong
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
