from dataclasses import replace

import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.prediction import dataset
from geoaim.prediction.dataset import make_dataset
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
    train = data.train.states[:, 0, :, 0].flatten()
    val = data.val.states[:, 0, :, 0].flatten()
    assert train.max() < x[14]
    assert val.min() >= x[14]


def test_scenes_of_one_place_share_its_ground():
    one = scene()
    shared = make_dataset([one, replace(one)], TINY, val_fraction=0.3)
    apart = make_dataset([one, replace(one, ground=hill())], TINY, val_fraction=0.3)
    assert (len(shared.ground.regions), len(apart.ground.regions)) == (1, 2)
    assert len(apart.train) == len(shared.train) == 10
    assert shared.train.places.tolist() == [0] * 10
    assert apart.train.places.tolist() == [0] * 5 + [1] * 5
    for data in (shared, apart):
        low, high = data.ground.bounds[data.train.places].unbind(1)
        positions = data.train.states[:, 0, :, :2].double()
        assert ((low[:, None] < positions) & (positions < high[:, None])).all()


def test_recordings_that_are_too_short_are_reported():
    with pytest.raises(TracksError, match=r"no validation segments .* 5 % are for validation"):
        make_dataset([scene()], TINY)
    with pytest.raises(TracksError, match="no training segments in recording 1 of 1"):
        make_dataset([scene()], TINY, val_fraction=0.9)
    with pytest.warns(GeoaimWarning, match="no training segments in recording 2 of 2"):
        data = make_dataset([scene(), slice_scene(scene(), slice(0, 8))], TINY, val_fraction=0.7)
    assert len(data.train) == len(make_dataset([scene()], TINY, val_fraction=0.7).train)
