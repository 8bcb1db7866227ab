from dataclasses import replace

import numpy as np
import pytest
import torch

from geoaim.prediction.baselines import BASELINES, NOISY
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Metric, bootstrap_interval, compute_metrics, concat, summarise
from geoaim.prediction.segments import pick
from geoaim.simulation.infractions import Drivable
from geoaim.simulation.road_rules import RoadRules
from geoaim.tracks.lights import GREEN, RED
from tests.prediction.tiny import TINY, drive, hill


def futures(segments, shifts):
    """The ground truth, shifted to the left in each sample."""
    states = segments.states[:, None].repeat(1, len(shifts), 1, 1, 1)
    move = torch.tensor(shifts)[None, :, None, None] * segments.controlled[:, None, :, None]
    return torch.cat([states[..., :1], states[..., 1:2] + move[..., None], states[..., 2:]], dim=-1)


def test_metrics_are_of_the_best_sample():
    segments = drive(10, 3)
    metrics = compute_metrics(futures(segments, [3.0, -0.5, 2.0]), segments, 4)
    assert metrics["minADE"].mean == pytest.approx(0.5, abs=1e-5)
    assert metrics["joint minFDE"].mean == pytest.approx(0.5, abs=1e-5)
    assert metrics["MFD"].mean == pytest.approx(3.5, abs=1e-5)


def test_joint_metrics_choose_one_sample_for_all_agents():
    segments = drive(10, 1)
    both = replace(segments, controlled=torch.ones(1, 2, dtype=torch.bool))
    states = futures(both, [0.0, 0.0])
    move = torch.zeros_like(states)
    move[0, 0, 0, :, 1], move[0, 1, 1, :, 1] = 2.0, 2.0
    metrics = compute_metrics(states + move, both, 4)
    assert metrics["minADE"].mean == pytest.approx(0, abs=1e-6)
    assert metrics["joint minADE"].mean == pytest.approx(1.0, abs=1e-5)


def test_joint_metrics_are_means_over_segments():
    segments = drive(10, 2)
    controlled = torch.tensor([[True, True], [True, False]])
    both = replace(segments, controlled=controlled)
    states = futures(both, [0.0])
    states[0, :, :, :, 1] += 4.0  # both agents of the first segment
    states[1, :, :, :, 1] += 2.0  # the one agent of the second
    metrics = compute_metrics(states, both, 4)
    assert metrics["minADE"].mean == pytest.approx((4 + 4 + 2) / 3, abs=1e-5)
    for name in ("joint minADE", "joint minFDE"):
        assert metrics[name].mean == pytest.approx((4 + 2) / 2, abs=1e-5)


def test_rates_count_agents_samples_and_steps():
    segments = drive(10, 1, curve=0.0)
    off = Drivable(
        torch.tensor([[-1.0] + [3.0] * 9]), torch.tensor([[0.0, 0.1, 0.5], [0.0, 0.0, 0.5]])
    )
    # the drivable half ends a few metres to the left: a shift by 30 m leaves it
    metrics = compute_metrics(futures(segments, [0.0, 30.0]), segments, 4, RoadRules(drivable=off))
    assert metrics["off-road rate"].mean == pytest.approx(0.5)
    assert "red-light rate" in metrics
    assert metrics["red-light rate"].mean == 0
    red = replace(segments, light_states=torch.full_like(segments.light_states, RED))
    ran = compute_metrics(futures(red, [0.0]), red, 4)["red-light rate"]
    front = segments.states[0, 0, :, 0] + 4.5 / 2
    crossings = ((front[3:-1] - 9) * (front[4:] - 9) <= 0).sum()
    assert ran.sums.sum() == crossings
    hit = replace(segments, states=segments.states.clone())
    hit.states[:, 1, :, :2] = hit.states[:, 0, :, :2]
    assert compute_metrics(futures(hit, [0.0]), hit, 4)["collision rate"].mean == 1


def test_intervals_cover_the_true_mean_at_their_confidence():
    generator = np.random.default_rng(0)
    inside = 0
    for seed in range(200):
        drawn = Metric(generator.normal(5, 2, 60), np.ones(60))
        low, high = bootstrap_interval(drawn, seed=seed)
        inside += low < 5 < high
    assert 180 < inside <= 200


def test_difference_is_taken_on_the_same_segments():
    noise = np.random.default_rng(0).normal(0, 5, 100)
    one, two = (Metric(noise + shift, np.ones(100)) for shift in (1.1, 1.0))
    low, high = bootstrap_interval(one, two)
    assert low == pytest.approx(0.1)
    assert high == pytest.approx(0.1)


def test_concatenated_metrics_average_over_all_segments():
    one = {"a": Metric(np.array([2.0]), np.array([1.0])), "b": Metric(np.ones(1), np.ones(1))}
    two = {"a": Metric(np.array([4.0]), np.array([3.0]))}
    whole = concat([one, two])
    assert set(whole) == {"a", "b"}
    assert whole["b"].mean == 1
    assert whole["a"].mean == pytest.approx(1.5)
    assert summarise(whole)["a"] == {"mean": 1.5, "count": 4.0, "segments": 2}


@pytest.mark.parametrize("name", BASELINES)
def test_baselines_predict_straight_motion(name):
    segments = drive(12, 3, curve=0.0)
    even = segments.states.clone()
    even[:, 0, :, 3] = 5.0
    even[:, 0, :, 0] = 0.5 * torch.arange(12)
    given = {"history": 3, "samples": 4, "generator": torch.Generator().manual_seed(0)}
    states = BASELINES[name](replace(segments, states=even), hill(), **given)
    assert states.shape == (3, 4, 2, 12, 4)
    off = (states[:, :, 0, :, :2] - even[:, None, 0, :, :2]).norm(dim=-1)
    assert off[:, :, :3].max() == 0 or name == NOISY
    if name == NOISY:
        assert off[:, :, -1].std() > 0.1
    else:
        assert off.max() < 1e-3


def test_constant_turn_rate_continues_a_curve():
    segments = drive(12, 1, curve=0.2)
    given = {"history": 3, "samples": 1, "generator": torch.Generator()}
    straight, bent = (
        BASELINES[name](segments, hill(), **given)
        for name in ("constant velocity", "constant turn rate")
    )
    truth = segments.states[:, None]
    last = (slice(None), slice(None), 0, -1, slice(2))
    assert (bent - truth)[last].norm() < (straight - truth)[last].norm() / 2


def test_intervals_need_ten_segments():
    few, enough = (
        summarise({"a": Metric(np.arange(count, dtype=float), np.ones(count))})["a"]
        for count in (9, 10)
    )
    assert "low" not in few
    assert enough["low"] < enough["mean"] < enough["high"]


def test_hidden_lights_change_futures_and_infractions_still_count():
    torch.manual_seed(0)
    model, segments = ITRA(TINY).eval(), drive(12, 3)
    segments = replace(segments, light_states=torch.full_like(segments.light_states, RED))
    options = EvalConfig(history=4, samples=2)
    shown = evaluate(model.sample, segments, hill(), options)
    hidden = evaluate(model.sample, segments, hill(), replace(options, show_lights=False))
    assert shown["red-light rate"].counts.sum() == hidden["red-light rate"].counts.sum() > 0
    assert not np.array_equal(shown["minADE"].sums, hidden["minADE"].sums)


def test_red_lights_are_those_of_each_segment():
    segments = drive(10, 3, curve=0.0)
    red = torch.full_like(segments.light_states, RED)
    red[1] = GREEN
    segments = replace(segments, light_states=red)
    lines = segments.stop_lines.clone()
    lines[..., 0] = (segments.states[:, 0, 6, 0] + 4.5 / 2)[:, None, None]  # each one's own
    lines[2] += 1000.0  # except this one
    segments = replace(segments, stop_lines=lines)
    together = compute_metrics(futures(segments, [0.0, 0.0]), segments, 4)["red-light rate"]
    for number in range(3):
        one = pick(segments, slice(number, number + 1))
        alone = compute_metrics(futures(one, [0.0, 0.0]), one, 4)["red-light rate"]
        assert together.sums[number] == alone.sums[0]
    assert together.sums[0] > together.sums[1] == together.sums[2] == 0
