from dataclasses import replace

import pytest

from benchmarks.prediction import protocol
from benchmarks.prediction.protocol import VEHICLES, evaluate_place, make_places_dataset
from benchmarks.prediction.tables import Case, evaluate_case
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.metrics import concat

SMALL = replace(VEHICLES, view_size=16, resolution=3.0)


def test_models_are_trained_and_evaluated_on_places(place, monkeypatch):
    monkeypatch.setattr(protocol, "VAL_FRACTION", 0.2)
    dataset = make_places_dataset([place], SMALL, "aim")
    assert len(dataset.train) > 50
    assert dataset.train.steps == dataset.val.steps == 40
    positions = dataset.train.states[:, 0, :, :2]
    low, high = dataset.ground.bounds[0].float()
    assert ((low < positions) & (positions < high)).all()
    predictor = BASELINES["constant velocity"]
    end = concat(evaluate_place(predictor, place, SMALL, "none", fraction=0.2))
    assert 0 < end["minADE"].mean < 10
    one, joint = end["minADE"], end["joint minADE"]  # all samples of this predictor are the same
    assert joint.sums == pytest.approx(one.sums / one.counts)
    whole = evaluate_case(predictor, Case("constant velocity", "none"), SMALL, [place])
    assert whole["minADE"].counts.sum() > end["minADE"].counts.sum()
