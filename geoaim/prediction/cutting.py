"""Cut scenes into segments."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.base.errors import TracksError
from geoaim.prediction.segments import PEDESTRIAN, VEHICLE, Segments, concat
from geoaim.prediction.sureness import describe_left_out, list_left_out, mark_sure
from geoaim.rendering.scene import Scene, slice_scene
from geoaim.simulation.kinematics import bicycle
from geoaim.tracks.agent_types import select_group

MAX_NEIGHBOURS = 24  # other agents that a segment keeps
MIN_TRAVEL_M = 1.0  # agents that move less in a whole recording are parked


def cut_segments(
    scene: Scene, group: str, *, steps: int, stride: int, joint: bool = False, parked: bool = False
) -> Segments:
    """Cut a scene into segments whose controlled agents are of one group.

    Args:
        scene: a scene whose steps are evenly spaced.
        group: "vehicle", "pedestrian" or "cyclist"; other agents replay.
        steps: number of steps of each segment.
        stride: steps from one segment's start to the next.
        joint: one segment for each start at which an agent of the group is present at all steps. In
            it all agents of the group are controlled, each while it is there. Otherwise one segment
            for each agent that is present at all steps, which alone is controlled, with its nearest
            neighbours.
        parked: whether to control the agents that move by less than `MIN_TRAVEL_M` in the whole
            scene, instead of all others.

    Returns:
        Segments of moving agents, or of parked ones.

    Raises:
        TracksError: no such agent of the group is present for long enough.
        ValueError: the scene's steps are not at even intervals.
    """
    if len(scene.times) < 2:
        raise TracksError(f"the scene has {len(scene.times)} steps; a segment needs {steps}")
    dt = scene.dt
    if (scene.times.diff() - dt).abs().max() > 0.01 * dt:
        raise ValueError("the scene's steps are not at even intervals; resample the tracks")
    scene = _keep_observed(scene)
    agents = mask_agents(scene, group) & ((_compute_travel(scene) > MIN_TRAVEL_M) ^ parked)
    longest = _measure_longest(scene.present[agents])
    if longest < steps:
        raise TracksError(
            f"no {'parked' if parked else 'moving'} {group} is there for {steps * dt:g} s at a "
            f"time; the longest is there for {longest * dt:g} s, of the {len(scene.times) * dt:g} "
            "s that were looked at"
        )
    complete = _find_complete(scene, agents, steps, stride)
    while not complete.any():  # the longest stretch lies between two starts
        stride = max(1, stride // 2)
        complete = _find_complete(scene, agents, steps, stride)
    parts = []
    for number in complete.any(dim=0).nonzero()[:, 0].tolist():
        piece = slice_scene(scene, slice(number * stride, number * stride + steps))
        chosen = (
            _choose_all(piece, agents) if joint else _choose_neighbours(piece, complete[:, number])
        )
        parts.append(_cut(piece, *chosen, round(dt, 6)))
    return concat(parts)


def cut_scene(scene: Scene, group: str) -> Segments:
    """Cut one segment of all steps of a scene, which controls all agents of a group.

    Each is controlled while it is there, as `ITRAPolicy` needs it to drive the traffic of a scene.

    Args:
        scene: a scene whose steps are evenly spaced.
        group: "vehicle", "pedestrian" or "cyclist"; other agents replay.

    Returns:
        The segment; its agents are those that are present at some step, in the scene's order.
    """
    scene = _keep_observed(scene)
    return _cut(scene, *_choose_all(scene, mask_agents(scene, group)), round(scene.dt, 6))


def cut_simulation(scene: Scene, controlled: Bool[Tensor, "N"]) -> Segments:
    """Cut one segment of all steps and agents of a scene, in which some agents are simulated.

    Agents enter in their recorded states, which need not be known from the past alone.
    """
    agents = torch.arange(len(scene.ids), device=controlled.device)[None]
    whole = replace(scene, observed=scene.states, observed_sigma=None)
    return _cut(whole, agents, controlled[None], round(scene.dt, 6))


def cut_future(scene: Scene, group: str, dt: float, *, steps: slice, start: int) -> Segments:
    """Cut one segment that controls all agents of a group that are present at the step `start`.

    Args:
        scene: with steps at even intervals. What agents do after `start` is not used: they keep
            speed and heading. Beyond the scene's end lights keep their states.
        group: "vehicle", "pedestrian" or "cyclist".
        dt: time between steps, s; needed because a scene of one step has none.
        steps: half-open slice of the segment's steps, as indices of the scene's; it may end beyond
            the scene.
        start: the last observed step, an index of the scene's steps.

    Returns:
        One segment with all agents of the scene; those that are present at `start` are present at
        all later steps. Those that `mark_sure` leaves out move straight on.

    Raises:
        TracksError: no agent of the group is present at that step, and surely known.
    """
    controlled = mask_agents(scene, group) & mark_sure(scene)[:, start]
    if not controlled.any():
        left = list_left_out(scene, group, start)
        text = f"no {group} is present at {float(scene.times[start]):g} s"
        raise TracksError(f"{text} and surely known: {describe_left_out(left)}" if left else text)
    scene = _keep_observed(scene, unless=~controlled)
    agents = torch.arange(len(scene.ids), device=controlled.device)[None]
    past = _cut(slice_scene(scene, slice(steps.start, start + 1)), agents, controlled[None], dt)
    lights = scene.light_states.long()[steps]
    beyond = max(0, steps.stop - len(scene.times))
    lights = torch.cat([lights, lights[-1:].expand(beyond, -1)])
    return _extend(past, steps.stop - start - 1, lights[None])


def mask_agents(scene: Scene, group: str) -> Bool[Tensor, "N"]:
    """Make a mask of the agents of a group ("vehicle", "pedestrian" or "cyclist")."""
    return torch.from_numpy(select_group(scene.types, group)).to(scene.present.device)


def _keep_observed(scene: Scene, unless: Bool[Tensor, "N"] | None = None) -> Scene:
    """Count agents as present only where their states are surely known from the past alone.

    Those of `unless` are not predicted, and stand in the way of others where they are known at all.
    """
    present = mark_sure(scene)
    if unless is not None:
        known = scene.present & torch.isfinite(scene.observed[..., :3]).all(dim=2)
        present |= known & unless[:, None]
    return replace(scene, present=present)


def _measure_longest(present: Bool[Tensor, "n T"]) -> int:
    """The most steps in a row at which one of some agents is there."""
    row = longest = torch.zeros(len(present), dtype=torch.long, device=present.device)
    for there in present.unbind(1):
        row = torch.where(there, row + 1, 0)
        longest = torch.maximum(longest, row)
    return int(longest.max()) if len(present) else 0


def _find_complete(
    scene: Scene, agents: Bool[Tensor, "N"], steps: int, stride: int
) -> Bool[Tensor, "N _"]:
    """For each start, those of some agents that are present at all steps of the segment."""
    long_enough = steps <= len(scene.times)
    present = scene.present if long_enough else scene.present.new_zeros(len(agents), steps)
    return present.unfold(1, steps, stride).all(dim=2) & agents[:, None]


def _choose_all(
    piece: Scene, controlled: Bool[Tensor, "N"]
) -> tuple[Int[Tensor, "1 n"], Bool[Tensor, "1 n"]]:
    """All agents that are present at some step, in one segment; and which are controlled."""
    agents = piece.present.any(dim=1).nonzero()[:, 0]
    return agents[None], controlled[agents][None]


def _choose_neighbours(
    piece: Scene, complete: Bool[Tensor, "N"]
) -> tuple[Int[Tensor, "B n"], Bool[Tensor, "B n"]]:
    """Each complete agent with its nearest neighbours, in a segment of its own.

    Nearest at any step: neighbours replay, and those that come near later have to be drawn too.
    """
    controlled = complete.nonzero()[:, 0]
    positions = piece.poses[..., :2]
    distances = (positions[controlled, None] - positions).norm(dim=-1)  # (B, N, T)
    distances = torch.where(piece.present, distances, torch.inf).amin(dim=2)
    distances[torch.arange(len(controlled), device=controlled.device), controlled] = -1.0
    agents = distances.argsort(dim=1)[:, : MAX_NEIGHBOURS + 1]
    return agents, agents == controlled[:, None]


def _cut(
    piece: Scene, agents: Int[Tensor, "B n"], controlled: Bool[Tensor, "B n"], dt: float
) -> Segments:
    """Segments of all steps of a piece of a scene, each with its own agents, as observed."""
    # whose sense is not known has no speed, and stands in the way of others
    states = torch.where(piece.present[..., None], piece.observed, 0.0).nan_to_num()
    count = len(agents)
    return Segments(
        states=states[agents],
        present=piece.present[agents],
        sizes=piece.sizes[agents],
        layers=torch.where(mask_agents(piece, "vehicle"), VEHICLE, PEDESTRIAN)[agents],
        controlled=controlled,
        places=torch.zeros(count, dtype=torch.long, device=states.device),
        stop_lines=piece.stop_lines.expand(count, -1, -1, -1),
        light_states=piece.light_states.long().expand(count, -1, -1),
        dt=dt,
        times=piece.times[:1].expand(count),
        worlds=() if piece.world is None else (piece.world,),
        ids=tuple(tuple(piece.ids[k] for k in row) for row in agents.tolist()),
    )


def _extend(past: Segments, steps: int, light_states: Int[Tensor, "B T L"]) -> Segments:
    """Extend segments by some steps, in which agents keep speed and heading."""
    states, no_action = list(past.states.unbind(2)), torch.zeros_like(past.states[:, :, 0, :2])
    for _ in range(steps):
        states.append(bicycle.step(states[-1], no_action, past.sizes[..., 0], past.dt))
    present = torch.cat([past.present, past.present[:, :, -1:].expand(-1, -1, steps)], dim=2)
    return replace(
        past, states=torch.stack(states, dim=2), present=present, light_states=light_states
    )


def _compute_travel(scene: Scene) -> Float[Tensor, "N"]:
    """The diagonal of the bounding box of an agent's positions, metres."""
    present = scene.present[..., None]
    positions = scene.poses[..., :2]
    low = torch.where(present, positions, torch.inf).amin(dim=1)
    high = torch.where(present, positions, -torch.inf).amax(dim=1)
    return (high - low).norm(dim=1)
