import numpy as np
import pytest

from geoaim.bench.background_queues import METHODS, draw_error_against_time, measure_queue
from geoaim.bench.drawn_queue import draw_queue
from geoaim.bench.queue_clips import paste_queue


@pytest.fixture(scope="module")
def clip():
    return draw_queue(standing=0.6, seed=0, count=24)


def test_ground_of_a_drawn_queue_shows_where_no_car_is(clip):
    free = clip.share == 0
    error = np.abs(np.median(clip.frames, axis=0) - clip.ground)[free]
    assert error.mean() < 2
    assert (clip.share > 0.5).mean() > 0.02


def test_standing_queue_is_removed_and_most_wrong_pixels_are_marked(clip):
    ours = measure_queue(clip, METHODS["without boxes"])
    assert ours["RMSE"] < 20
    assert ours["wrong marked %"] > 50
    assert ours["good marked %"] < 2
    assert measure_queue(clip, METHODS["median"])["RMSE"] > 2 * ours["RMSE"]


def test_chart_is_written_as_svg_and_png(clip, tmp_path):
    small = {"RMSE": 3.0, "seconds": 0.5}
    draw_error_against_time([{"method": m, **small} for m in METHODS], tmp_path / "queues.json")
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".png", ".svg"]


def test_pasted_queue_has_ground_that_its_frames_show(data_folder):
    clip = paste_queue("munich_mos074", standing=0.6, seed=0, count=8)
    free = clip.share == 0
    assert np.abs(clip.frames[0][free].astype(int) - clip.ground[free]).mean() < 8
    assert 0.01 < (clip.share >= 0.5).mean() < 0.3
