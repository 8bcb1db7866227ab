from dataclasses import replace

import pytest
import torch

from geoaim.prediction import neighbours
from geoaim.prediction.neighbours import split_views
from geoaim.prediction.observation import index_controlled, render_observation
from geoaim.prediction.segments import VEHICLE, Segments, repeat
from tests.prediction.test_itra import model, noise
from tests.prediction.tiny import TINY, hill


def stand(count, *, spacing=8.0, steps=6):
    """Cars in rows, all controlled, of which one is absent."""
    numbers = torch.arange(count)
    states = torch.zeros(1, count, steps, 4)
    row, column = numbers[:, None] // 20, numbers[:, None] % 20
    states[..., 0], states[..., 1] = spacing * column, spacing * row
    states[..., 2:] = torch.rand(1, count, 1, 2, generator=noise()) * 5
    present = torch.ones(1, count, steps, dtype=torch.bool)
    present[:, 3] = False
    return Segments(
        states=states,
        present=present,
        sizes=torch.tensor([4.5, 1.8]).expand(1, count, 2),
        layers=torch.full((1, count), VEHICLE),
        controlled=torch.ones(1, count, dtype=torch.bool),
        places=torch.zeros(1, dtype=torch.long),
        stop_lines=torch.zeros(1, 0, 2, 2),
        light_states=torch.zeros(1, steps, 0, dtype=torch.long),
        dt=0.1,
    )


def list_parts(segments, step=0):
    controlled = index_controlled(segments)
    return list(split_views(TINY.view, segments, controlled, segments.states[:, :, step], step))


@pytest.fixture
def many(monkeypatch):
    """Limits that make any number of agents many."""
    monkeypatch.setattr(neighbours, "MAX_BOXES", 200)


def test_few_agents_are_drawn_in_each_others_views():
    (part,) = list_parts(stand(60))
    assert part.seen is None


def test_views_of_many_agents_show_the_same(many):
    segments = repeat(stand(60), 2)
    states = segments.states[:, :, 0] + 3 * torch.rand(2, 60, 4, generator=noise())

    def render(part):
        return render_observation(TINY.view, hill(), segments, part, states, 0)

    everything = index_controlled(segments)
    parts = list(split_views(TINY.view, segments, everything, states, 0))
    assert len(parts) > 1
    assert all(part.seen is not None for part in parts)
    assert torch.equal(torch.cat([render(part) for part in parts]), render(everything))


def test_futures_of_many_agents_are_the_same(monkeypatch):
    futures = []
    for limit in (500_000, 200):
        monkeypatch.setattr(neighbours, "MAX_BOXES", limit)
        sample = model().sample
        futures.append(sample(stand(60), hill(), history=3, samples=2, generator=noise()))
    torch.testing.assert_close(futures[0], futures[1])


def test_work_grows_with_the_agents_and_not_with_their_square(many):
    boxes = [sum(part.seen.numel() for part in list_parts(stand(n))) / n for n in (400, 1600)]
    assert boxes[1] < 1.2 * boxes[0]


def test_agents_out_of_reach_and_absent_ones_are_not_seen(many):
    segments = stand(60, spacing=1000.0)
    seen = torch.cat([part.seen for part in list_parts(segments)])
    agent = torch.arange(60)
    agent[3] = -1  # it is absent
    assert torch.equal(seen, agent[:, None])
    all_absent = replace(segments, present=torch.zeros_like(segments.present))
    assert all((part.seen == -1).all() for part in list_parts(all_absent))
