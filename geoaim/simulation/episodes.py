"""One simulation of a scene, and what went wrong in it: what `geoaim simulate` does."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from shapely import MultiPolygon
from torch import Tensor

from geoaim.errors import TracksError
from geoaim.hdmap.drivable import find_drivable_area
from geoaim.hdmap.lanelet2 import HDMap
from geoaim.lights import UNKNOWN
from geoaim.simulation.ground import bounds_of, in_world
from geoaim.simulation.infractions import (
    Drivable,
    Lanes,
    collisions,
    offroad_distance,
    on_lanes,
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
from geoaim.simulation.scene import (
    Scene,
    agent_number,
    check_touches,
    drivable_of,
    lanes_of,
    step_at_time,
    step_seconds,
)
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
        rates: the shares of controlled agents and simulated steps with something wrong, by name;
            what could not be counted is not among them.
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
    start: float | None = None,
    seconds: float = 6.0,
    rules: Rules = NO_RULES,
) -> Episode:
    """Let one agent, or all who never reverse, drive by one of `POLICIES` among those who replay.

    Args:
        scene: where and among whom.
        policy: its name.
        ego: name of who is controlled; if left out all but those who reverse at some time.
        start: seconds of the scene at which the simulation begins; its first if left out.
        seconds: how long it lasts, the first steps, which all replay, included.
        rules: what is off the road and the wrong way; what it is silent on is not counted.

    Raises:
        ValueError: there is no such policy, or that time is not in the scene.
        TracksError: the ego is not among the agents, nobody to be controlled is there, or the
            rules are of another place.
    """
    check_place(scene, rules)
    first, steps = _steps(scene, start, seconds)
    recording = record(scene, torch.tensor([first]), steps)
    rest = record(scene, torch.tensor([first]), len(scene.times) - first)
    controlled = _controlled(scene, first, steps, ego)
    drive = _policy(policy, rest, scene.stop_lines, scene.light_states[None, first:])
    found = rollout(recording, drive, controlled[None], observed=OBSERVED)
    after = simulated(scene, found, first)
    return Episode(after, recording, controlled, _rates(after, recording, controlled, rules))


def rules_of(hdmap: HDMap | None, area: MultiPolygon | None = None) -> Rules:
    """The rules of an HD map, or of an area drawn by hand, in whose place or beside it."""
    if area is None and hdmap is not None:
        area = find_drivable_area(hdmap)
    drivable = None if area is None else drivable_of(area)
    return Rules(drivable, None if hdmap is None else lanes_of(hdmap))


def check_place(scene: Scene, rules: Rules) -> None:
    """Refuse rules of another place, which would be broken always or never.

    Raises:
        TracksError: they do not touch the map.
    """
    low, high = bounds_of(scene.ground).cpu().numpy()
    if rules.lanes is not None and len(rules.lanes.places):
        check_touches("lane", rules.lanes.places.double().cpu().numpy(), low, high)
    if rules.drivable is not None:
        cells = (rules.drivable.metres < 0).nonzero().flip(1) + 0.5
        places = in_world(rules.drivable.image_from_world, cells).cpu().numpy()
        check_touches("drivable area", places, low, high)


def _steps(scene: Scene, start: float | None, seconds: float) -> tuple[int, int]:
    """The first step of a simulation, and how many they are."""
    begin, end, step = float(scene.times[0]), float(scene.times[-1]), step_seconds(scene)
    start = begin if start is None else start
    first = step_at_time(scene, start)
    if not start + seconds < end + step:
        raise ValueError(
            f"{seconds:g} seconds from start {start:g} s on are not all in the scene, from "
            f"{begin:g} to {end:g} s"
        )
    steps = round(seconds / step) + 1
    if steps <= OBSERVED:
        raise ValueError(
            f"{seconds:g} seconds are {steps} steps, and the first {OBSERVED} are replayed; give "
            f"seconds of {OBSERVED * step:g} or more"
        )
    return first, steps


def _controlled(scene: Scene, first: int, steps: int, ego: str | None) -> Bool[Tensor, "A"]:
    """The ego, or all who never reverse, of those whom a policy can move in these steps."""
    there = scene.present[:, first + OBSERVED - 1 : first + steps]
    moved = there[:, :-1] & there[:, 1:]
    if ego is None:
        controlled = moved.any(dim=1) & ~(scene.speeds[:, first:] <= REVERSE).any(dim=1)
        if not controlled.any():
            raise TracksError("in these steps nobody is there who never reverses; begin elsewhere")
        return controlled
    agent = agent_number(scene, ego)
    if not bool(moved[agent, 0]):
        raise TracksError(f"agent {ego} is not there at {float(scene.times[first]):g} s")
    return torch.arange(len(moved), device=moved.device) == agent


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
    """Collisions of all; the rest of vehicles, which roads, lights and directions are for.

    What was wrong, and who could do it: nothing is said where nobody could.
    """
    before, poses = (scene.poses.transpose(0, 1)[k:] for k in (OBSERVED - 1, OBSERVED))
    was, there = (scene.present.t()[k:] for k in (OBSERVED - 1, OBSERVED))
    sizes = scene.sizes.expand(len(poses), -1, -1)
    wheels = ~recording.on_foot[0]
    mine = there & controlled
    driven = mine & wheels
    counts = {"collision": (collisions(poses, sizes, there) > 0, mine)}
    states = scene.light_states[OBSERVED:]
    told = (states != UNKNOWN).any(dim=1)
    if told.any():
        crossing = driven & was[:-1]
        ran = ran_red(before[:-1], poses, sizes[..., 0], crossing, scene.stop_lines, states)
        counts["red light"] = ran, driven & told[:, None]
    if rules.drivable is not None:
        counts["off road"] = offroad_distance(rules.drivable, poses, sizes, driven) > 0, driven
    if rules.lanes is not None and on_lanes(rules.lanes, poses, driven).any():
        counts["wrong way"] = wrong_way(rules.lanes, poses, driven), driven
    return {name: float(rate(wrong, who)) for name, (wrong, who) in counts.items() if who.any()}
