import torch

from geoaim.bench import prediction
from geoaim.prediction.segments import concat
from tests.prediction.tiny import drive, hill


def test_models_are_timed(monkeypatch):
    threads = torch.get_num_threads()
    joined = prediction.join_agents(concat([drive(20, 3)] * 7))
    assert joined.states.shape == (1, 20, 20, 4)
    monkeypatch.setattr(prediction, "make_junction_scene", lambda config: SceneStub)
    monkeypatch.setattr(prediction, "prefilter_ground", lambda ground, resolution: hill())
    monkeypatch.setattr(
        prediction, "cut_segments", lambda scene, kind, steps, stride: drive(steps, 20)
    )
    monkeypatch.setattr(prediction, "REPEATS", 1)
    monkeypatch.setattr(prediction, "SAMPLES", 1)
    monkeypatch.setattr(prediction, "BATCH_SIZE", 2)
    row = prediction.measure_model("vehicle", threads)
    assert row["share of rendering"] > 0
    assert row["s to sample 4 s"] > 0


class SceneStub:
    ground = None
