"""A differentiable simulator: states in, states out, for a batch of recorded pieces of a scene.

Controlled agents move by the actions of a policy; all others replay the recording. Every agent
enters and leaves at the recorded times, and enters in the recorded state.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from geoaim.agent_types import select_group
from geoaim.simulation.kinematics import step_agents
from geoaim.simulation.scene import Scene

ROUTE_SPACING_M = 1.0  # above the jitter in the recorded positions of waiting agents
RECOMPUTATION_TOLERANCE = 1e-3  # between an action and the same action computed again


@dataclass(frozen=True, eq=False)
class Scenario:
    """What was recorded in B pieces of a scene, T steps each.

    Attributes:
        states: (B, T, A, 4) x, y, heading, speed; 0 while absent.
        present: (B, T, A).
        sizes: (B, A, 2) length and width, metres.
        pedestrian: (B, A) agents that move by the unicycle instead of the bicycle model.
        dt: time between two steps, seconds.
    """

    states: Float[Tensor, "B T A 4"]
    present: Bool[Tensor, "B T A"]
    sizes: Float[Tensor, "B A 2"]
    pedestrian: Bool[Tensor, "B A"]
    dt: float


@dataclass(frozen=True, eq=False)
class Rollout:
    """What happened in a simulation.

    Attributes:
        states: (B, T, A, 4) x, y, heading, speed.
        present: (B, T, A).
        actions: (B, S, A, 2) of the S simulated steps, the last of the T.
    """

    states: Float[Tensor, "B T A 4"]
    present: Bool[Tensor, "B T A"]
    actions: Float[Tensor, "B S A 2"]


# from a scenario and the states so far to the actions of all agents
Policy = Callable[[Scenario, Float[Tensor, "B t A 4"]], Float[Tensor, "B A 2"]]


def make_scenario(scene: Scene, starts: Int[Tensor, "B"], steps: int) -> Scenario:
    """Cut pieces of equal length out of a scene.

    Args:
        scene: evenly sampled.
        starts: (B,) first step of each piece.
        steps: of each piece.

    Returns:
        The B pieces as a batch.

    Raises:
        ValueError: a piece reaches beyond the scene, or the steps are not evenly spaced.
    """
    if len(starts) == 0 or int(starts.min()) < 0 or int(starts.max()) + steps > len(scene.times):
        raise ValueError(
            f"{steps} steps from {starts.tolist()} are not all among the scene's {len(scene.times)}"
        )
    if steps < 2 or (scene.times.diff() - scene.dt).abs().max() > 0.01 * scene.dt:
        raise ValueError("two steps or more are needed, evenly spaced; resample the tracks")
    index = starts[:, None] + torch.arange(steps, device=starts.device)  # (B, T)
    present = scene.present[:, index].permute(1, 2, 0)  # (B, T, A)
    states = scene.states[:, index].permute(1, 2, 0, 3)  # (B, T, A, 4)
    states = torch.where(present[..., None], states, 0.0)
    pedestrian = torch.from_numpy(select_group(scene.types, "pedestrian")).to(starts.device)
    count = len(starts)
    sizes = scene.sizes.expand(count, -1, -1)
    return Scenario(states, present, sizes, pedestrian.expand(count, -1), scene.dt)


def apply_rollout(scene: Scene, rollout: Rollout, start: int, index: int = 0) -> Scene:
    """Make a scene of a simulation, to render it or to write its tracks.

    Args:
        scene: in which it was simulated.
        rollout: a batch of simulations.
        start: step of the scene at which the simulation begins.
        index: of the simulation in the batch.

    Returns:
        The scene of the simulated steps, with agents as simulated.
    """
    steps = slice(start, start + rollout.states.shape[1])
    present = rollout.present[index].t()
    states = rollout.states[index].detach().transpose(0, 1)
    states = torch.where(present[..., None], states, torch.nan)
    return replace(
        scene,
        times=scene.times[steps],
        poses=states[..., :3],
        speeds=states[..., 3],
        present=present,
        light_states=scene.light_states[steps],
    )


def extract_routes(scenario: Scenario) -> Float[Tensor, "B A P 2"]:
    """Extract the recorded routes of agents, as points at least `ROUTE_SPACING_M` apart.

    Shorter routes are extended straight on to the length of the longest. The route of an agent that
    hardly moves leads straight ahead.
    """
    states = scenario.states.transpose(1, 2)  # (B, A, T, 4)
    keep = _select_spaced(states[..., :2], scenario.present.transpose(1, 2))
    order = keep.int().argsort(dim=2, descending=True, stable=True)
    count = keep.sum(dim=2, keepdim=True)  # (B, A, 1)
    slot = torch.arange(int(count.max()) + 1, device=keep.device)
    step = order.gather(2, slot.minimum(count - 1))  # (B, A, P), the last one repeated
    route = states.gather(2, step[..., None].expand(*step.shape, 4))
    second_last = route.gather(2, (count - 2).clamp_min(0)[..., None].expand(-1, -1, 1, 4))
    last_segment = route[:, :, -1:, :2] - second_last[..., :2]
    heading = torch.stack([second_last[..., 2].cos(), second_last[..., 2].sin()], dim=-1)
    forward = torch.where(count[..., None] > 1, last_segment, heading)
    forward = forward / forward.norm(dim=-1, keepdim=True)
    return route[..., :2] + forward * ROUTE_SPACING_M * (slot - count + 1).clamp_min(0)[..., None]


def _select_spaced(
    points: Float[Tensor, "B A T 2"], present: Bool[Tensor, "B A T"]
) -> Bool[Tensor, "B A T"]:
    """Mark each agent's first point, and each one far enough from the last marked one."""
    first = present.int().argmax(dim=2, keepdim=True)
    last = points.gather(2, first[..., None].expand(-1, -1, 1, 2))[:, :, 0]
    keep = torch.zeros_like(present).scatter(2, first, True)
    for step, point in enumerate(points.unbind(2)):
        far = present[..., step] & ((point - last).norm(dim=-1) >= ROUTE_SPACING_M)
        last = torch.where(far[..., None], point, last)
        keep[..., step] |= far
    return keep


def step(
    scenario: Scenario,
    index: int,
    states: Float[Tensor, "B A 4"],
    actions: Float[Tensor, "B A 2"],
    controlled: Bool[Tensor, "B A"],
) -> Float[Tensor, "B A 4"]:
    """Simulate one step: controlled agents act, others replay.

    Args:
        scenario: the recording.
        index: of the step from which it leads to the next.
        states: (B, A, 4) at that step.
        actions: (B, A, 2) accelerations, and steering angles or turn rates.
        controlled: (B, A) agents that the actions move.

    Returns:
        (B, A, 4) states at the next step.
    """
    moved = controlled & scenario.present[:, index] & scenario.present[:, index + 1]
    safe_actions = torch.where(moved[..., None], actions, 0.0)
    lengths = torch.where(moved, scenario.sizes[..., 0], 1.0)  # of padded agents it may be 0
    acted = step_agents(states, safe_actions, lengths, scenario.pedestrian, scenario.dt)
    return torch.where(moved[..., None], acted, scenario.states[:, index + 1])


def rollout(
    scenario: Scenario,
    policy: Policy,
    controlled: Bool[Tensor, "B A"],
    *,
    history: int = 1,
    checkpointing: bool = False,
    generator: torch.Generator | None = None,
) -> Rollout:
    """Simulate a scenario to its end.

    Args:
        scenario: the recording.
        policy: from the scenario and the states so far, (B, t, A, 4), to the actions of all agents,
            (B, A, 2); it must not read later steps of the scenario.
        controlled: (B, A) agents that the policy moves.
        history: first steps, in which all agents replay.
        checkpointing: store states only and compute each step again in the backward pass, as
            `torch.utils.checkpoint` does.
        generator: of the policy's noise; with checkpointing, the backward pass draws it again.

    Returns:
        States, presence and actions.

    Raises:
        ValueError: no step is left to simulate, or an action is not finite; in the backward pass
            with checkpointing, the policy gives another action than before.
    """
    total = scenario.states.shape[1]
    if not 1 <= history < total:
        raise ValueError(f"{history} of {total} steps are history; from 1 to {total - 1} can be")
    path = list(scenario.states[:, :history].unbind(1))
    actions = []

    def advance(act: Policy, index: int, *path: Tensor) -> tuple[Tensor, Tensor]:
        action = act(scenario, torch.stack(path, dim=1))
        return step(scenario, index, path[-1], action, controlled), action

    for index in range(history - 1, total - 1):
        if checkpointing:
            repeatable = _make_repeatable(policy, generator or torch.default_generator)
            states, action = checkpoint(advance, repeatable, index, *path, use_reentrant=False)
        else:
            states, action = advance(policy, index, *path)
        moved = controlled & scenario.present[:, index] & scenario.present[:, index + 1]
        if not torch.isfinite(action[moved]).all():
            raise ValueError(f"at step {index} the policy gives an action that is not finite")
        path.append(states)
        actions.append(action)
    return Rollout(torch.stack(path, dim=1), scenario.present, torch.stack(actions, dim=1))


def _make_repeatable(policy: Policy, generator: torch.Generator) -> Policy:
    """Wrap a policy for one step: later calls draw the noise of the first one.

    Later calls leave the generator as it was, even where torch interrupts them because it has
    recomputed all it needs.
    """
    first_state, first_action = generator.get_state(), list[Tensor]()

    def act(scenario: Scenario, path: Float[Tensor, "B t A 4"]) -> Tensor:
        if not first_action:
            action = policy(scenario, path)
            first_action.append(action.detach())
            return action
        state = generator.get_state()
        generator.set_state(first_state)
        try:
            action = policy(scenario, path)
        finally:
            generator.set_state(state)
        tolerance = RECOMPUTATION_TOLERANCE
        if not torch.allclose(action, first_action[0], tolerance, tolerance, equal_nan=True):
            raise ValueError(
                f"computed again at step {path.shape[1] - 1}, the policy gives another action: "
                "give rollout its generator, draw its noise beforehand, or disable checkpointing"
            )
        return action

    return act
