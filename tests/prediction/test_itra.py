from dataclasses import replace

import pytest
import torch
from torch.func import functional_call

from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import compute_ade
from geoaim.prediction.segments import pick
from tests.prediction.tiny import TINY, drive, hill

KINDS = {
    "bicycle": TINY,
    "unicycle": replace(TINY, motion="unicycle"),
    "slide with proposals": replace(TINY, motion="slide", num_anchors=3, history=2, horizon=5),
    "no observations": replace(TINY, use_observations=False),
    "held latents": replace(TINY, latent_steps=3),
    "surface contrast": replace(TINY, surface_contrast=True),
}


def noise(seed=0):
    return torch.Generator().manual_seed(seed)


def model(config=TINY, dtype=torch.float32):
    torch.manual_seed(1)
    return ITRA(config).to(dtype)


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_of_the_bound_goes_through_a_whole_rollout(kind):
    itra, segments = model(KINDS[kind], torch.float64), drive(7, 1, dtype=torch.float64)
    ground = hill(torch.float64)
    weights = dict(itra.named_parameters())
    # the first action changes all later states, views and hidden states: a few weights suffice
    names = [
        name
        for name in ("decode_action.4.bias", "posterior.4.bias", "anchors.propose.4.bias")
        if name in weights
    ]

    def bound(*some):
        changed = weights | dict(zip(names, some, strict=True))
        losses = functional_call(itra, changed, (segments, ground, 2, noise()))
        return losses.nll + losses.kl + losses.anchor

    some = [weights[name].detach().clone().requires_grad_() for name in names]
    assert torch.autograd.gradcheck(bound, some, eps=1e-6, atol=1e-4, rtol=1e-3)


def test_gradient_goes_through_the_renderer():
    """The loss depends on the map through the views, whose poses depend on earlier actions."""
    itra, segments = model(), drive(8, 2)
    ground = hill()
    image = ground.image.clone().requires_grad_()
    losses = itra(segments, replace(ground, image=image), 2, noise())
    losses.nll.backward()
    assert image.grad.abs().sum() > 0


@pytest.mark.slow
def test_model_overfits_one_segment():
    segments = drive(10, 1)
    itra = model(replace(TINY, sigma=0.05, view_stride=5))
    optimiser = torch.optim.Adam(itra.parameters(), 5e-3)
    for step in range(120):
        losses = itra(segments, hill(), 4, noise(step))
        optimiser.zero_grad()
        (losses.nll + losses.kl).backward()
        torch.nn.utils.clip_grad_norm_(itra.parameters(), 1.0)
        optimiser.step()
    states = itra.eval().sample(segments, hill(), history=4, samples=6, generator=noise())
    assert compute_ade(states, segments, 4)[0, :, 0].min() < 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_samples_keep_observed_steps_and_ignore_later_ones(kind):
    config = KINDS[kind]
    config = replace(config, history=5) if config.num_anchors else config
    itra, segments = model(config).eval(), drive(10)
    sampled = itra.sample(segments, hill(), history=5, samples=5, generator=noise())
    assert sampled.shape == (3, 5, 2, 10, 4)
    truth = segments.states[:, None].expand_as(sampled)
    assert torch.equal(sampled[..., :5, :], truth[..., :5, :])
    assert torch.equal(sampled[:, :, 1], truth[:, :, 1])  # others replay
    later = segments.states.clone()
    later[:, 0, 5:] += 7
    other = itra.sample(
        replace(segments, states=later), hill(), history=5, samples=5, generator=noise()
    )
    assert torch.equal(sampled[:, :, 0], other[:, :, 0])


def test_samples_differ_and_equal_seeds_give_equal_samples():
    itra, segments = model().eval(), drive(10)
    one, two, three = (
        itra.sample(segments, hill(), history=2, samples=4, generator=noise(k)) for k in (0, 0, 1)
    )
    assert torch.equal(one, two)
    assert not torch.equal(one, three)
    ends = one[0, :, 0, -1, :2]
    assert (ends[0] - ends[1]).norm() > 1e-4


def test_a_smaller_scale_of_latents_brings_samples_closer_together():
    segments, spreads = drive(10), []
    for scale in (1.0, 0.5, 0.0):
        itra = model(replace(TINY, latent_scale=scale)).eval()
        futures = itra.sample(segments, hill(), history=2, samples=8, generator=noise())
        spreads.append(float(futures[:, :, 0, -1, :2].std(dim=1).sum()))
    assert spreads[0] > spreads[1] > spreads[2] == 0


def test_each_sample_follows_another_proposal():
    itra, segments = model(KINDS["slide with proposals"]).eval(), drive(7, 1)
    states = itra.sample(
        segments, hill(), history=2, samples=4, latent_scale=0.0, generator=noise()
    )
    ends = states[0, :, 0, -1, :2]
    assert torch.equal(ends[0], ends[3])  # three proposals, and the likeliest again
    assert min((ends[0] - ends[1]).norm(), (ends[1] - ends[2]).norm()) > 1e-5


def test_hidden_state_starts_when_an_agent_enters():
    itra, segments = model().eval(), drive(10, 1)
    present = segments.present.clone()
    present[:, 0, :3] = False
    states = segments.states.clone()
    states[:, 0, :3] = 0
    late = replace(segments, present=present, states=states)
    cut = replace(
        pick(segments, slice(None)),
        states=segments.states[:, :, 3:],
        present=segments.present[:, :, 3:],
        light_states=segments.light_states[:, 3:],
    )
    config = {"samples": 1, "latent_scale": 0.0, "generator": noise()}
    sampled = itra.sample(late, hill(), history=6, **config)[:, :, 0]
    same = itra.sample(cut, hill(), history=3, **config)[:, :, 0]
    assert torch.allclose(sampled[:, :, 3:], same, atol=1e-5)


def test_segments_that_do_not_fit_the_model_are_rejected():
    segments = drive(6)
    with pytest.raises(ValueError, match=r"a dt of 0.1 s, the model 0.4 s"):
        model(replace(TINY, dt=0.4))(segments, hill(), 2, noise())
    with pytest.raises(ValueError, match=r"history is 2 .* 6 steps; .* 2 and 7 steps"):
        model(KINDS["slide with proposals"])(segments, hill(), 2, noise())
    absent = segments.present.clone()
    absent[..., 0] = False
    with pytest.raises(ValueError, match="present in all 2 observed steps"):
        model(replace(KINDS["slide with proposals"], horizon=4))(
            replace(segments, present=absent), hill(), 2, noise()
        )
    with pytest.raises(ValueError, match="two or more observed steps; history is 1"):
        model(replace(KINDS["slide with proposals"], history=1))
    with pytest.raises(
        ValueError, match="history is 6, but the segments have 6 steps; give 1 to 5"
    ):
        model()(segments, hill(), 6, noise())
    none = replace(segments, controlled=torch.zeros_like(segments.controlled))
    with pytest.raises(ValueError, match="no agent in these segments is controlled"):
        model()(none, hill(), 2, noise())


def test_views_in_batches_give_the_same_futures(monkeypatch):
    futures = []
    for limit in (1000, 4):
        monkeypatch.setattr("geoaim.prediction.neighbours.MAX_BOXES", limit)
        sample = model().sample
        futures.append(sample(drive(), hill(), history=4, samples=3, generator=noise()))
    torch.testing.assert_close(futures[0], futures[1])
