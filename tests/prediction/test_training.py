import os
import subprocess
import sys
from dataclasses import replace

import pytest
import torch

from geoaim.base.errors import ModelError
from geoaim.prediction.anchors import compute_anchor_loss
from geoaim.prediction.batches import Process, compute_top_k, draw_batch
from geoaim.prediction.checkpoints import read_model, read_state, write_state
from geoaim.prediction.config import TrainConfig
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.training import LOG_COLUMNS, init_model, train
from tests.prediction.tiny import TINY, drive, hill

TRAINING = TrainConfig(
    steps=6,
    batch_size=4,
    history=(2, 4),
    mirror=True,
    scale_jitter=0.1,
    colour_jitter=0.1,
    checkpoint_interval=2,
)


def dataset():
    return Dataset(drive(10, 6), drive(10, 2, curve=-0.05), hill())


class Killed(Exception):
    pass


def killed_at(step):
    def progress(stage, done, total):
        if done == step:
            raise Killed

    return progress


def same(one, two):
    pairs = zip(one.state_dict().values(), two.state_dict().values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


@pytest.mark.slow
def test_interrupted_training_ends_with_the_same_weights(tmp_path):
    whole = train(init_model(TINY), TRAINING, dataset(), tmp_path / "whole")
    with pytest.raises(Killed):
        train(init_model(TINY), TRAINING, dataset(), tmp_path / "cut", progress=killed_at(5))
    assert not (tmp_path / "cut" / "model.pt").exists()
    assert same(whole, train(init_model(TINY), TRAINING, dataset(), tmp_path / "cut"))
    other = train(init_model(TINY), replace(TRAINING, seed=1), dataset(), tmp_path / "other")
    assert not same(whole, other)


def test_training_writes_a_model_and_a_log(tmp_path):
    model = train(init_model(TINY), TRAINING, dataset(), tmp_path)
    again = read_model(tmp_path / "model.pt")
    assert again.config == TINY
    for one, two in zip(model.parameters(), again.parameters(), strict=True):
        assert torch.allclose(one, two, atol=1e-3)  # 16 bits
    lines = (tmp_path / "log.csv").read_text().splitlines()
    assert lines[0].split(",") == list(LOG_COLUMNS)
    assert [line.split(",")[0] for line in lines[1:]] == ["2", "4", "6"]


def test_another_training_in_the_folder_is_rejected(tmp_path):
    train(init_model(TINY), TRAINING, dataset(), tmp_path)
    with pytest.raises(ModelError, match=r"learning_rate 0\.002 instead of 0\.01"):
        train(init_model(TINY), replace(TRAINING, learning_rate=0.01), dataset(), tmp_path)
    (tmp_path / "checkpoint.pt").write_bytes(b"no zip")
    with pytest.raises(ModelError, match=r"checkpoint\.pt is not a model"):
        train(init_model(TINY), TRAINING, dataset(), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("optimiser", {}, "is not a checkpoint"),
        ("log", [[9, 0, 0, 0, 0, 0, 0]], "last step is 9"),
        ("log", [[2, 0, 0, 0, 0, 0]], "another version of geoaim"),
        ("model", None, "not a finite number"),
    ],
)
def test_a_bent_checkpoint_is_refused(tmp_path, name, value, message):
    train(init_model(TINY), TRAINING, dataset(), tmp_path)
    state = read_state(tmp_path / "checkpoint.pt")
    infinite = {key: weights * torch.inf for key, weights in state["model"].items()}
    write_state({**state, name: infinite if value is None else value}, tmp_path / "checkpoint.pt")
    with pytest.raises(ModelError, match=rf"checkpoint\.pt.*{message}"):
        train(init_model(TINY), TRAINING, dataset(), tmp_path)


def test_training_starts_from_a_given_model(tmp_path):
    first = train(init_model(TINY), TRAINING, dataset(), tmp_path / "a")
    one = replace(TRAINING, steps=1, learning_rate=1e-12)
    second = train(first, one, dataset(), tmp_path / "b")
    for before, after in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.allclose(before, after, atol=1e-6)


def test_loss_falls(tmp_path):
    longer = replace(
        TRAINING,
        steps=30,
        checkpoint_interval=15,
        mirror=False,
        colour_jitter=0.0,
        learning_rate=1e-2,
    )
    train(init_model(TINY), longer, dataset(), tmp_path)
    rows = [line.split(",") for line in (tmp_path / "log.csv").read_text().splitlines()[1:]]
    assert float(rows[-1][1]) < float(rows[0][1]) / 2


SCRIPT = """
import sys, torch
torch.set_num_threads(1)
from tests.prediction.test_training import TINY, TRAINING, dataset, init_model, train
model = train(init_model(TINY), TRAINING, dataset(), sys.argv[1])
total = sum(float(p.double().sum()) for p in model.parameters())
sys.stdout.write(f"{total}\\n")  # at once: two processes write here
"""


@pytest.mark.slow
def test_two_processes_end_with_the_same_weights(tmp_path):
    script = tmp_path / "run.py"
    script.write_text(SCRIPT)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    command += ["--nproc-per-node", "2", str(script), str(tmp_path / "out")]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.getcwd(), "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    one, two = done.stdout.split()
    assert one == two
    assert read_model(tmp_path / "out" / "model.pt").config == TINY


@pytest.mark.parametrize("mirror", [False, True])
def test_half_of_the_batches_are_mirrored_when_asked(mirror, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "geoaim.prediction.augmentation.scale_ground",
        lambda ground, factors: [seen.append(factors), ground][1],
    )
    config = replace(TRAINING, mirror=mirror, scale_jitter=0.0, colour_jitter=0.0)
    process = Process(rank=0, world_size=1, device=torch.device("cpu"))
    for step in range(60):
        draw_batch(config, drive(10, 6), hill(), step, process)
    mirrored = sum(float(factors[1]) < 0 for factors in seen)
    assert 15 < mirrored < 45 if mirror else mirrored == 0
    assert all(float(factors.abs().max()) == 1 for factors in seen)


def test_ever_fewer_proposals_are_trained():
    top_k = [compute_top_k(replace(TRAINING, steps=100), step, 20) for step in range(100)]
    assert top_k[0] == 20
    assert top_k == sorted(top_k, reverse=True)
    assert top_k.index(1) == 70  # 20 ** (1 - 70 / 80) is less than 1.5
    assert compute_top_k(TRAINING, 0, 0) == 1  # of a model without proposals


def test_fine_tuning_trains_the_best_proposals_only(tmp_path, monkeypatch):
    seen = []

    def loss(anchors, logits, target, top_k):
        seen.append(top_k)
        return compute_anchor_loss(anchors, logits, target, top_k)

    monkeypatch.setattr("geoaim.prediction.itra.compute_anchor_loss", loss)
    config = replace(TINY, motion="slide", num_anchors=3, history=4, horizon=6)
    training = replace(TRAINING, history=(4, 4))
    first = train(init_model(config), training, dataset(), tmp_path / "a")
    assert seen[0] == 3 and seen[-1] == 1  # noqa: PT018
    seen.clear()
    tuning = replace(training, anchor_annealing=0.0)
    train(first, tuning, dataset(), tmp_path / "b")
    assert set(seen) == {1}  # proposals that are spread stay so


@pytest.mark.skipif(sys.platform == "win32", reason="folders cannot be locked")
def test_second_training_in_a_folder_at_once_is_refused(tmp_path):
    def train_again(*_):
        with pytest.raises(ValueError, match="another process writes into"):
            train(init_model(TINY), TRAINING, dataset(), tmp_path)

    train(init_model(TINY), replace(TRAINING, steps=1), dataset(), tmp_path, progress=train_again)
