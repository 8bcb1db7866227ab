"""Policies without a model of drivers: constant velocity and constant turn rate."""

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.simulation.simulator import Scenario, invert_step


def constant_velocity(scenario: Scenario, path: Float[Tensor, "B A t 4"]) -> Tensor:
    """Give actions (B, A, 2) that neither accelerate nor turn: a `Policy`."""
    return torch.zeros_like(path[:, :, -1, :2])


def constant_turn_rate(scenario: Scenario, path: Float[Tensor, "B A t 4"]) -> Tensor:
    """Give actions (B, A, 2) that keep speed and the last step's turn, if any: a `Policy`."""
    if path.shape[2] < 2:
        return constant_velocity(scenario, path)
    now = path.shape[2] - 1
    present = scenario.present[:, :, now - 1] & scenario.present[:, :, now]
    last = torch.where(present[..., None], path[:, :, -2], path[:, :, -1])
    actions = invert_step(scenario, last, path[:, :, -1])
    return torch.stack([torch.zeros_like(actions[..., 0]), actions[..., 1]], dim=-1)
