import os
import subprocess
import sys
from dataclasses import replace

import pytest
import torch

from geoaim.errors import ModelError
from geoaim.prediction.checkpoints import read_model
from geoaim.prediction.itra import Losses
from geoaim.prediction.lessons import Lessons
from geoaim.prediction.plans import plan_loss
from geoaim.prediction.training import LOG, Training, _losses, _winners, train
from tests.prediction.made import TINY, drive, hill

TRAINING = Training(steps=6, batch=4, observed=(2, 4), mirror=True, resize=0.1, colour=0.1, save=2)


def lessons():
    return Lessons(drive(10, 6), drive(10, 2, curve=-0.05), hill())


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


def test_training_that_was_killed_ends_with_the_same_weights(tmp_path):
    whole = train(TINY, TRAINING, lessons(), tmp_path / "whole")
    with pytest.raises(Killed):
        train(TINY, TRAINING, lessons(), tmp_path / "cut", progress=killed_at(5))
    assert not (tmp_path / "cut" / "model.pt").exists()
    assert same(whole, train(TINY, TRAINING, lessons(), tmp_path / "cut"))
    other = train(TINY, replace(TRAINING, seed=1), lessons(), tmp_path / "other")
    assert not same(whole, other)


def test_training_leaves_a_model_and_a_log(tmp_path):
    found = train(TINY, TRAINING, lessons(), tmp_path)
    again = read_model(tmp_path / "model.pt")
    assert again.config == TINY
    for one, two in zip(found.parameters(), again.parameters(), strict=True):
        assert torch.allclose(one, two, atol=1e-3)  # 16 bits
    lines = (tmp_path / "log.csv").read_text().splitlines()
    assert lines[0].split(",") == list(LOG)
    assert [line.split(",")[0] for line in lines[1:]] == ["2", "4", "6"]


def test_another_training_in_the_folder_is_refused(tmp_path):
    train(TINY, TRAINING, lessons(), tmp_path)
    with pytest.raises(ValueError, match=r"rate 0\.002 instead of 0\.01"):
        train(TINY, replace(TRAINING, rate=0.01), lessons(), tmp_path)
    (tmp_path / "checkpoint.pt").write_bytes(b"no zip")
    with pytest.raises(ModelError, match=r"checkpoint\.pt is no model"):
        train(TINY, TRAINING, lessons(), tmp_path)


def test_training_goes_on_from_a_model(tmp_path):
    first = train(TINY, TRAINING, lessons(), tmp_path / "a")
    one = replace(TRAINING, steps=1, rate=1e-12)
    second = train(TINY, one, lessons(), tmp_path / "b", start=first)
    for before, after in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.allclose(before, after, atol=1e-6)


def test_loss_falls(tmp_path):
    longer = replace(TRAINING, steps=30, save=15, mirror=False, colour=0.0, rate=1e-2)
    train(TINY, longer, lessons(), tmp_path)
    rows = [line.split(",") for line in (tmp_path / "log.csv").read_text().splitlines()[1:]]
    assert float(rows[-1][1]) < float(rows[0][1]) / 2


SCRIPT = """
import sys, torch
torch.set_num_threads(1)
from tests.prediction.test_training import TINY, TRAINING, lessons, train
model = train(TINY, TRAINING, lessons(), sys.argv[1])
print(sum(float(p.double().sum()) for p in model.parameters()))
"""


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
        timeout=120,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    one, two = done.stdout.split()
    assert one == two
    assert read_model(tmp_path / "out" / "model.pt").config == TINY


@pytest.mark.parametrize("mirror", [False, True])
def test_half_of_the_batches_are_mirrored_where_asked(mirror, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "geoaim.prediction.training.ground_scaled", lambda ground, sides: seen.append(sides)
    )
    plain = replace(TRAINING, mirror=mirror, resize=0.0, colour=0.0)
    nothing = Losses(*torch.zeros(3))

    class Still(torch.nn.Module):
        def forward(self, *given):
            return nothing

    for step in range(60):
        _losses(Still(), plain, drive(10, 6), hill(), step, 1, (0, 1))
    mirrored = sum(float(sides[1]) < 0 for sides in seen)
    assert 15 < mirrored < 45 if mirror else mirrored == 0
    assert all(float(sides.abs().max()) == 1 for sides in seen)


def test_fewer_and_fewer_plans_learn_from_each_segment():
    many = [_winners(replace(TRAINING, steps=100), step, 20) for step in range(100)]
    assert many[0] == 20
    assert many == sorted(many, reverse=True)
    assert many.index(1) == 70  # 20 ** (1 - 70 / 80) is less than 1.5
    assert _winners(TRAINING, 0, 0) == 1  # of a model without plans


def test_plans_are_taught_by_fewer_and_fewer(tmp_path, monkeypatch):
    seen = []

    def loss(plans, logits, way, winners):
        seen.append(winners)
        return plan_loss(plans, logits, way, winners)

    monkeypatch.setattr("geoaim.prediction.itra.plan_loss", loss)
    plans = replace(TINY, motion="slide", modes=3, known=4, ahead=6)
    training = replace(TRAINING, observed=(4, 4))
    first = train(plans, training, lessons(), tmp_path / "a")
    assert seen[0] == 3 and seen[-1] == 1  # noqa: PT018
    seen.clear()
    train(plans, training, lessons(), tmp_path / "b", start=first)
    assert set(seen) == {1}  # what is spread already stays so
