from dataclasses import replace

import pytest
import torch
from torch.func import functional_call

from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import displacements
from geoaim.prediction.segments import pick
from tests.prediction.made import TINY, drive, hill

KINDS = {
    "bicycle": TINY,
    "unicycle": replace(TINY, motion="unicycle"),
    "slide with plans": replace(TINY, motion="slide", modes=3, known=2, ahead=5),
    "sees nothing": replace(TINY, encoder="none"),
    "sees what is unlike": replace(TINY, unlike=True),
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
    # what acts first moves all later states, views and memories: a few weights show it all
    names = [
        name for name in ("act.4.bias", "infer.4.bias", "plan.propose.4.bias") if name in weights
    ]

    def bound(*some):
        changed = weights | dict(zip(names, some, strict=True))
        losses = functional_call(itra, changed, (segments, ground, 2, noise()))
        return losses.fit + losses.divergence + losses.plan

    some = [weights[name].detach().clone().requires_grad_() for name in names]
    assert torch.autograd.gradcheck(bound, some, eps=1e-6, atol=1e-4, rtol=1e-3)


def test_gradient_goes_through_the_renderer():
    """Where the views are drawn depends on earlier actions; the ground must tell where to go."""
    itra, segments = model(), drive(8, 2)
    ground = hill()
    image = ground.image.clone().requires_grad_()
    losses = itra(segments, replace(ground, image=image), 2, noise())
    losses.fit.backward()
    assert image.grad.abs().sum() > 0


def test_model_learns_one_segment_by_heart():
    segments = drive(10, 1)
    itra = model(replace(TINY, sigma=0.05, every=5))
    optimiser = torch.optim.Adam(itra.parameters(), 5e-3)
    for step in range(120):
        losses = itra(segments, hill(), 4, noise(step))
        optimiser.zero_grad()
        (losses.fit + losses.divergence).backward()
        torch.nn.utils.clip_grad_norm_(itra.parameters(), 1.0)
        optimiser.step()
    found = itra.eval().sample(segments, hill(), observed=4, samples=6, generator=noise())
    assert displacements(found, segments, 4)[0, :, 0].min() < 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_samples_keep_what_is_known_and_do_not_look_ahead(kind):
    config = KINDS[kind]
    config = replace(config, known=5) if config.modes else config
    itra, segments = model(config).eval(), drive(10)
    found = itra.sample(segments, hill(), observed=5, samples=5, generator=noise())
    assert found.shape == (3, 5, 10, 2, 4)
    truth = segments.states[:, None].expand_as(found)
    assert torch.equal(found[:, :, :5], truth[:, :, :5])
    assert torch.equal(found[:, :, :, 1], truth[:, :, :, 1])  # who is not controlled replays
    later = segments.states.clone()
    later[:, 5:, 0] += 7
    other = itra.sample(
        replace(segments, states=later), hill(), observed=5, samples=5, generator=noise()
    )
    assert torch.equal(found[:, :, :, 0], other[:, :, :, 0])


def test_samples_differ_and_the_same_noise_gives_the_same():
    itra, segments = model().eval(), drive(10)
    one, two, three = (
        itra.sample(segments, hill(), observed=2, samples=4, generator=noise(k)) for k in (0, 0, 1)
    )
    assert torch.equal(one, two)
    assert not torch.equal(one, three)
    ends = one[0, :, -1, 0, :2]
    assert (ends[0] - ends[1]).norm() > 1e-4


def test_each_sample_follows_another_plan():
    itra, segments = model(KINDS["slide with plans"]).eval(), drive(7, 1)
    found = itra.sample(segments, hill(), observed=2, samples=4, spread=0.0, generator=noise())
    ends = found[0, :, -1, 0, :2]
    assert torch.equal(ends[0], ends[3])  # three plans, and the likeliest again
    assert min((ends[0] - ends[1]).norm(), (ends[1] - ends[2]).norm()) > 1e-5


def test_who_comes_later_has_nothing_to_remember():
    itra, segments = model().eval(), drive(10, 1)
    present = segments.present.clone()
    present[:, :3, 0] = False
    states = segments.states.clone()
    states[:, :3, 0] = 0
    late = replace(segments, present=present, states=states)
    cut = replace(
        pick(segments, slice(None)),
        states=segments.states[:, 3:],
        present=segments.present[:, 3:],
        lights=segments.lights[:, 3:],
    )
    config = {"samples": 1, "spread": 0.0, "generator": noise()}
    found = itra.sample(late, hill(), observed=6, **config)[..., 0, :]
    same = itra.sample(cut, hill(), observed=3, **config)[..., 0, :]
    assert torch.allclose(found[:, :, 3:], same, atol=1e-5)


def test_what_does_not_fit_the_model_is_refused():
    segments = drive(6)
    with pytest.raises(ValueError, match=r"steps of 0.1 s; the model was made for 0.4 s"):
        model(replace(TINY, seconds=0.4))(segments, hill(), 2, noise())
    with pytest.raises(ValueError, match="2 of 6 steps known; the model plans 5 after 2"):
        model(KINDS["slide with plans"])(segments, hill(), 2, noise())
    absent = segments.present.clone()
    absent[:, 0] = False
    with pytest.raises(ValueError, match="to be there in all 2 steps"):
        model(replace(KINDS["slide with plans"], ahead=4))(
            replace(segments, present=absent), hill(), 2, noise()
        )
    with pytest.raises(ValueError, match="plans from 1 known steps"):
        model(replace(KINDS["slide with plans"], known=1))
    with pytest.raises(ValueError, match="6 of 6 steps are observed"):
        model()(segments, hill(), 6, noise())
    nobody = replace(segments, controlled=torch.zeros_like(segments.controlled))
    with pytest.raises(ValueError, match="nobody"):
        model()(nobody, hill(), 2, noise())
