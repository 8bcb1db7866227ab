"""Training of the detector: that it runs, what it needs, and how its weights are averaged."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.detection import training
from benchmarks.detection.network import Network
from benchmarks.detection.stills import Still
from geoaim.base.errors import GeoaimError


def test_the_command_says_at_once_that_onnx_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(training.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(GeoaimError, match="onnx"):
        training.train_all(tmp_path / "networks")
    assert not list(tmp_path.iterdir())


def test_a_stage_learns_from_drawings_and_stills(tmp_path):
    torch.manual_seed(0)
    network = Network()
    before = {name: value.clone() for name, value in network.state_dict().items()}
    image = np.random.default_rng(0).integers(0, 255, (300, 300, 3)).astype(np.uint8)
    boxes = np.array([[90.0, 90, 120, 110], [200, 200, 230, 215]])
    still = Still(image, 0.2, boxes, np.array([False, True]), "made")
    stage = replace(training.FINER, steps=2)
    training.train(network, stage, tmp_path / "network.pt", stills=[[still]])
    written = torch.load(tmp_path / "network.pt")
    assert written.keys() == before.keys()
    assert any(not torch.equal(written[name], before[name]) for name in before)
    assert all(torch.isfinite(value).all() for value in written.values())


def test_the_mean_of_weights_keeps_their_types():
    parts = [Network().state_dict() for _ in range(2)]
    mean = training.average_weights(parts)
    name = "first.0.weight"
    torch.testing.assert_close(mean[name], (parts[0][name] + parts[1][name]) / 2)
    assert {n: v.dtype for n, v in mean.items()} == {n: v.dtype for n, v in parts[0].items()}
