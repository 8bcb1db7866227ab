"""A simulator: states go in, states come out, for a batch of scenes at once, with gradients.

Agents that are controlled move by the actions of a policy; all others replay what was recorded.
Presence follows the recording: an agent enters where it was recorded to enter, and leaves when it
was recorded to leave.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from geoaim.simulation.kinematics import step_agents
from geoaim.simulation.scene import Scene, states_of, step_seconds

ON_FOOT = ("pedestrian",)
APART = 1.0  # m between points of a route at least: who waits shakes by less
SAME = 1e-3  # by which actions may differ when they are computed again


@dataclass(frozen=True, eq=False)
class Recording:
    """What happened in a batch of scenes, T steps of them.

    Attributes:
        states: (B, T, A, 4) x, y, heading, speed; 0 while absent.
        present: (B, T, A).
        sizes: (B, A, 2) length and width, metres.
        on_foot: (B, A) who moves as a unicycle instead of a bicycle.
        seconds: of a step.
    """

    states: Float[Tensor, "B T A 4"]
    present: Bool[Tensor, "B T A"]
    sizes: Float[Tensor, "B A 2"]
    on_foot: Bool[Tensor, "B A"]
    seconds: float


@dataclass(frozen=True, eq=False)
class Rollout:
    """What happened in a simulation: states, who was present, and the actions of all steps."""

    states: Float[Tensor, "B T A 4"]
    present: Bool[Tensor, "B T A"]
    actions: Float[Tensor, "B S A 2"]


Policy = Callable[[Recording, Float[Tensor, "B t A 4"]], Float[Tensor, "B A 2"]]


def record(scene: Scene, starts: Int[Tensor, "B"], steps: int) -> Recording:
    """Cut as many steps out of a scene from each start on.

    Raises:
        ValueError: a start leaves too few steps, or the steps are not evenly spaced.
    """
    if len(starts) == 0 or int(starts.min()) < 0 or int(starts.max()) + steps > len(scene.times):
        raise ValueError(
            f"{steps} steps from {starts.tolist()} are not all among the scene's {len(scene.times)}"
        )
    seconds = step_seconds(scene)
    if steps < 2 or (scene.times.diff() - seconds).abs().max() > 0.01 * seconds:
        raise ValueError("two steps or more are needed, evenly spaced; resample the tracks")
    when = starts[:, None] + torch.arange(steps, device=starts.device)
    present = scene.present[:, when].permute(1, 2, 0)
    states = states_of(scene)[:, when].permute(1, 2, 0, 3)
    states = torch.where(present[..., None], states, 0.0)
    feet = torch.tensor([kind in ON_FOOT for kind in scene.types], device=starts.device)
    count = len(starts)
    sizes = scene.sizes.expand(count, -1, -1)
    return Recording(states, present, sizes, feet.expand(count, -1), seconds)


def simulated(scene: Scene, found: Rollout, start: int, number: int = 0) -> Scene:
    """One of the simulations as a scene, to be drawn or written; it began at that step."""
    steps = slice(start, start + found.states.shape[1])
    present = found.present[number].t()
    states = found.states[number].detach().transpose(0, 1)
    states = torch.where(present[..., None], states, torch.nan)
    return replace(
        scene,
        times=scene.times[steps],
        poses=states[..., :3],
        speeds=states[..., 3],
        present=present,
        light_states=scene.light_states[steps],
    )


def routes_of(recording: Recording) -> Float[Tensor, "B A P 2"]:
    """The ways that agents were recorded to go, points of `APART` or more; then straight on.

    Who never goes as far has a way straight ahead.
    """
    states = recording.states.transpose(1, 2)
    keep = _apart(states[..., :2], recording.present.transpose(1, 2))
    order = keep.int().argsort(dim=2, descending=True, stable=True)
    count = keep.sum(dim=2, keepdim=True)
    slot = torch.arange(int(count.max()) + 1, device=keep.device)
    kept = order.gather(2, slot.minimum(count - 1))
    route = states.gather(2, kept[..., None].expand(*kept.shape, 4))
    before = route.gather(2, (count - 2).clamp_min(0)[..., None].expand(-1, -1, 1, 4))
    way = route[:, :, -1:, :2] - before[..., :2]
    heading = torch.stack([before[..., 2].cos(), before[..., 2].sin()], dim=-1)
    ahead = torch.where(count[..., None] > 1, way, heading)
    ahead = ahead / ahead.norm(dim=-1, keepdim=True)
    return route[..., :2] + ahead * APART * (slot - count + 1).clamp_min(0)[..., None]


def _apart(places: Float[Tensor, "B A T 2"], there: Bool[Tensor, "B A T"]) -> Bool[Tensor, "B A T"]:
    """The first place of each one, and then every one that is `APART` from the last one."""
    first = there.int().argmax(dim=2, keepdim=True)
    last = places.gather(2, first[..., None].expand(-1, -1, 1, 2))[:, :, 0]
    keep = torch.zeros_like(there).scatter(2, first, True)
    for number, here in enumerate(places.unbind(2)):
        far = there[..., number] & ((here - last).norm(dim=-1) >= APART)
        last = torch.where(far[..., None], here, last)
        keep[..., number] |= far
    return keep


def step(
    recording: Recording,
    number: int,
    states: Float[Tensor, "B A 4"],
    actions: Float[Tensor, "B A 2"],
    controlled: Bool[Tensor, "B A"],
) -> Float[Tensor, "B A 4"]:
    """The states after a step: controlled agents by their actions, others as recorded."""
    both = recording.present[:, number] & recording.present[:, number + 1]
    mine = (controlled & both)[..., None]
    safe = torch.where(mine, actions, 0.0)
    lengths = torch.where(mine[..., 0], recording.sizes[..., 0], 1.0)  # padding may have none
    moved = step_agents(states, safe, lengths, recording.on_foot, recording.seconds)
    return torch.where(mine, moved, recording.states[:, number + 1])


def rollout(
    recording: Recording,
    policy: Policy,
    controlled: Bool[Tensor, "B A"],
    *,
    observed: int = 1,
    lean: bool = False,
    generator: torch.Generator | None = None,
) -> Rollout:
    """Simulate the steps of a recording.

    Args:
        recording: whom to replay, and where everybody starts.
        policy: from the recording's constants and the states so far, (B, t, A, 4), to the actions
            of all agents; it must not look at later steps of the recording.
        controlled: whom the policy moves.
        observed: so many first steps are replayed by all.
        lean: keep states alone for the gradient and compute each step again on the way back.
        generator: from which the policy draws its noise; a lean way back draws the same again.

    Raises:
        ValueError: nothing is left to simulate, or an action is not finite; on a lean way back,
            that the policy acts otherwise than before.
    """
    total = recording.states.shape[1]
    if not 1 <= observed < total:
        raise ValueError(f"{observed} of {total} steps are observed; from 1 to {total - 1} can be")
    path = list(recording.states[:, :observed].unbind(1))
    actions = []

    def one(act: Policy, number: int, *path: Tensor) -> tuple[Tensor, Tensor]:
        action = act(recording, torch.stack(path, dim=1))
        return step(recording, number, path[-1], action, controlled), action

    for number in range(observed - 1, total - 1):
        if lean:
            same = _same_again(policy, generator or torch.default_generator)
            after, action = checkpoint(one, same, number, *path, use_reentrant=False)
        else:
            after, action = one(policy, number, *path)
        moved = controlled & recording.present[:, number] & recording.present[:, number + 1]
        if not torch.isfinite(action[moved]).all():
            raise ValueError(f"at step {number} the policy gives an action that is not finite")
        path.append(after)
        actions.append(action)
    return Rollout(torch.stack(path, dim=1), recording.present, torch.stack(actions, dim=1))


def _same_again(policy: Policy, generator: torch.Generator) -> Policy:
    """The policy in one step: when it is asked again, its noise is the same.

    The generator is left as it was, also where torch breaks off because it has all that it needs.
    """
    start, told = generator.get_state(), list[Tensor]()

    def again(recording: Recording, path: Float[Tensor, "B t A 4"]) -> Tensor:
        if not told:
            action = policy(recording, path)
            told.append(action.detach())
            return action
        now = generator.get_state()
        generator.set_state(start)
        try:
            action = policy(recording, path)
        finally:
            generator.set_state(now)
        if not torch.allclose(action, told[0], rtol=SAME, atol=SAME, equal_nan=True):
            raise ValueError(
                f"asked again at step {path.shape[1] - 1} the policy acts otherwise: give rollout "
                "its generator, or draw its noise beforehand, or let lean be"
            )
        return action

    return again
