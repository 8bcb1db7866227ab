from dataclasses import asdict, replace

import pytest

from benchmarks.prediction import models
from benchmarks.prediction.models import MODELS, train_model, train_once
from benchmarks.prediction.protocol import PEDESTRIANS, TRAININGS
from benchmarks.prediction.results import Workspace
from geoaim.base.errors import ModelError
from geoaim.prediction.config import TrainConfig
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.training import init_model
from tests.prediction.tiny import TINY, drive, hill

TRAINING = TrainConfig(steps=1, batch_size=2, history=(2, 2))


def load_dataset():
    return Dataset(drive(8, 2), drive(8, 2), hill())


def fail():
    raise AssertionError("the model is trained already")


def test_a_trained_model_is_read_when_its_settings_match(tmp_path):
    model, place = init_model(TINY), ("first", Workspace(tmp_path))
    first = train_once(model, TRAINING, load_dataset, *place)
    again = train_once(model, TRAINING, fail, *place)
    assert asdict(again.config) == asdict(first.config)
    with pytest.raises(ModelError, match="another training"):
        train_once(model, replace(TRAINING, batch_size=1), fail, *place)
    with pytest.raises(ModelError, match="another config"):
        train_once(init_model(replace(TINY, latent_size=4)), TRAINING, fail, *place)


def test_a_trained_model_that_began_with_other_weights_is_rejected(tmp_path):
    workspace = Workspace(tmp_path)
    one, two = (
        train_once(init_model(TINY, seed=seed), TRAINING, load_dataset, str(seed), workspace)
        for seed in (0, 1)
    )
    train_once(one, TRAINING, load_dataset, "tuned", workspace)
    train_once(one, TRAINING, fail, "tuned", workspace)
    with pytest.raises(ModelError, match="another start"):
        train_once(two, TRAINING, fail, "tuned", workspace)


def test_models_are_of_all_kinds_that_can_be_trained():
    assert {spec.config.kind for spec in MODELS.values()} == set(TRAININGS)
    assert MODELS["pedestrian_aim"].config == PEDESTRIANS


def test_each_training_of_a_model_has_its_own_folder_and_seed(monkeypatch, tmp_path):
    folders, trained = [], init_model(TINY)
    monkeypatch.setattr(models, "train", lambda *given, progress: folders.append(given[3]))
    monkeypatch.setattr(models, "read_model", lambda path: trained)
    monkeypatch.setattr(models, "make_places", lambda *_, progress: [])
    monkeypatch.setattr(models, "make_places_dataset", lambda *_, **__: load_dataset())
    for seed in (0, 1):
        assert train_model("pedestrian_aim", Workspace(tmp_path), seed=seed) is trained
    assert [folder.name for folder in folders] == ["pedestrian_aim", "pedestrian_aim_1"]
