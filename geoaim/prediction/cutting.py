"""Cutting scenes into segments."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.agent_types import AGENT_GROUPS
from geoaim.errors import TracksError
from geoaim.prediction.segments import PEDESTRIAN, VEHICLE, Segments, concat
from geoaim.simulation.kinematics import bicycle
from geoaim.simulation.scene import Scene, slice_scene

MAX_NEIGHBOURS = 24  # other agents that a segment keeps
MIN_TRAVEL_M = 1.0  # agents that move less in a whole recording are parked


def cut_segments(
    scene: Scene, kind: str, *, steps: int, stride: int, joint: bool = False
) -> Segments:
    """Cut a scene into segments whose controlled agents are of one kind.

    Args:
        scene: with steps at even intervals.
        kind: "vehicle" or "pedestrian"; other agents replay.
        steps: of each segment.
        stride: steps from one segment's start to the next.
        joint: one segment for each start, in which all agents of the kind that are present at all
            steps are controlled; otherwise one segment for each of these agents, which alone is
            controlled, with its nearest neighbours.

    Returns:
        Segments of moving agents.

    Raises:
        TracksError: no moving agent of the kind is present for long enough.
        ValueError: the scene's steps are not at even intervals.
    """
    if len(scene.times) < 2:
        raise TracksError(f"the scene has {len(scene.times)} steps; a segment needs {steps}")
    dt = scene.dt
    if (scene.times.diff() - dt).abs().max() > 0.01 * dt:
        raise ValueError("the scene's steps are not at even intervals; resample the tracks")
    complete = _find_complete(scene, kind, steps, stride)
    if not complete.any():
        agents = select_kind(scene, kind) & (_compute_travel(scene) > MIN_TRAVEL_M)
        longest = int(scene.present[agents].sum(dim=1).max()) if agents.any() else 0
        raise TracksError(
            f"no moving {kind} is present for {steps} steps of {dt:g} s; the longest track has "
            f"{longest}"
        )
    choose_agents = _choose_all if joint else _choose_neighbours
    parts = []
    for number in complete.any(dim=0).nonzero()[:, 0].tolist():
        piece = slice_scene(scene, slice(number * stride, number * stride + steps))
        parts.append(_cut(piece, *choose_agents(piece, complete[:, number]), round(dt, 6)))
    return concat(parts)


def cut_future(scene: Scene, kind: str, dt: float, *, steps: slice, start: int) -> Segments:
    """Cut one segment that controls all agents of a kind that are present at the step `start`.

    Args:
        scene: with steps at even intervals; beyond its end other agents go straight on and lights
            stay as they are.
        kind: "vehicle" or "pedestrian".
        dt: time between steps, s, which a scene of one step does not tell.
        steps: from the first step of the segment to after its last, which may be beyond the scene.
        start: the last observed step, an index of the scene's steps.

    Returns:
        One segment with all agents of the scene.

    Raises:
        TracksError: no agent of the kind is present at that step.
    """
    controlled = select_kind(scene, kind) & scene.present[:, start]
    if not controlled.any():
        raise TracksError(f"no {kind} is present at {float(scene.times[start]):g} s")
    extended = _extend(scene, steps.stop - len(scene.times), dt)
    agents = torch.arange(len(scene.ids), device=controlled.device)[None]
    segment = _cut(slice_scene(extended, steps), agents, controlled[None], dt)
    present = segment.present.clone()
    present[:, start + 1 - steps.start :, controlled] = True
    return replace(segment, present=present)


def select_kind(scene: Scene, kind: str) -> Bool[Tensor, "N"]:
    """Mark the agents of a kind ("vehicle", "pedestrian" or "cyclist"), by their types."""
    return torch.tensor([name in AGENT_GROUPS[kind] for name in scene.types]).to(
        scene.present.device
    )


def _find_complete(scene: Scene, kind: str, steps: int, stride: int) -> Bool[Tensor, "N _"]:
    """For each start, the moving agents of a kind that are present at all steps of the segment."""
    moving = select_kind(scene, kind) & (_compute_travel(scene) > MIN_TRAVEL_M)
    long_enough = steps <= len(scene.times)
    present = scene.present if long_enough else scene.present.new_zeros(len(moving), steps)
    return present.unfold(1, steps, stride).all(dim=2) & moving[:, None]


def _choose_all(
    piece: Scene, complete: Bool[Tensor, "N"]
) -> tuple[Int[Tensor, "1 n"], Bool[Tensor, "1 n"]]:
    """All agents that are present at some step, in one segment; and which are controlled."""
    agents = piece.present.any(dim=1).nonzero()[:, 0]
    return agents[None], complete[agents][None]


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
    """Segments of all steps of a piece of a scene, each with its own agents."""
    states = torch.where(piece.present[..., None], piece.states, 0.0)
    count = len(agents)
    return Segments(
        states=states[agents].transpose(1, 2),
        present=piece.present[agents].transpose(1, 2),
        sizes=piece.sizes[agents],
        layers=torch.where(select_kind(piece, "vehicle"), VEHICLE, PEDESTRIAN)[agents],
        controlled=controlled,
        stop_lines=piece.stop_lines.expand(count, -1, -1, -1),
        light_states=piece.light_states.long().expand(count, -1, -1),
        dt=dt,
    )


def _extend(scene: Scene, steps: int, dt: float) -> Scene:
    """Extend a scene beyond its end: agents keep speed and heading, and lights stay."""
    if steps <= 0:
        return scene
    states, no_action = [scene.states[:, -1]], scene.poses.new_zeros(len(scene.ids), 2)
    for _ in range(steps):
        states.append(bicycle.step(states[-1], no_action, scene.sizes[:, 0], dt))
    later = torch.stack(states[1:], dim=1)
    times = scene.times[-1] + torch.arange(1, steps + 1).to(scene.times) * dt
    lights = scene.light_states[-1:].expand(steps, -1)
    return replace(
        scene,
        times=torch.cat([scene.times, times]),
        poses=torch.cat([scene.poses, later[..., :3]], dim=1),
        speeds=torch.cat([scene.speeds, later[..., 3]], dim=1),
        present=torch.cat([scene.present, scene.present[:, -1:].expand(-1, steps)], dim=1),
        light_states=torch.cat([scene.light_states, lights], dim=0),
    )


def _compute_travel(scene: Scene) -> Float[Tensor, "N"]:
    """The diagonal of the box in which an agent stays, metres."""
    present = scene.present[..., None]
    positions = scene.poses[..., :2]
    low = torch.where(present, positions, torch.inf).amin(dim=1)
    high = torch.where(present, positions, -torch.inf).amax(dim=1)
    return (high - low).norm(dim=1)
