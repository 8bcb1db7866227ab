"""Agents that leave or enter within the predicted steps are simulated while they are there."""

from dataclasses import replace

import pytest
import torch

from geoaim.prediction.baselines import BASELINES, NOISY
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import compute_ade, compute_metrics
from geoaim.prediction.policies import ITRAPolicy
from geoaim.prediction.realism import compute_realism
from geoaim.prediction.segments import control_present
from geoaim.simulation.simulator import rollout
from tests.prediction.tiny import TINY, drive, hill

HISTORY, STEPS, LEAVES, ENTERS = 4, 20, 16, 9  # the car leaves and the pedestrian enters


def traffic(enters=ENTERS, leaves=LEAVES):
    """In each segment a car that leaves and another agent that enters; both are controlled."""
    segments = drive(STEPS, 3)
    present = segments.present.clone()
    present[:, 0, leaves:], present[:, 1, :enters] = False, False
    states = torch.where(present[..., None], segments.states, 0.0)
    controlled = torch.ones_like(segments.controlled)
    return replace(segments, present=present, states=states, controlled=controlled)


def list_predictors():
    torch.manual_seed(0)
    blind = replace(TINY, use_observations=False)
    return {**BASELINES, **{str(config): ITRA(config).eval().sample for config in (TINY, blind)}}


def sample(predictor, segments, samples=2):
    noise = torch.Generator().manual_seed(0)
    return predictor(segments, hill(), history=HISTORY, samples=samples, generator=noise)


@pytest.mark.parametrize("name", list_predictors())
def test_what_simulated_agents_did_changes_nothing(name):
    segments, predictor = traffic(), list_predictors()[name]
    noise = 50 * torch.randn(segments.states.shape, generator=torch.Generator().manual_seed(1))
    known = torch.zeros_like(segments.present)
    known[:, :, :HISTORY], known[:, 1, ENTERS] = True, True  # and the state that it enters in
    known |= ~segments.present
    other = replace(segments, states=torch.where(known[..., None], segments.states, noise))
    one, two = (sample(predictor, s) for s in (segments, other))
    assert torch.equal(one, two)
    # what follows after it has left: the views do not show it
    gone = ~segments.present
    gone[:, 1] = False
    after = replace(segments, states=torch.where(gone[..., None], noise, segments.states))
    there = segments.present[:, None, ..., None].expand_as(one)
    assert torch.equal(one[there], sample(predictor, after)[there])


def test_who_enters_begins_as_recorded_and_then_moves_by_the_model():
    segments = traffic()
    futures = sample(list_predictors()[str(TINY)], segments)
    recorded = segments.states[:, None, 1]
    assert torch.equal(futures[:, :, 1, ENTERS], recorded[:, :, ENTERS].expand(-1, 2, -1))
    assert (futures[:, :, 1, ENTERS + 1 :] != recorded[:, :, ENTERS + 1 :]).any(dim=-1).all()
    noisy = sample(BASELINES[NOISY], segments)
    turns = noisy[:, 0, 1, ENTERS, 2] - noisy[:, 1, 1, ENTERS, 2]
    assert (turns.abs() > 1e-4).all()


def test_who_leaves_is_seen_by_others_until_then():
    segments, predictor = traffic(enters=0), list_predictors()[str(TINY)]
    whole = sample(predictor, segments)
    sooner = traffic(enters=0, leaves=HISTORY + 3)
    apart = (whole - sample(predictor, sooner))[:, :, 1].abs().amax(dim=(0, 1, 3))  # (T,)
    assert apart[: HISTORY + 3].max() == 0
    assert apart[-1] > 0


def test_simulator_and_model_move_partial_agents_alike():
    torch.manual_seed(0)
    model, segments = ITRA(replace(TINY)).eval(), traffic()
    cars = replace(segments, layers=torch.zeros_like(segments.layers))
    given = {"history": HISTORY, "samples": 2}
    whole = model.sample(cars, hill(), **given, generator=torch.Generator().manual_seed(0))
    noise = torch.Generator().manual_seed(0)
    policy = ITRAPolicy(model, cars, hill(), **given, generator=noise)
    moved = cars.controlled.repeat_interleave(2, dim=0)
    states = rollout(policy.scenario, policy, moved, history=HISTORY)
    torch.testing.assert_close(states, whole.flatten(0, 1), atol=1e-5, rtol=0)


def test_displacements_are_over_the_steps_at_which_an_agent_is_there():
    segments = traffic(enters=0)
    futures = segments.states[:, None].repeat(1, 2, 1, 1, 1)
    futures[:, 0, :, :, 1] += torch.linspace(0, 1.9, STEPS)  # 0.1 m a step
    futures[:, 1, :, :, 1] += 9.0
    found = compute_metrics(futures, segments, HISTORY)
    whole, left = 0.1 * torch.arange(HISTORY, STEPS), 0.1 * torch.arange(HISTORY, LEAVES)
    assert found["minADE"].mean == pytest.approx(float(whole.mean() + left.mean()) / 2, abs=1e-5)
    assert found["minFDE"].mean == pytest.approx((1.9 + 1.5) / 2, abs=1e-5)
    assert found["MFD"].mean == pytest.approx((9 - 1.9 + 9 - 1.5) / 2, abs=1e-4)
    steps = STEPS - HISTORY + LEAVES - HISTORY
    assert found["collision rate"].counts.tolist() == [2.0 * steps] * 3


def test_who_enters_later_or_leaves_within_a_second_has_no_displacement():
    futures = drive(STEPS, 3).states[:, None]
    found = compute_metrics(futures, traffic(), HISTORY)
    assert found["minADE"].counts.tolist() == [1.0] * 3  # the car
    soon = compute_metrics(futures, traffic(leaves=HISTORY + 9), HISTORY)
    assert soon["minADE"].counts.tolist() == [0.0] * 3
    assert soon["collision rate"].counts.tolist() == [9.0 + STEPS - ENTERS] * 3
    enough = compute_metrics(futures, traffic(leaves=HISTORY + 10), HISTORY)
    assert enough["minADE"].counts.tolist() == [1.0] * 3


def test_without_partial_agents_metrics_are_plain_means():
    segments = traffic(enters=0, leaves=STEPS)
    noise = torch.randn(3, 4, 2, STEPS, 4, generator=torch.Generator().manual_seed(0))
    futures = segments.states[:, None] + noise
    distances = (noise + 0)[..., HISTORY:, :2]
    offsets = futures[..., HISTORY:, :2] - segments.states[:, None, :, HISTORY:, :2]
    assert torch.allclose(offsets, distances, atol=1e-5)
    errors = offsets.norm(dim=-1)
    assert torch.equal(compute_ade(futures, segments, HISTORY), errors.mean(dim=-1))
    found = compute_metrics(futures, segments, HISTORY)
    for name, part in {"ADE": errors.mean(dim=-1), "FDE": errors[..., -1]}.items():
        assert found[f"min{name}"].sums.tolist() == part.amin(dim=1).sum(dim=1).tolist()
        joint = (part.sum(dim=2).amin(dim=1) / 2).tolist()
        assert found[f"joint min{name}"].sums.tolist() == joint


def test_realism_is_of_the_steps_at_which_an_agent_is_there():
    segments = traffic(enters=0)
    futures = segments.states[:, None].repeat(1, 3, 1, 1, 1)
    found = compute_realism(futures, segments, HISTORY)
    elsewhere = torch.where(segments.present[:, None, ..., None], futures, 500.0)
    again = compute_realism(elsewhere, segments, HISTORY)
    assert found.keys() == again.keys()
    assert all((found[name].sums == again[name].sums).all() for name in found)


def test_proposals_control_agents_of_all_observed_steps_alone():
    segments = traffic()
    assert control_present(segments, slice(HISTORY)).controlled.tolist() == [[True, False]] * 3
    assert not control_present(segments, slice(None)).controlled.any()
