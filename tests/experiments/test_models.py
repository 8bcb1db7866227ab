from dataclasses import asdict, replace

import pytest

from geoaim.errors import ModelError
from geoaim.experiments.models import kept_or_trained
from geoaim.prediction.lessons import Lessons
from geoaim.prediction.training import Training
from geoaim.progress import no_progress
from tests.prediction.made import TINY, drive, hill

TRAINING = Training(steps=1, batch=2, observed=(2, 2))


def lessons():
    return Lessons(drive(8, 2), drive(8, 2), hill())


def nobody():
    raise AssertionError("it is there already")


def test_a_kept_model_is_the_one_that_is_asked_for(tmp_path):
    first = kept_or_trained(tmp_path / "first", TINY, TRAINING, lessons, no_progress)
    again = kept_or_trained(tmp_path / "first", TINY, TRAINING, nobody, no_progress)
    assert asdict(again.config) == asdict(first.config)
    with pytest.raises(ModelError, match="trained otherwise"):
        kept_or_trained(tmp_path / "first", TINY, replace(TRAINING, seed=1), nobody, no_progress)
    config = replace(TINY, latent=4)
    with pytest.raises(ModelError, match="another config"):
        kept_or_trained(tmp_path / "first", config, TRAINING, nobody, no_progress)


def test_a_kept_model_that_began_with_other_weights_is_refused(tmp_path):
    one, two = (
        kept_or_trained(
            tmp_path / str(seed), TINY, replace(TRAINING, seed=seed), lessons, no_progress
        )
        for seed in (0, 1)
    )
    where = tmp_path / "tuned"
    kept_or_trained(where, TINY, TRAINING, lessons, no_progress, start=one)
    kept_or_trained(where, TINY, TRAINING, nobody, no_progress, start=one)
    with pytest.raises(ModelError, match="other weights"):
        kept_or_trained(where, TINY, TRAINING, nobody, no_progress, start=two)
