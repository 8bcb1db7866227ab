"""Episodes: simulate a part of a scene by a policy, and count infractions."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool
from torch import Tensor

from geoaim.base.errors import TracksError
from geoaim.rendering.scene import Scene, find_agent, find_step, slice_scene
from geoaim.simulation import simulator
from geoaim.simulation.idm import make_idm_policy
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules, check_rules
from geoaim.simulation.routes import extract_routes
from geoaim.simulation.scene_infractions import detect_infractions
from geoaim.simulation.simulator import Traffic, constant_turn_rate, constant_velocity
from geoaim.simulation.spawning import rollout_routes
from geoaim.tracks.agent_types import select_group

SIMPLE_POLICIES: Mapping[str, simulator.Policy] = {
    "constant-velocity": constant_velocity,
    "constant-turn-rate": constant_turn_rate,
}
POLICY_NAMES = ("idm", *SIMPLE_POLICIES, "replay")
HISTORY_STEPS = 5  # all agents replay their recordings in the first steps
# vehicles whose speed is ever below this replay the recording: no policy drives backwards
REVERSING_SPEED_MPS = -0.1


@dataclass(frozen=True, eq=False)
class Episode:
    """A simulated scene."""

    scene: Scene  # what happened in the simulation
    controlled: Bool[Tensor, "A"]  # agents that the policy moved
    # shares of the controlled agents' simulated steps with an infraction, by the names of
    # `detect_infractions`; an infraction that could not occur is left out
    rates: Mapping[str, float]
    recorded_rates: Mapping[str, float]  # the same of the recording of the same agents and times


def simulate_scene(  # noqa: PLR0913  (what is simulated, and how)
    scene: Scene,
    policy: str | Traffic,
    *,
    ego: str | None = None,
    start: float | None = None,
    duration: float | None = None,
    rules: RoadRules = NO_ROAD_RULES,
    generator: torch.Generator | None = None,
) -> Episode:
    """Simulate a part of a scene, in which a policy controls one agent or all of them.

    Agents by "idm" enter when there is room for them, and leave at the end of their route.

    Args:
        scene: the recording.
        policy: "idm", "constant-velocity", "constant-turn-rate", "replay", or traffic, such as
            `geoaim.prediction.make_traffic` makes of a model.
        ego: name of the controlled agent; None: all agents that never reverse; of these, "idm"
            controls the vehicles only, and traffic those of its group.
        start: time at which the simulation begins, seconds; None: the scene's first.
        duration: duration of the simulation, seconds, including the first `HISTORY_STEPS` steps;
            None: 6 seconds, or up to the end of the scene.
        rules: the road rules; infractions of missing rules are not counted.
        generator: source of the noise of traffic; None: a new one with the seed 0.

    Returns:
        The simulated scene, and the rates of infractions in it and in its recording.

    Raises:
        ValueError: the policy is unknown, or the time is not within the scene's.
        TracksError: the ego is unknown or absent, no agent can be controlled, or the rules are of
            another place.
    """
    rules = check_rules(scene, rules)
    first, steps = _find_steps(scene, start, duration)
    group = policy.group if isinstance(policy, Traffic) else None
    if policy == "idm" and ego is None:
        group = "vehicle"
    controlled = _select_controlled(scene, first, steps, ego, group)
    given = scene, controlled, first, steps
    if isinstance(policy, Traffic):
        generator = generator or torch.Generator().manual_seed(0)
        simulated = _simulate_traffic(policy, *given, generator)
    else:
        simulated = _simulate_idm(*given) if policy == "idm" else _simulate_policy(policy, *given)
    recorded = slice_scene(scene, slice(first, first + steps))
    rates, recorded_rates = (
        _count_infractions(part, controlled, rules) for part in (simulated, recorded)
    )
    return Episode(simulated, controlled, rates, recorded_rates)


def _find_steps(scene: Scene, start: float | None, duration: float | None) -> tuple[int, int]:
    """Find the first step of a simulation, and its number of steps."""
    begin, end = float(scene.times[0]), float(scene.times[-1])
    start = begin if start is None else start
    first = find_step(scene, start)
    if duration is None:
        duration = min(6.0, end - float(scene.times[first]))
    if not start + duration < end + scene.dt:
        raise ValueError(
            f"the tracks go from {begin:g} to {end:g} s, and {duration:g} seconds from {start:g} s "
            f"on go beyond; simulate {end - start:.4g} seconds or fewer, or start earlier"
        )
    steps = round(duration / scene.dt) + 1
    if steps <= HISTORY_STEPS:
        raise ValueError(
            f"{duration:g} seconds are {steps} steps, and agents replay the first {HISTORY_STEPS}; "
            f"simulate {HISTORY_STEPS * scene.dt:g} seconds or more, or start earlier"
        )
    return first, steps


def _select_controlled(
    scene: Scene, first: int, steps: int, ego: str | None, group: str | None
) -> Bool[Tensor, "A"]:
    """Mark the ego, or all agents (of a group) that never reverse, present in two steps."""
    if ego is not None:
        agent = find_agent(scene, ego)
        if not bool(scene.present[agent, first + HISTORY_STEPS - 1 :][:2].all()):
            raise TracksError(f"agent {ego} is not present at {float(scene.times[first]):g} s")
        if group is not None and not select_group(scene.types, group)[agent]:
            raise TracksError(
                f"agent {ego} is a {scene.types[agent]}, and the policy moves {group}s; give "
                "another ego or policy"
            )
        return torch.arange(len(scene.ids), device=scene.present.device) == agent
    controlled = select_movable(scene, first, steps, group)
    if not controlled.any():
        raise TracksError(
            f"no {group or 'agent'} can be controlled: none that never reverses is present in "
            "these steps; start at another time, or give an ego"
            f"{f' or another policy, as this one moves {group}s alone' if group else ''}"
        )
    return controlled


def select_movable(
    scene: Scene, first: int, steps: int, group: str | None = None
) -> Bool[Tensor, "A"]:
    """Mark the agents that never reverse and are present in two steps after the first ones.

    Args:
        scene: the recording.
        first: index of the first step.
        steps: number of steps, of which `HISTORY_STEPS` are replayed.
        group: a group of agent types; None: all agents.
    """
    present = scene.present[:, first + HISTORY_STEPS - 1 : first + steps]
    reverses = (scene.speeds[:, first:] <= REVERSING_SPEED_MPS).any(dim=1)
    movable = (present[:, :-1] & present[:, 1:]).any(dim=1) & ~reverses
    if group is not None:
        movable &= torch.from_numpy(select_group(scene.types, group)).to(movable.device)
    return movable


def _simulate_traffic(
    traffic: Traffic,
    scene: Scene,
    controlled: Bool[Tensor, "A"],
    first: int,
    steps: int,
    generator: torch.Generator,
) -> Scene:
    """Simulate agents by a policy that is made for this piece."""
    piece = slice_scene(scene, slice(first, first + steps))
    act = traffic.make_policy(piece, controlled, HISTORY_STEPS, generator)
    scenario = simulator.make_scenario(scene, torch.tensor([first]), steps)
    states = simulator.rollout(scenario, act, controlled[None], history=HISTORY_STEPS)
    return simulator.apply_rollout(scene, states[0], first)


def _simulate_policy(
    policy: str, scene: Scene, controlled: Bool[Tensor, "A"], first: int, steps: int
) -> Scene:
    """Simulate agents that are present as recorded."""
    if policy == "replay":
        return slice_scene(scene, slice(first, first + steps))
    if policy not in SIMPLE_POLICIES:
        raise ValueError(f"there is no policy {policy!r}; there are {', '.join(POLICY_NAMES)}")
    scenario = simulator.make_scenario(scene, torch.tensor([first]), steps)
    act = SIMPLE_POLICIES[policy]
    states = simulator.rollout(scenario, act, controlled[None], history=HISTORY_STEPS)
    return simulator.apply_rollout(scene, states[0], first)


def _simulate_idm(scene: Scene, controlled: Bool[Tensor, "A"], first: int, steps: int) -> Scene:
    """Simulate intelligent drivers; routes and desired speeds come from the recording."""
    scenario = simulator.make_scenario(scene, torch.tensor([first]), steps)
    rest = simulator.make_scenario(scene, torch.tensor([first]), len(scene.times) - first)
    routes, desired_speeds = extract_routes(rest), rest.states[..., 3].amax(dim=2)
    given = routes, desired_speeds, scenario.sizes, controlled[None]
    act = make_idm_policy(*given, scene.stop_lines, scene.light_states[None, first:])
    states, present = rollout_routes(scenario, act, controlled[None], routes, history=HISTORY_STEPS)
    return simulator.apply_rollout(scene, states[0], first, present[0])


def _count_infractions(
    scene: Scene, controlled: Bool[Tensor, "A"], rules: RoadRules
) -> dict[str, float]:
    """Compute rates of collisions of all controlled agents, and of infractions of the vehicles."""
    found = detect_infractions(scene, controlled, rules, first=HISTORY_STEPS)
    return {
        name: float((infractions & chances).sum() / chances.sum())
        for name, (infractions, chances) in found.items()
        if chances.any()
    }
