import numpy as np
import pytest

from geoaim.bench import background
from geoaim.bench.background import METHODS, _measure_gradient_energy, _run_method, _spread_indices
from geoaim.encode import write_video
from tests.mapping.background.clips import make_ground, queue


@pytest.fixture
def ground():
    return make_ground()


@pytest.fixture
def folder(ground, tmp_path):
    """A clip in which a car stands for 60 % of the time, with its truth."""
    images = queue(ground, count=16)
    write_video(images, tmp_path / "frames.mp4", frame_rate=1, crf=5)
    height, width = ground.shape[:2]
    share = np.zeros((height, width), np.float32)
    share[40:60, 60:100], share[80:100] = 0.6, 0.2
    np.savez(
        tmp_path / "truth.npz",
        reference_from_frame=np.tile(np.eye(3), (16, 1, 1)),
        boxes=np.array([[k, 60.0, 40.0, 100.0, 60.0] for k in range(16)]),
        clean=ground,
        share=share,
    )
    return tmp_path


@pytest.mark.parametrize("method", METHODS)
def test_each_method_is_measured_in_each_zone(folder, monkeypatch, method):
    monkeypatch.setattr(background, "MARGIN_PX", 10)
    monkeypatch.setattr(background, "THREADS", 1)
    row = _run_method(method, folder)
    assert np.isfinite([row["static"], row["passed"], row["stood"], row["gradient energy %"]]).all()
    assert row["static"] < 10


def test_gradient_energy_of_the_frame_itself_is_one(ground):
    where = np.ones(ground.shape[:2], bool)
    assert _measure_gradient_energy(ground, ground, ground, where) == pytest.approx(1)


@pytest.mark.parametrize("count", [0, 1, 2, 7, 16])
def test_spread_indices_are_a_permutation(count):
    assert sorted(_spread_indices(count)) == list(range(count))
