"""Safe speeds behind others and before red lights, driven step by step."""

import pytest
import torch

from geoaim.prediction.safe_speeds import compute_safe_speed_before_red, compute_safe_speeds
from geoaim.simulation.kinematics import bicycle

DT = 0.1
SIZE = torch.tensor([[4.5, 1.8]])
LINE = torch.tensor([[[[40.0, -2.0], [40.0, 2.0]]]])  # across the path of a car that drives east


def drive_east(find_safe, *, speed=12.0, steps=80):
    """Drive a car as fast as is safe; gives x of its front at each step, and its speed."""
    pose, fronts = torch.tensor([[0.0, 0.0, 0.0, speed]]), []
    for _ in range(steps):
        most = (find_safe(pose, torch.zeros(1)) - pose[:, 3]) / DT
        action = torch.stack([most.clamp(-8.0, 0.0), torch.zeros(1)], dim=1)
        pose = bicycle.step(pose, action, SIZE[:, 0], DT)
        fronts.append(float(pose[0, 0] + SIZE[0, 0] / 2))
    return fronts, float(pose[0, 3])


def meet(other, size=(4.5, 1.8)):
    others, sizes = torch.tensor([[other]]), torch.tensor([[size]])
    none, there = torch.zeros(1, 1), torch.ones(1, 1, dtype=torch.bool)

    def find_safe(pose, curvature):
        safe = compute_safe_speeds(pose, SIZE, curvature, others, sizes, none, there)
        return safe.amin(dim=1)

    return find_safe


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


@pytest.mark.parametrize("side", [-1, 1])
def test_a_leader_round_a_bend_that_is_yet_to_come_is_seen(side):
    pose = torch.tensor([[0.0, 0.0, 0.0, 7.0]])  # straight on until now
    radius, turned = 15.0, torch.tensor(0.9)
    x, y = radius * float(turned.sin()), side * radius * float(1 - turned.cos())
    heads = {"on the bend": 0.9, "straight on": 0.0, "towards": 0.9 - torch.pi, "across": -0.7}
    safe = {
        name: float(meet((x, y, side * angle, 0.5))(pose, torch.zeros(1)))
        for name, angle in heads.items()
    }
    assert 4 < safe.pop("on the bend") < 9
    assert set(safe.values()) == {torch.inf}


def test_who_waits_beside_the_road_is_no_leader_round_a_bend():
    """A pedestrian at the kerb, and a car that waits in a side road, faster than one could turn."""
    slow, fast = torch.tensor([[0.0, 0.0, 0.0, 3.0]]), torch.tensor([[0.0, 0.0, 0.0, 10.0]])
    place = 5.0, -4.5, -1.4, 0.0
    assert torch.isinf(meet(place, size=(0.5, 0.6))(slow, torch.zeros(1)))
    assert torch.isinf(meet(place)(fast, torch.zeros(1)))
    assert torch.isfinite(meet(place)(slow, torch.zeros(1)))


def test_a_car_stops_for_a_pedestrian_who_gets_there_first():
    pedestrian = (25.0, -2.5, torch.pi / 2, 1.4)
    near = meet(pedestrian, (0.5, 0.6))
    assert near(torch.tensor([[0.0, 0.0, 0.0, 12.0]]), torch.zeros(1)) < 12
    gone = meet((25.0, 4.0, torch.pi / 2, 1.4), (0.5, 0.6))
    assert torch.isinf(gone(torch.tensor([[0.0, 0.0, 0.0, 12.0]]), torch.zeros(1)))


def face(red, line=LINE):
    def find_safe(pose, curvature):
        lights = line, torch.tensor([[red]])
        return compute_safe_speed_before_red(pose, SIZE, curvature, *lights)

    return find_safe


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


def test_a_stop_line_along_the_way_is_of_others():
    pose = torch.tensor([[0.0, 0.0, 0.0, 12.0]])
    across = torch.tensor([[[[40.0, -2.0], [42.0, 2.0]]]])  # a little oblique
    assert torch.isfinite(face(True, across)(pose, torch.zeros(1)))
    along = torch.tensor([[[[38.0, -1.0], [42.0, 1.0]]]])
    assert torch.isinf(face(True, along)(pose, torch.zeros(1)))


def test_places_without_lights_and_lines_of_no_length_have_finite_gradients():
    pose = torch.tensor([[0.0, 0.0, 0.0, 12.0]], requires_grad=True)
    none = torch.zeros(1, 0, 2, 2), torch.zeros(1, 0, dtype=torch.bool)
    assert torch.isinf(compute_safe_speed_before_red(pose, SIZE, torch.zeros(1), *none))
    lines = torch.cat([LINE, torch.zeros(1, 1, 2, 2)], dim=1)
    red = torch.ones(1, 2, dtype=torch.bool)
    compute_safe_speed_before_red(pose, SIZE, torch.zeros(1), lines, red).sum().backward()
    assert torch.isfinite(pose.grad).all()
