from dataclasses import replace

import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.prediction import dataset
from geoaim.prediction.dataset import make_dataset
from geoaim.rendering.scene import slice_scene
from tests.prediction.test_segments import scene
from tests.prediction.tiny import TINY, hill

PARKED_Y = -5.0  # of the parked car of `scene`


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setitem(dataset.SEGMENT_STEPS, "vehicle", 5)
    monkeypatch.setitem(dataset.SEGMENT_STRIDES, "vehicle", 5)


def test_training_and_validation_do_not_overlap():
    data = make_dataset([scene()], TINY, val_fraction=0.3)
    x = scene().poses[0, :, 0]
    train, val = (part.states[:, 0] for part in (data.train, data.val))
    train, val = (states[states[..., 1] != PARKED_Y][..., 0] for states in (train, val))
    assert train.max() < x[14]
    assert val.min() >= x[14]


def test_some_segments_are_of_parked_agents(monkeypatch):
    train = make_dataset([scene()], TINY, val_fraction=0.3).train
    parked = train.states[:, 0, 0, 1] == PARKED_Y  # the controlled agent comes first
    assert parked.tolist() == [False] * 5 + [True] * 2
    monkeypatch.setattr(dataset, "PARKED_SHARE", 0.1)
    long = make_dataset([scene(200)], TINY, val_fraction=0.3).train
    share = float((long.states[:, 0, 0, 1] == PARKED_Y).float().mean())
    assert 0.03 < share < 0.1


def test_whole_scenes_can_be_kept_for_validation():
    one, other = scene(), replace(scene(), ground=hill())
    data = make_dataset([one], TINY, val_scenes=[other])
    assert data.train.places.unique().tolist() == [0]
    assert data.val.places.unique().tolist() == [1]
    assert len(data.train) == len(data.val)


def test_scenes_of_one_place_share_its_ground():
    one = scene()
    shared = make_dataset([one, replace(one)], TINY, val_fraction=0.3)
    apart = make_dataset([one, replace(one, ground=hill())], TINY, val_fraction=0.3)
    assert (len(shared.ground.regions), len(apart.ground.regions)) == (1, 2)
    assert len(apart.train) == len(shared.train) == 14
    assert shared.train.places.tolist() == [0] * 14
    assert apart.train.places.tolist() == [0] * 7 + [1] * 7
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


def test_the_advice_for_short_recordings_is_by_their_length():
    short = slice_scene(scene(), slice(0, 8))
    with pytest.raises(TracksError, match=r"need 1 s, and these are .* s: film longer"):
        make_dataset([short], TINY)
    with pytest.raises(TracksError, match="gives both parts half"):
        make_dataset([scene()], TINY)
    with pytest.raises(TracksError, match="What helps: film longer"):
        make_dataset([scene()], TINY, val_scenes=[slice_scene(scene(), slice(0, 3))])


def test_models_learn_from_smoothed_states_of_agents_whose_heading_is_known():
    exact = scene()
    observed = exact.observed + 0.1
    observed[:2, :10] = float("nan")  # not seen for long enough
    observed[1] = float("nan")  # never known
    data = make_dataset([replace(exact, observed=observed, smoothed=True)], TINY, val_fraction=0.3)
    moving = data.train.states[data.train.states[:, 0, 0, 1] != PARKED_Y][:, 0]
    assert moving[:, 0, 0].unique().tolist() == [0.0, 5.0]
    assert moving[..., 1].unique().tolist() == [0.0]
