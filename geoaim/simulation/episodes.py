"""Episodes: simulate a part of a scene by a policy, and count infractions."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.agent_types import select_group
from geoaim.errors import TracksError
from geoaim.lights import UNKNOWN
from geoaim.simulation import simulator
from geoaim.simulation.infractions import detect_offroad, detect_red_light_running, detect_wrong_way
from geoaim.simulation.overlap import box_iou
from geoaim.simulation.policies import (
    constant_turn_rate,
    constant_velocity,
    make_idm_policy,
    replay,
)
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules, check_rules
from geoaim.simulation.scene import Scene, find_agent, find_step

SIMPLE_POLICIES: Mapping[str, simulator.Policy] = {
    "constant-velocity": constant_velocity,
    "constant-turn-rate": constant_turn_rate,
    "replay": replay,
}
POLICY_NAMES = ("idm", *SIMPLE_POLICIES)
HISTORY_STEPS = 5  # in which all agents replay
# vehicles whose speed is ever below this replay the recording: no policy drives backwards
REVERSING_SPEED_MPS = -0.1


@dataclass(frozen=True, eq=False)
class Episode:
    """A simulated scene."""

    scene: Scene  # what happened in the simulation
    controlled: Bool[Tensor, "A"]  # agents that the policy moved
    # share of the controlled agents' simulated steps with an infraction: "collision", "red light",
    # "off road", "wrong way"; an infraction that could not occur is left out
    rates: Mapping[str, float]


def simulate_scene(
    scene: Scene,
    policy: str,
    *,
    ego: str | None = None,
    start: float | None = None,
    duration: float = 6.0,
    rules: RoadRules = NO_ROAD_RULES,
) -> Episode:
    """Simulate a part of a scene, in which a policy controls one agent or all of them.

    Args:
        scene: the recording.
        policy: "idm", "constant-velocity", "constant-turn-rate" or "replay".
        ego: name of the controlled agent; None: all agents that never reverse.
        start: time at which the simulation begins, seconds; None: the scene's first.
        duration: of the simulation, seconds, including the first `HISTORY_STEPS` steps.
        rules: of the road; infractions of missing rules are not counted.

    Returns:
        The simulated scene and its rates of infractions.

    Raises:
        ValueError: the policy is unknown, or the time is not within the scene's.
        TracksError: the ego is unknown or absent, no agent can be controlled, or the rules are of
            another place.
    """
    check_rules(scene, rules)
    first, steps = _find_steps(scene, start, duration)
    scenario = simulator.make_scenario(scene, torch.tensor([first]), steps)
    rest = simulator.make_scenario(scene, torch.tensor([first]), len(scene.times) - first)
    controlled = _select_controlled(scene, first, steps, ego)
    act = _make_policy(policy, rest, scene.stop_lines, scene.light_states[None, first:])
    states = simulator.rollout(scenario, act, controlled[None], history=HISTORY_STEPS)
    simulated = simulator.apply_rollout(scene, states[0], first)
    rates = _count_infractions(simulated, controlled, rules)
    return Episode(simulated, controlled, rates)


def _find_steps(scene: Scene, start: float | None, duration: float) -> tuple[int, int]:
    """Find the first step of a simulation, and its number of steps."""
    begin, end = float(scene.times[0]), float(scene.times[-1])
    start = begin if start is None else start
    first = find_step(scene, start)
    if not start + duration < end + scene.dt:
        raise ValueError(
            f"{duration:g} seconds from start {start:g} s on are not all in the scene, from "
            f"{begin:g} to {end:g} s"
        )
    steps = round(duration / scene.dt) + 1
    if steps <= HISTORY_STEPS:
        raise ValueError(
            f"{duration:g} seconds are {steps} steps, and agents replay the first "
            f"{HISTORY_STEPS}; simulate {HISTORY_STEPS * scene.dt:g} seconds or more"
        )
    return first, steps


def _select_controlled(scene: Scene, first: int, steps: int, ego: str | None) -> Bool[Tensor, "A"]:
    """Mark the ego, or all agents that never reverse, if present in two simulated steps."""
    present = scene.present[:, first + HISTORY_STEPS - 1 : first + steps]
    moves = present[:, :-1] & present[:, 1:]  # (A, S)
    if ego is None:
        reverses = (scene.speeds[:, first:] <= REVERSING_SPEED_MPS).any(dim=1)
        controlled = moves.any(dim=1) & ~reverses
        if not controlled.any():
            raise TracksError(
                "no agent can be controlled: none that never reverses is present in these steps; "
                "start at another time"
            )
        return controlled
    agent = find_agent(scene, ego)
    if not bool(moves[agent, 0]):
        raise TracksError(f"agent {ego} is not present at {float(scene.times[first]):g} s")
    return torch.arange(len(moves), device=moves.device) == agent


def _make_policy(
    name: str, rest: simulator.Scenario, lines: Float[Tensor, "L 2 2"], states: Int[Tensor, "1 T L"]
) -> simulator.Policy:
    """Make the policy of a name; routes and desired speeds come from the rest of the recording."""
    if name == "idm":
        desired_speeds = rest.states[..., 3].amax(dim=1)
        return make_idm_policy(simulator.extract_routes(rest), desired_speeds, lines, states)
    if name not in SIMPLE_POLICIES:
        raise ValueError(f"there is no policy {name!r}; there are {', '.join(POLICY_NAMES)}")
    return SIMPLE_POLICIES[name]


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


def detect_infractions(
    scene: Scene, agents: Bool[Tensor, "A"], rules: RoadRules, *, first: int = 1
) -> dict[str, tuple[Bool[Tensor, "S A"], Bool[Tensor, "S A"]]]:
    """Detect collisions of agents, and infractions of those that are vehicles.

    Args:
        scene: what happened.
        agents: (A,) which are looked at; they collide with all.
        rules: of the road; infractions of missing rules are not looked for.
        first: index of the first step, at least 1; the S steps are those from it on.

    Returns:
        (S, A) infractions of the agents, and (S, A) their chances to commit one, for each of
        "collision", "red light", "off road" and "wrong way" that can be looked for.
    """
    poses = scene.poses.transpose(0, 1)[first - 1 :]  # (1 + S, A, 3)
    present = scene.present.t()[first - 1 :]
    last_poses, poses = poses[:-1], poses[1:]
    last_present, present = present[:-1], present[1:]
    sizes = scene.sizes.expand(len(poses), -1, -1)
    counted = present & agents  # (S, A)
    vehicles = counted & torch.from_numpy(select_group(scene.types, "vehicle")).to(counted.device)
    collides = (box_iou(poses, sizes, present) > 0).any(dim=-1)
    found = {"collision": (collides & counted, counted)}
    states = scene.light_states[first:]
    lit = (states != UNKNOWN).any(dim=1, keepdim=True)
    if lit.any():
        moved = last_present & vehicles
        lights = scene.stop_lines, states
        ran = detect_red_light_running(last_poses, poses, sizes[..., 0], moved, *lights)
        found["red light"] = ran, vehicles & lit
    if rules.drivable is not None:
        found["off road"] = detect_offroad(rules.drivable, poses, sizes, vehicles), vehicles
    if rules.lanes is not None:
        wrong, on_lane = detect_wrong_way(rules.lanes, poses, vehicles)
        if on_lane.any():
            found["wrong way"] = wrong, vehicles
    return found
