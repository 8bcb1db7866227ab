"""The benchmarks of renderer and simulator on tiny input."""

import json

import pytest
import torch

from benchmarks.rendering import batches as birdview_batches
from benchmarks.rendering import benchmark as birdview
from benchmarks.rendering import render_batches
from benchmarks.simulation import benchmark as simulator

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def ground():
    generator = torch.Generator().manual_seed(0)
    coarse = torch.rand(1, 3, 8, 8, generator=generator)
    return birdview.make_map(torch.nn.functional.interpolate(coarse, size=64, mode="bilinear")[0])


def test_renderers_are_timed_and_compared(ground, monkeypatch):
    monkeypatch.setattr(birdview, "MIN_TIMED_PIXELS", 1)
    row = birdview._time_renderer(ground, (16, 2, 20), repeats=1)
    assert all(value > 0 for value in row.values())
    methods = birdview._compare_renderers(ground, pixels=16, views=2, repeats=1)
    errors = {row["method"]: row["mean error at edges of boxes"] for row in methods}
    assert errors["geoaim"] < errors["OpenCV: warp, hard polygons"] / 3
    figure = birdview._draw_chart(methods)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["mean error", "mean error at edges of boxes"]


def test_time_and_memory_of_batches_are_measured(monkeypatch):
    monkeypatch.setattr(render_batches, "BATCHES", (1, 2))
    monkeypatch.setattr(render_batches, "MAP_PX", 64)
    for backward in (False, True):
        rows = render_batches.measure(8, backward, 1)
        assert [row["ms"] > 0 and row["megabytes"] >= 0 for row in rows] == [True, True]


def test_batches_are_timed(ground, monkeypatch):
    monkeypatch.setattr(birdview_batches, "VIEWS", 2)
    rows = [
        birdview_batches.time_maps(16, repeats=1, side=64),
        birdview_batches.time_threads(ground, 16, repeats=1),
        birdview_batches.time_stack(ground, 3, repeats=1),
    ]
    assert all(value > 0 for row in rows for value in row.values())


def test_simulator_is_timed(tmp_path):
    simulator.main(json=tmp_path / "a.json", repeats=1)
    rows = json.loads((tmp_path / "a.json").read_text())["rows"]
    assert rows[1]["stage"] == "step"
    assert all(row["ms"] > 0 for row in rows)
