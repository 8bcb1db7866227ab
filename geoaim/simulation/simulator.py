"""A differentiable simulator: states in, states out, for a batch of recorded pieces of a scene.

Controlled agents move by the actions of a policy; all others replay the recording. Every agent
enters and leaves at the recorded times, and enters in the recorded state.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.rendering.scene import Scene, slice_scene
from geoaim.simulation.input_checks import check_shape, check_traffic
from geoaim.simulation.kinematics import bicycle, unicycle
from geoaim.tracks.agent_types import select_group


@dataclass(frozen=True, eq=False)
class Scenario:
    """Recorded states and sizes of agents in B segments of a scene, T steps each.

    Raises:
        ValueError: a tensor has another shape than the states require.
    """

    states: Float[Tensor, "B A T 4"]  # x, y, heading, speed; 0 while absent
    present: Bool[Tensor, "B A T"]
    sizes: Float[Tensor, "B A 2"]  # length and width, metres
    pedestrian: Bool[Tensor, "B A"]  # agents that move by the unicycle instead of the bicycle model
    dt: float  # time between two steps, seconds

    def __post_init__(self) -> None:
        check_traffic(
            self.states,
            present=(self.present, "BNT"),
            sizes=(self.sizes, ("B", "N", 2)),
            pedestrian=(self.pedestrian, "BN"),
        )

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> "Scenario":
        """Move the tensors to a device, or convert states and sizes to a dtype."""
        return replace(
            self,
            states=self.states.to(device=device, dtype=dtype),
            present=self.present.to(device=device),
            sizes=self.sizes.to(device=device, dtype=dtype),
            pedestrian=self.pedestrian.to(device=device),
        )


# maps a scenario and the states so far, up to step t, to the actions of all agents
Policy = Callable[[Scenario, Float[Tensor, "B A t 4"]], Float[Tensor, "B A 2"]]


@dataclass(frozen=True)
class Traffic:
    """A policy that is made anew for each piece of a scene, as that of a model that reads its map.

    Attributes:
        group: the agents that it moves: "vehicle", "pedestrian" or "cyclist".
        make_policy: makes the policy of a piece (A agents), of a mask of those that it moves, the
            number of first steps in which all agents replay, and a source of noise.
    """

    group: str
    make_policy: Callable[[Scene, Bool[Tensor, "A"], int, torch.Generator], Policy]


def make_scenario(scene: Scene, starts: Int[Tensor, "B"], steps: int) -> Scenario:
    """Cut pieces of equal length out of a scene.

    Args:
        scene: a scene whose steps are evenly spaced.
        starts: (B,) first step of each piece.
        steps: number of steps of each piece.

    Returns:
        The B pieces as a batch.

    Raises:
        ValueError: a piece reaches beyond the scene, or the steps are not evenly spaced.
    """
    if len(starts) == 0 or int(starts.min()) < 0 or int(starts.max()) + steps > len(scene.times):
        raise ValueError(
            f"pieces of {steps} steps from steps {starts.tolist()} on reach beyond the scene's "
            f"steps 0 to {len(scene.times) - 1}"
        )
    check_even_steps(scene, steps)
    index = starts[:, None] + torch.arange(steps, device=starts.device)  # (B, T)
    present = scene.present[:, index].transpose(0, 1)  # (B, A, T)
    states = scene.states[:, index].transpose(0, 1)  # (B, A, T, 4)
    states = torch.where(present[..., None], states, 0.0)
    pedestrian = torch.from_numpy(select_group(scene.types, "pedestrian")).to(starts.device)
    count = len(starts)
    sizes = scene.sizes.expand(count, -1, -1)
    return Scenario(states, present, sizes, pedestrian.expand(count, -1), scene.dt)


def check_even_steps(scene: Scene, steps: int) -> None:
    """Raise ValueError for less than two steps, and for a scene with steps of different lengths."""
    if steps < 2 or (scene.times.diff() - scene.dt).abs().max() > 0.01 * scene.dt:
        raise ValueError("two steps or more are needed, evenly spaced; resample the tracks")


def collate_scenarios(scenarios: Sequence[Scenario]) -> Scenario:
    """Collate pieces of recordings of several places, padded to the most agents.

    Args:
        scenarios: the scenarios, all with the same number of steps and the same dt.

    Returns:
        The pieces as one batch; agents that a piece lacks are absent.

    Raises:
        ValueError: there are none, or steps or dt differ.
    """
    kinds = {(scenario.states.shape[2], scenario.dt) for scenario in scenarios}
    if len(kinds) != 1:
        stated = ", ".join(f"{steps} steps of {dt:g} s" for steps, dt in sorted(kinds)) or "none"
        raise ValueError(f"scenarios of {stated}; one or more with the same steps are needed")
    most = max(scenario.states.shape[1] for scenario in scenarios)
    parts = []
    for scenario in scenarios:
        more = most - scenario.states.shape[1]
        parts.append(
            (
                F.pad(scenario.states, (0, 0, 0, 0, 0, more)),
                F.pad(scenario.present, (0, 0, 0, more)),
                F.pad(scenario.sizes, (0, 0, 0, more), value=1.0),
                F.pad(scenario.pedestrian, (0, more)),
            )
        )
    states, present, sizes, pedestrian = map(torch.cat, zip(*parts, strict=True))
    return Scenario(states, present, sizes, pedestrian, scenarios[0].dt)


def apply_rollout(
    scene: Scene,
    states: Float[Tensor, "A T 4"],
    start: int,
    present: Bool[Tensor, "A T"] | None = None,
) -> Scene:
    """Make a scene of what `rollout` simulated from a step on, to render it or write its tracks."""
    part = slice_scene(scene, slice(start, start + states.shape[1]))
    if present is not None:
        part = replace(part, present=present)
    states = torch.where(part.present[..., None], states.detach(), torch.nan)
    return replace(
        part, poses=states[..., :3], speeds=states[..., 3], observed=states, observed_sigma=None
    )


def step(
    scenario: Scenario,
    index: int,
    states: Float[Tensor, "B A 4"],
    actions: Float[Tensor, "B A 2"],
    controlled: Bool[Tensor, "B A"],
) -> Float[Tensor, "B A 4"]:
    """Simulate one step: controlled agents act while recorded as present, others replay.

    Args:
        scenario: the recording.
        index: index of the step at which `states` hold.
        states: (B, A, 4) x, y, heading, speed at that step.
        actions: (B, A, 2) acceleration, m/s², and steering angle, radians; of pedestrians turn
            rate, rad/s.
        controlled: (B, A) agents that the actions move.

    Returns:
        (B, A, 4) states at the next step.
    """
    moved = controlled & scenario.present[:, :, index] & scenario.present[:, :, index + 1]
    drives = moved & ~scenario.pedestrian
    # padded agents may have length 0
    safe_lengths = torch.where(drives, scenario.sizes[..., 0], 1.0)
    steering = torch.where(drives[..., None], actions, 0.0)  # a turn rate is not a steering angle
    driven = bicycle.step(states, steering, safe_lengths, scenario.dt)
    safe_actions = torch.where(moved[..., None], actions, 0.0)
    walked = unicycle.step(states, safe_actions, safe_lengths, scenario.dt)
    acted = torch.where(drives[..., None], driven, walked)
    return torch.where(moved[..., None], acted, scenario.states[:, :, index + 1])


def invert_step(
    scenario: Scenario, states: Float[Tensor, "B A 4"], next_states: Float[Tensor, "B A 4"]
) -> Float[Tensor, "B A 2"]:
    """Find the actions by which `step` reaches the speeds and headings of the next states."""
    given = states, next_states, scenario.sizes[..., 0], scenario.dt
    walks = scenario.pedestrian[..., None]
    return torch.where(walks, unicycle.inverse(*given), bicycle.inverse(*given))


def rollout(
    scenario: Scenario, policy: Policy, controlled: Bool[Tensor, "B A"], *, history: int = 1
) -> Float[Tensor, "B A T 4"]:
    """Simulate a scenario to its end; differentiable back to its first state.

    Args:
        scenario: the recording.
        policy: gives the actions of all agents; it must not read later steps of the scenario.
        controlled: (B, A) agents that the policy moves.
        history: number of first steps, 1 or more, in which all agents replay.

    Returns:
        (B, A, T, 4) x, y, heading, speed of all agents at all steps.

    Raises:
        ValueError: no step is left to simulate, or an action is not finite or of another shape.
    """
    total = scenario.states.shape[2]
    if not 1 <= history < total:
        raise ValueError(
            f"history is {history}, but the scenario has {total} steps; give 1 to {total - 1}, so "
            "that a step remains to simulate"
        )
    check_shape("controlled", controlled, scenario.sizes.shape[:2])
    path = list(scenario.states[:, :, :history].unbind(2))
    for index in range(history - 1, total - 1):
        actions = policy(scenario, torch.stack(path, dim=2))
        check_shape("actions of the policy", actions, (*controlled.shape, 2))
        moved = controlled & scenario.present[:, :, index] & scenario.present[:, :, index + 1]
        if not torch.isfinite(actions[moved]).all():
            raise ValueError(f"at step {index} the policy gives an action that is not finite")
        path.append(step(scenario, index, path[-1], actions, controlled))
    return torch.stack(path, dim=2)


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
