"""ITRA step by step, and as a policy of the simulator."""

from dataclasses import replace

import pytest
import torch

from geoaim.prediction import ITRAPolicy, cut_segments, read_pretrained
from geoaim.prediction.segments import pick
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.simulation.simulator import rollout
from tests.prediction.test_itra import KINDS, model, noise
from tests.prediction.test_predict import hdmap, scene  # noqa: F401 (fixtures)
from tests.prediction.tiny import drive, hill

HISTORY, SAMPLES = 4, 3


@pytest.mark.parametrize("kind", KINDS)
def test_steps_in_a_loop_are_the_sample(kind):
    config = KINDS[kind]
    config = replace(config, history=HISTORY, horizon=6) if config.num_anchors else config
    itra, segments, generator = model(config).eval(), drive(10), noise()
    given = {"history": HISTORY, "samples": SAMPLES}
    whole = itra.sample(segments, hill(), **given, generator=noise())
    with torch.no_grad():
        here = itra.start(segments, hill(), **given)
        for step in range(HISTORY, 10):
            here = itra.step(here, itra.draw_latent(here, generator))
            assert torch.equal(here.states, whole[..., step, :].flatten(0, 1))
    with pytest.raises(ValueError, match="the segments end at step 9"):
        itra.step(here)


@pytest.mark.parametrize("kind", ["bicycle", "surface contrast"])
def test_the_policy_in_the_simulator_gives_the_samples(kind):
    itra, segments = model(KINDS[kind]).eval(), drive(10)
    given = {"history": HISTORY, "samples": SAMPLES}
    whole = itra.sample(segments, hill(), **given, generator=noise())
    policy = ITRAPolicy(itra, segments, hill(), **given, generator=noise())
    controlled = segments.controlled.repeat_interleave(SAMPLES, dim=0)
    states = rollout(policy.scenario, policy, controlled, history=HISTORY)
    torch.testing.assert_close(states, whole.flatten(0, 1), atol=1e-5, rtol=0)
    with pytest.raises(ValueError, match="give history=4 to rollout"):
        rollout(policy.scenario, policy, controlled, history=HISTORY + 1)


def test_traffic_reacts_to_a_planner_that_drives_one_car_of_the_sample(scene):  # noqa: F811
    itra = read_pretrained("vehicle")
    steps = 40  # 10 observed, 3 s predicted
    segments = pick(cut_segments(scene, "vehicle", steps=steps, stride=99, joint=True), slice(1))
    ground = prefilter_ground(scene.ground, itra.config.resolution)
    planned = int(segments.controlled[0].nonzero()[1, 0])  # one before another
    others = segments.controlled.clone()
    others[:, planned] = False
    traffic = replace(segments, controlled=others)
    moved = segments.controlled.repeat_interleave(2, dim=0)

    def simulate(acceleration):
        policy = ITRAPolicy(itra, traffic, ground, history=10, samples=2, generator=noise())

        def plan(scenario, path):
            actions = policy(scenario, path)
            speed = path[:, planned, -1, 3]
            wanted = torch.full_like(speed, acceleration)
            actions[:, planned, 0] = torch.maximum(wanted, -speed / scenario.dt)
            return actions

        return rollout(policy.scenario, plan, moved, history=10)

    with torch.no_grad():
        braked, hurried = simulate(-6.0), simulate(2.0)
    apart = (braked - hurried)[..., -1, :2].norm(dim=-1)  # (K, N)
    assert apart[:, planned].min() > 5  # metres
    assert apart[:, others[0]].max() > 0.05  # someone has seen it
    replaying = ~segments.controlled[0]
    assert apart[:, replaying].max() == 0


def test_latents_and_gradients_reach_a_goal():
    itra, segments = model().eval(), drive(10, 1)
    latents = torch.zeros(1, 1, 2, 6, itra.config.latent_size, requires_grad=True)
    first = itra.decode_latents(segments, hill(), latents, history=HISTORY, gradients=True)
    goal = first[0, 0, 0, -1, :2].detach() + 0.1
    distance = (first[0, 0, 0, -1, :2] - goal).norm()
    distance.backward()
    assert latents.grad[:, :, 0].abs().sum() > 0
    assert latents.grad[:, :, 1].abs().sum() == 0  # it is not controlled
    moved = (latents - 0.5 * latents.grad / latents.grad.norm()).detach()
    nearer = itra.decode_latents(segments, hill(), moved, history=HISTORY)
    assert (nearer[0, 0, 0, -1, :2] - goal).norm() < distance
    assert not itra.decode_latents(segments, hill(), latents, history=HISTORY).requires_grad
    with pytest.raises(ValueError, match=r"latents has the shape .* is needed"):
        itra.decode_latents(segments, hill(), latents[..., :3], history=HISTORY)


def test_models_that_move_otherwise_are_no_policies():
    itra = model(replace(KINDS["unicycle"]))
    with pytest.raises(ValueError, match="'unicycle' model, the simulator by 'bicycle'"):
        ITRAPolicy(itra, drive(8), hill(), history=2)


def test_an_agent_is_placed_by_somebody_else(unchecked):
    itra, segments = model().eval(), drive(8)
    here = itra.start(segments, hill(), history=2)
    there = here.place(1, torch.full((3, 4), 5.0))
    assert (there.states[:, 1] == 5).all()
    assert torch.equal(there.states[:, 0], here.states[:, 0])
    assert not torch.equal(itra.step(there).states[:, 0], itra.step(here).states[:, 0])
    with pytest.raises(ValueError, match="states has the shape"):
        here.place(1, torch.zeros(4))
