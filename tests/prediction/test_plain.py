import dataclasses

import pytest
import torch

from geoaim.prediction.checkpoints import read_model, write_model
from geoaim.prediction.items import SegmentItems
from geoaim.prediction.itra import ITRA
from geoaim.prediction.plain import train_plain
from geoaim.prediction.plans import Goal
from geoaim.prediction.segments import pick
from tests.prediction.tiny import TINY, drive, hill


@pytest.fixture(scope="module")
def networks():
    """Networks that were trained on cars on arcs, for any place and for theirs."""
    segments = drive(steps=30, count=8)
    return [
        train_plain(segments, TINY, history=10, place=place, steps=60) for place in (False, True)
    ]


def sample(predictor, segments, samples=6):
    generator = torch.Generator().manual_seed(0)
    return predictor(segments, hill(), history=10, samples=samples, generator=generator)


def test_it_learns_a_curve_that_going_straight_misses(networks):
    segments = drive(steps=30, count=8)
    for network in networks:
        futures = sample(network.sample, segments)
        assert futures.shape == (8, 6, 2, 30, 4)
        assert torch.equal(
            futures[:, :, 1], segments.states[:, None, 1].expand_as(futures[:, :, 1])
        )
        errors = (futures - segments.states[:, None])[:, :, 0, 10:, :2].norm(dim=-1).mean(dim=-1)
        assert errors.amin(dim=1).mean() < 0.35


def test_half_of_the_samples_follow_the_network_that_the_models_file_keeps(networks, tmp_path):
    model, segments = ITRA(TINY).eval(), drive(steps=30, count=8)
    away = sample(model.sample, segments)
    model.own_place = networks[1]
    followed = sample(model.sample, segments)
    planned, _ = networks[1].plan(segments, 10)
    off = (followed[:, :, 0, 10:, :2] - planned[:, 0, ..., :2]).norm(dim=-1).mean(dim=(0, 2))
    assert (off[:3] < 0.1).all()
    assert (off[3:] > 0.1).all()
    assert torch.equal(followed[:, 3:], away[:, 3:])
    write_model(model, tmp_path / "model.pt")
    again = sample(read_model(tmp_path / "model.pt").sample, segments)
    torch.testing.assert_close(again, followed, atol=0.05, rtol=0)
    elsewhere = pick(segments, slice(None))
    elsewhere.states[:, :, :, 0] += 500.0
    assert not networks[1].plan(elsewhere, 10)[1].any()


def test_the_best_single_guess_comes_first_and_then_the_likeliest(networks):
    segments = drive(steps=30, count=8)
    plans, _ = networks[0].plan(segments, 10)
    past = segments.states[:, 0, :10]
    states, logits = networks[0](past, segments.present[:, 0, :10], segments.sizes[:, 0])
    torch.testing.assert_close(plans[:, 0, 0], states[:, 0])
    likeliest = 1 + logits[:, 1:].argmax(dim=1)
    torch.testing.assert_close(plans[:, 0, 1], states[torch.arange(8), likeliest])


def test_agents_that_stand_are_not_moved_by_a_network(networks):
    segments = drive(steps=30)
    segments.states[:, 0] = segments.states[:, 0, :1]
    segments.states[:, 0, :, 3] = 0.0
    futures = sample(networks[1].sample, segments)
    assert torch.equal(
        futures[:, :, 0, -1, :2], segments.states[:, None, 0, -1, :2].expand(-1, 6, -1)
    )


def test_segments_are_loaded_in_batches():
    segments = drive(steps=30)
    loader = torch.utils.data.DataLoader(segments, batch_size=2)
    assert [len(batch["states"]) for batch in loader] == [2, 1]
    items = SegmentItems(segments, hill(), TINY.view)
    batch = next(iter(torch.utils.data.DataLoader(items, batch_size=3)))
    assert batch["view"].shape == (3, 7, 16, 16)
    assert batch["past"].shape == (3, 2, 10, 4)
    torch.testing.assert_close(batch["past"][:, 0, -1, :3], torch.zeros(3, 3), atol=1e-5, rtol=0)
    assert (batch["future"][:, 0, 0, 0] > 0.3).all()
    assert batch["ego"].tolist() == [0, 0, 0]
    with pytest.raises(IndexError, match="index 3 of 3"):
        items[3]


def test_agents_are_steered_through_way_points_and_to_a_speed():
    model, segments = ITRA(TINY).eval(), drive(steps=50)
    segments = dataclasses.replace(segments, ids=(("a", "p"), ("b", "q"), ("c", "r")))
    now = segments.states[:, 0, 9]
    goal = tuple((now[0, :2] + torch.tensor([14.0, 4.0])).tolist())
    goals = {"a": Goal([goal], times=[3.0]), "b": Goal(speed=9.0)}
    generator = torch.Generator().manual_seed(0)
    given = {"history": 10, "samples": 2, "generator": generator}
    futures = model.sample(segments, hill(), goals=goals, **given)
    reached = futures[0, :, 0, 9 + 30, :2] - torch.tensor(goal)
    assert (reached.norm(dim=-1) < 1.0).all()
    assert ((futures[1, :, 0, -1, 3] - 9).abs() < 0.5).all()
    with pytest.raises(ValueError, match="agent p"):
        model.sample(segments, hill(), goals={"p": goals["a"]}, **given)
    with pytest.raises(ValueError, match="rising"):
        Goal([(0.0, 1.0)], times=[-1.0])
