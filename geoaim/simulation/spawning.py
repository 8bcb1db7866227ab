"""Simulation of agents that enter when there is room and leave at the ends of their routes."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.simulation.overlap import box_iou
from geoaim.simulation.routes import Routes, locate
from geoaim.simulation.simulator import Policy, Scenario, step

ENTRY_GAP_M = 1.0  # ahead of agents, besides their braking distances
ENTRY_DECELERATION_MPS2 = 3.0


@dataclass(frozen=True, eq=False)
class _Entries:
    """How agents enter: at the step of their first record or later, in its state."""

    step: Int[Tensor, "B A"]
    states: Float[Tensor, "B A 4"]


def rollout_routes(
    scenario: Scenario,
    policy: Policy,
    controlled: Bool[Tensor, "B A"],
    routes: Routes,
    *,
    history: int = 1,
) -> tuple[Float[Tensor, "B A T 4"], Bool[Tensor, "B A T"]]:
    """Simulate a scenario in which controlled agents enter and leave by themselves.

    A controlled agent enters at its first recorded step, or later, when no other agent is in its
    way. It leaves at the end of its route, unless its recording ends at a standstill. All others
    replay.

    Args:
        scenario: the recording.
        policy: gives the actions of all agents.
        controlled: (B, A) agents that the policy moves.
        routes: the routes of all agents.
        history: number of first steps, 1 or more, in which all agents replay.

    Returns:
        (B, A, T, 4) x, y, heading, speed of all agents, 0 while absent; (B, A, T) their presence.
    """
    entries = _find_entries(scenario)
    present = scenario.present.clone()
    path = list(scenario.states[:, :, :history].unbind(2))
    entered = present[:, :, :history].any(dim=2)
    for index in range(history - 1, present.shape[2] - 1):
        actions = policy(replace(scenario, present=present), torch.stack(path, dim=2))
        everywhere = torch.stack([present[:, :, index]] * 2, dim=2)
        moving = replace(scenario, states=torch.stack([path[-1]] * 2, dim=2), present=everywhere)
        states = step(moving, 0, path[-1], actions, controlled)
        ends = (locate(routes.points, states[..., :2]) >= routes.lengths) & ~routes.stops
        recorded = scenario.present[:, :, index + 1]
        stays = torch.where(controlled, present[:, :, index] & ~ends, recorded)
        states = torch.where(controlled[..., None], states, scenario.states[:, :, index + 1])
        enters = controlled & ~entered & (entries.step <= index + 1)
        if enters.any():
            enters = _find_room(entries, enters, states, stays, scenario.sizes)
            states = torch.where(enters[..., None], entries.states, states)
        entered |= enters
        present[:, :, index + 1] = stays | enters
        path.append(torch.where(present[:, :, index + 1, None], states, 0.0))
    return torch.stack(path, dim=2), present


def _find_entries(scenario: Scenario) -> _Entries:
    """Find when, where and how fast agents enter in the recording."""
    first = scenario.present.int().argmax(dim=2)
    states = scenario.states.gather(2, first[..., None, None].expand(-1, -1, 1, 4))[:, :, 0]
    return _Entries(first, states)


def _find_room(
    entries: _Entries,
    due: Bool[Tensor, "B A"],
    states: Float[Tensor, "B A 4"],
    present: Bool[Tensor, "B A"],
    sizes: Float[Tensor, "B A 2"],
) -> Bool[Tensor, "B A"]:
    """Mark those due agents whose ground neither a present agent nor an earlier due one needs."""
    states = torch.where(due[..., None], entries.states, states)
    x, y, heading, speed = states.unbind(-1)
    room = ENTRY_GAP_M + speed.clamp_min(0).square() / (2 * ENTRY_DECELERATION_MPS2)
    shifted = [x + room / 2 * heading.cos(), y + room / 2 * heading.sin(), heading]
    longer = sizes + torch.stack([room, torch.zeros_like(room)], dim=-1)
    overlaps = box_iou(torch.stack(shifted, dim=-1), longer, present | due) > 0
    earlier = torch.ones_like(overlaps).tril(-1) & due[:, None]
    return due & ~(overlaps & (present[:, None] | earlier)).any(dim=-1)
