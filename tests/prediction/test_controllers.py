"""The rules outside the network: who waits, who starts, and who brakes."""

from dataclasses import replace

import pytest
import torch

from geoaim.prediction.controllers import brake, follow, start
from geoaim.prediction.itra import ITRA
from geoaim.tracks.lights import GREEN, RED
from tests.prediction.tiny import TINY, drive, hill

HISTORY, STEPS = 4, 40
TURNS_GREEN = 20  # step
LINE = [[3.5, -3.0], [3.5, 3.0]]  # 1.25 m ahead of the car that stands at the origin


def stand(*, red=0, leader_leaves=False):
    """A car that stands: before a light that is red for some steps, or behind another one."""
    segments = drive(STEPS, 1)
    states = torch.zeros_like(segments.states)
    states[:, 1] = states.new_tensor([0.0, 50.0, 0.0, 0.0])
    lights = torch.full_like(segments.light_states, GREEN)
    lights[:, :red] = RED
    sizes = segments.sizes[:, :1].expand(-1, 2, -1)
    if leader_leaves:
        time = 0.1 * (torch.arange(STEPS) - TURNS_GREEN).clamp_min(0)
        states[:, 1, :, 0] = 6.5 + 5.0 * time
        states[:, 1, :, 1] = 0.0
        states[:, 1, :, 3] = 5.0 * (time > 0)
    lines = segments.stop_lines.new_tensor([[LINE]])
    return replace(segments, states=states, light_states=lights, sizes=sizes, stop_lines=lines)


def sample(segments, acceleration, controllers=(follow, start, brake)):
    """x of the car at all steps, by a network that wants an acceleration of 2 m/s² times that."""
    torch.manual_seed(0)
    itra = ITRA(replace(TINY, brakes=True, latent_scale=0.0)).eval()
    itra.controllers = list(controllers)
    with torch.no_grad():
        itra.decode_action[-1].weight.zero_()
        itra.decode_action[-1].bias.copy_(torch.tensor([acceleration, 0.0]))
    some = {"history": HISTORY, "samples": 1, "generator": torch.Generator()}
    return itra.sample(segments, hill(), **some)[0, 0, 0, :, 0]


@pytest.mark.parametrize("given", [{"red": TURNS_GREEN}, {"leader_leaves": True}])
def test_who_waits_goes_when_its_reason_does(given):
    x = sample(stand(**given), 0.0)
    assert x[TURNS_GREEN].abs() < 0.05
    assert x[-1] > 1
    left = sample(stand(**given), 0.0, (follow, brake))
    assert left[-1].abs() < 0.05


def test_who_waits_does_not_creep_up_to_a_red_light():
    assert sample(stand(red=STEPS), 0.1)[-1] == 0
    assert sample(stand(red=STEPS), 0.1, (follow, brake))[-1] > 0.3


def test_who_has_no_reason_to_wait_is_started_by_the_network():
    assert sample(stand(), 0.05)[-1] == 0
    assert sample(stand(), 0.05, (follow, brake))[-1] > 0.3
    assert sample(stand(), 0.5)[-1] > 3


def test_nobody_brakes_into_reverse():
    torch.manual_seed(0)
    itra = ITRA(replace(TINY, brakes=True)).eval()
    with torch.no_grad():
        itra.decode_action[-1].bias.copy_(torch.tensor([-9.0, 0.0]))
    futures = itra.sample(drive(40), hill(), history=4, samples=2, generator=torch.Generator())
    assert float(futures[:, :, 0, -1, 3].abs().max()) == 0
    assert float(futures[:, :, 0, :, 3].min()) == 0
