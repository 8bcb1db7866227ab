"""One simulation of a scene, and what went wrong in it: what `geoaim simulate` does."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from shapely import MultiPolygon
from torch import Tensor

from geoaim.errors import TracksError
from geoaim.mapping.drivable import drivable_area
from geoaim.mapping.hdmap import HDMap
from geoaim.simulation.infractions import (
    Drivable,
    Lanes,
    collisions,
    offroad_distance,
    ran_red,
    rate,
    wrong_way,
)
from geoaim.simulation.policies import (
    constant_turn_rate,
    constant_velocity,
    intelligent_driver,
    replay,
)
from geoaim.simulation.scene import Scene, agent_number, drivable_of, lanes_of, step_seconds
from geoaim.simulation.simulator import Policy, Recording, record, rollout, routes_of, simulated

PLAIN: Mapping[str, Policy] = {
    "constant-velocity": constant_velocity,
    "constant-turn-rate": constant_turn_rate,
    "replay": replay,
}
POLICIES = ("idm", *PLAIN)
OBSERVED = 5  # steps that are replayed by all before policies act
REVERSE = -0.1  # m/s


@dataclass(frozen=True, eq=False)
class Rules:
    """What a map says: where one may drive, and which way; None where it says nothing."""

    drivable: Drivable | None = None
    lanes: Lanes | None = None


NO_RULES = Rules()


@dataclass(frozen=True, eq=False)
class Episode:
    """A simulated scene.

    Attributes:
        scene: what happened.
        recording: what had been recorded.
        controlled: (A,) whom the policy moved.
        rates: the shares of controlled agents and simulated steps with something wrong, by name.
    """

    scene: Scene
    recording: Recording
    controlled: Bool[Tensor, "A"]
    rates: Mapping[str, float]


def simulate_scene(
    scene: Scene,
    policy: str,
    *,
    ego: str | None = None,
    start: float = 0.0,
    seconds: float = 6.0,
    rules: Rules = NO_RULES,
) -> Episode:
    """Let one agent, or all who never reverse, drive by one of `POLICIES` among those who replay.

    Args:
        scene: where and among whom.
        policy: its name.
        ego: name of who is controlled; if left out all but those who reverse at some time.
        start: seconds of the scene at which the simulation begins.
        seconds: how long it lasts, the first steps, which all replay, included.
        rules: what is off the road and the wrong way; what it is silent on is not counted.

    Raises:
        ValueError: there is no such policy, or that time is not in the scene.
        TracksError: the ego is not among the agents, or not there at the start.
    """
    first = int((scene.times - start).abs().argmin())
    steps = round(seconds / step_seconds(scene)) + 1
    recording = record(scene, torch.tensor([first]), steps)
    rest = record(scene, torch.tensor([first]), len(scene.times) - first)
    controlled = (rest.states[0, ..., 3] > REVERSE).all(dim=0)
    if ego is not None:
        agent = agent_number(scene, ego)
        if not bool(recording.present[0, OBSERVED - 1, agent]):
            raise TracksError(f"agent {ego} is not there at {start:g} s")
        controlled = torch.zeros_like(controlled)
        controlled[agent] = True
    drive = _policy(policy, rest, scene.stop_lines, scene.light_states[None, first:])
    found = rollout(recording, drive, controlled[None], observed=OBSERVED)
    after = simulated(scene, found, first)
    return Episode(after, recording, controlled, _rates(after, recording, controlled, rules))


def rules_of(hdmap: HDMap | None, area: MultiPolygon | None = None) -> Rules:
    """The rules of an HD map, or of an area drawn by hand, in whose place or beside it."""
    if area is None and hdmap is not None:
        area = drivable_area(hdmap)
    drivable = None if area is None else drivable_of(area)
    return Rules(drivable, None if hdmap is None else lanes_of(hdmap))


def _policy(
    name: str, rest: Recording, lines: Float[Tensor, "L 2 2"], states: Int[Tensor, "1 T L"]
) -> Policy:
    """The policy of that name; the rest of the scene tells routes and wanted speeds."""
    if name == "idm":
        top = rest.states[..., 3].amax(dim=1)
        return intelligent_driver(routes_of(rest), top, lines, states)
    if name not in PLAIN:
        raise ValueError(f"there is no policy {name!r}; there are {', '.join(POLICIES)}")
    return PLAIN[name]


def _rates(
    scene: Scene, recording: Recording, controlled: Bool[Tensor, "A"], rules: Rules
) -> dict[str, float]:
    """Collisions of all; the rest of vehicles, which roads, lights and directions are for."""
    before, poses = (scene.poses.transpose(0, 1)[k:] for k in (OBSERVED - 1, OBSERVED))
    was, there = (scene.present.t()[k:] for k in (OBSERVED - 1, OBSERVED))
    sizes = scene.sizes.expand(len(poses), -1, -1)
    wheels = ~recording.on_foot[0]
    mine = there & controlled
    driven = mine & wheels
    rates = {"collision": rate(collisions(poses, sizes, there) > 0, mine)}
    if len(scene.stop_lines):
        lengths, states = sizes[..., 0], scene.light_states[OBSERVED:]
        ran = ran_red(before[:-1], poses, lengths, driven & was[:-1], scene.stop_lines, states)
        rates["red light"] = rate(ran, driven)
    if rules.drivable is not None:
        off = offroad_distance(rules.drivable, poses, sizes, driven) > 0
        rates["off road"] = rate(off, driven)
    if rules.lanes is not None:
        rates["wrong way"] = rate(wrong_way(rules.lanes, poses, driven), driven)
    return {name: float(share) for name, share in rates.items()}
