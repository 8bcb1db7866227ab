"""Braking for others and for red lights, driven step by step."""

from dataclasses import replace

import pytest
import torch

from geoaim.prediction.braking import limit_acceleration, limit_for_red_lights
from geoaim.prediction.itra import ITRA
from geoaim.simulation.kinematics import bicycle
from tests.prediction.tiny import TINY, drive, hill

DT = 0.1
SIZE = torch.tensor([[4.5, 1.8]])
LINE = torch.tensor([[[[40.0, -2.0], [40.0, 2.0]]]])  # across the path of a car that drives east


def drive_east(limit, *, speed=12.0, steps=80):
    """Drive a car that never brakes by itself; gives x of its front at each step, and its speed."""
    pose, fronts = torch.tensor([[0.0, 0.0, 0.0, speed]]), []
    for _ in range(steps):
        most = limit(pose, torch.zeros(1))
        action = torch.stack([most.clamp_max(0.0), torch.zeros(1)], dim=1)
        pose = bicycle.step(pose, action, SIZE[:, 0], DT)
        fronts.append(float(pose[0, 0] + SIZE[0, 0] / 2))
    return fronts, float(pose[0, 3])


def meet(other, size=(4.5, 1.8)):
    others, sizes = torch.tensor([[other]]), torch.tensor([[size]])
    none, there = torch.zeros(1, 1), torch.ones(1, 1, dtype=torch.bool)

    def limit(pose, curvature):
        return limit_acceleration(pose, SIZE, curvature, others, sizes, none, there, DT)

    return limit


@pytest.mark.parametrize(
    ("other", "stops"),
    [
        ((40.0, 0.0, 0.0, 0.0), True),  # stands ahead
        ((40.0, 3.5, 0.0, 0.0), False),  # in the next lane
        ((-20.0, 0.0, 0.0, 0.0), False),  # behind
    ],
)
def test_a_car_stops_behind_who_stands_on_its_arc(other, stops):
    fronts, speed = drive_east(meet(other))
    assert (speed < 0.1) is stops
    if stops:
        assert 30 < fronts[-1] < other[0] - 4.5 / 2 - 1


def test_a_car_stops_for_a_pedestrian_who_gets_there_first():
    pedestrian = (25.0, -2.5, torch.pi / 2, 1.4)
    limit = meet(pedestrian, (0.5, 0.6))
    assert limit(torch.tensor([[0.0, 0.0, 0.0, 12.0]]), torch.zeros(1)) < 0
    gone = meet((25.0, 4.0, torch.pi / 2, 1.4), (0.5, 0.6))
    assert torch.isinf(gone(torch.tensor([[0.0, 0.0, 0.0, 12.0]]), torch.zeros(1)))


def face(red, line=LINE):
    def limit(pose, curvature):
        lights = line, torch.tensor([[red]])
        return limit_for_red_lights(pose, SIZE, curvature, *lights, DT)

    return limit


def test_a_car_stops_before_a_red_light_and_for_no_other():
    fronts, speed = drive_east(face(True))
    assert speed < 0.1
    assert 38 < fronts[-1] < 40
    fronts, speed = drive_east(face(False))
    assert speed == 12.0


def test_a_car_that_cannot_stop_any_more_goes_on():
    pose = torch.tensor([[30.0, 0.0, 0.0, 15.0]])  # 7.75 m: 14.5 m/s² would be needed
    assert torch.isinf(face(True)(pose, torch.zeros(1)))
    past = torch.tensor([[38.0, 0.0, 0.0, 3.0]])  # the front is beyond the line
    assert torch.isinf(face(True)(past, torch.zeros(1)))


def test_a_red_light_beside_the_arc_stops_nobody():
    pose = torch.tensor([[20.0, 0.0, 0.0, 8.0]])
    assert torch.isfinite(face(True)(pose, torch.zeros(1)))
    assert torch.isinf(face(True)(pose, torch.tensor([0.1])))  # turns left in front of it


def test_places_without_lights_and_lines_of_no_length_have_finite_gradients():
    pose = torch.tensor([[0.0, 0.0, 0.0, 12.0]], requires_grad=True)
    none = torch.zeros(1, 0, 2, 2), torch.zeros(1, 0, dtype=torch.bool)
    assert torch.isinf(limit_for_red_lights(pose, SIZE, torch.zeros(1), *none, DT))
    lines = torch.cat([LINE, torch.zeros(1, 1, 2, 2)], dim=1)
    red = torch.ones(1, 2, dtype=torch.bool)
    limit_for_red_lights(pose, SIZE, torch.zeros(1), lines, red, DT).sum().backward()
    assert torch.isfinite(pose.grad).all()


def test_who_stands_does_not_creep():
    segments = drive(40, curve=0.0)
    states = segments.states.clone()
    states[:, 0] = states[:, 0, :1] * states.new_tensor([1, 1, 1, 0])
    ways = {}
    for brakes in (False, True):
        torch.manual_seed(0)
        itra = ITRA(replace(TINY, brakes=brakes, latent_scale=0.1)).eval()
        with torch.no_grad():
            itra.decode_action[-1].weight *= 0.1
            itra.decode_action[-1].bias.copy_(torch.tensor([0.02, 0.0]))
        still = replace(segments, states=states)
        futures = itra.sample(still, hill(), history=4, samples=2, generator=torch.Generator())
        ways[brakes] = float((futures[:, :, 0, -1, 0] - futures[:, :, 0, 3, 0]).abs().max())
    assert ways[False] > 0.2
    assert ways[True] == 0
