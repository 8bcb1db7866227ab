from dataclasses import replace

import pytest
import torch

from geoaim.errors import GeoaimWarning, TracksError
from geoaim.prediction import dataset
from geoaim.prediction.dataset import make_dataset
from geoaim.simulation.ground import world_from_pixels
from geoaim.simulation.scene import slice_scene
from tests.prediction.test_segments import scene
from tests.prediction.tiny import TINY, hill


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setitem(dataset.SEGMENT_STEPS, "vehicle", 5)
    monkeypatch.setitem(dataset.SEGMENT_STRIDES, "vehicle", 5)


def test_training_and_validation_do_not_overlap():
    data = make_dataset([scene()], TINY, val_fraction=0.3)
    x = scene().poses[0, :, 0]
    apart = data.train.states[0, 0, 0, 0] - x[0]  # the atlas lies elsewhere
    train = (data.train.states[..., 0, 0] - apart).flatten()
    val = (data.val.states[..., 0, 0] - apart).flatten()
    assert train.max() < x[14]
    assert val.min() >= x[14]


def test_scenes_of_one_place_share_its_ground():
    one = scene()
    shared = make_dataset([one, replace(one)], TINY, val_fraction=0.3)
    apart = make_dataset([one, replace(one, ground=hill())], TINY, val_fraction=0.3)
    assert apart.ground.image.shape[2] > 1.8 * shared.ground.image.shape[2]
    assert len(apart.train) == len(shared.train) == 10
    for data in (shared, apart):
        height, width = data.ground.image.shape[1:]
        low, high = world_from_pixels(
            data.ground.image_from_world, torch.tensor([[0, height], [width, 0]])
        )
        places = data.train.states[:, :, 0, :2].double()
        assert ((low < places) & (places < high)).all()


def test_recordings_that_are_too_short_are_reported():
    with pytest.raises(TracksError, match=r"no validation segments .* 5 % are for validation"):
        make_dataset([scene()], TINY)
    with pytest.raises(TracksError, match="no training segments in recording 1 of 1"):
        make_dataset([scene()], TINY, val_fraction=0.9)
    with pytest.warns(GeoaimWarning, match="no training segments in recording 2 of 2"):
        data = make_dataset([scene(), slice_scene(scene(), slice(0, 8))], TINY, val_fraction=0.7)
    assert len(data.train) == len(make_dataset([scene()], TINY, val_fraction=0.7).train)
