import dataclasses
from functools import partial

import pytest
import torch

from geoaim.prediction.checkpoints import read_model, write_model
from geoaim.prediction.items import SegmentItems
from geoaim.prediction.itra import ITRA
from geoaim.prediction.plain import train_plain
from geoaim.prediction.plans import Goal
from geoaim.prediction.predict import draw_covering
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


def test_futures_take_the_proposals_that_the_models_file_keeps(networks, tmp_path):
    model, segments = ITRA(TINY).eval(), drive(steps=30, count=8)

    plans, _ = networks[1].plan(segments, 10)

    def count_proposals():
        futures = sample(partial(draw_covering, model), segments)[:, :, None, 0, 10:, :2]
        off = (futures - plans[:, None, 0, ..., :2]).norm(dim=-1).amax(dim=3).amin(dim=2)
        return float((off == 0).float().mean())

    assert count_proposals() == 0
    model.own_place = networks[1]
    assert count_proposals() > 0.5
    write_model(model, tmp_path / "model.pt")
    kept = read_model(tmp_path / "model.pt").own_place
    torch.testing.assert_close(kept.plan(segments, 10), networks[1].plan(segments, 10))
    elsewhere = pick(segments, slice(None))
    elsewhere.states[:, :, :, 0] += 500.0
    assert not networks[1].plan(elsewhere, 10)[1].any()


def test_proposals_have_probabilities(networks):
    plans, probabilities = networks[0].plan(drive(steps=30, count=8), 10)
    assert plans.shape[:3] == probabilities.shape == (8, 2, 6)
    torch.testing.assert_close(probabilities[:, 0].sum(dim=1), torch.ones(8))
    assert not probabilities[:, 1].any()  # is not controlled


def test_agents_follow_their_plans():
    model, segments = ITRA(TINY).eval(), drive(steps=30, count=8)
    plans = segments.states[:, None, :, 10:].repeat(1, 6, 1, 1, 1)
    futures = sample(partial(model.sample, plans=plans), segments)
    off = (futures - segments.states[:, None])[:, :, 0, 10:, :2].norm(dim=-1)
    assert float(off.max()) < 0.3


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
