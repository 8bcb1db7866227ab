"""Infractions of agents by name, for simulated scenes and predictions alike."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.rendering.ground import apply_matrix
from geoaim.rendering.scene import Scene
from geoaim.simulation.infractions import (
    detect_collisions,
    detect_offroad,
    detect_red_light_running,
    detect_wrong_way,
)
from geoaim.simulation.overlap import compute_box_corners
from geoaim.simulation.road_rules import RoadRules, move_rules
from geoaim.tracks.agent_types import select_group
from geoaim.tracks.lights import UNKNOWN

MIN_DISTANCE_BETWEEN_RED_LIGHTS_M = 2.0  # closer crossings of one agent are noise of its position


@dataclass(frozen=True, eq=False)
class AgentMotion:
    """How A agents move in S steps of M scenes, of which infractions are judged.

    Attributes:
        poses: (M, A, 1 + S, 3) x, y, heading at the start of the first step and after each one.
        present: (M, A, 1 + S) whether the agent is there; other poses may be NaN.
        sizes: (M, A, 2) length and width, metres.
        vehicles: (M, A) which agents are vehicles.
        stop_lines: (M, L, 2, 2) both ends of each light's line, metres.
        light_states: (M, S, L) states at the start of each step, as in `geoaim.tracks.lights`.
    """

    poses: Float[Tensor, "M A _ 3"]
    present: Bool[Tensor, "M A _"]
    sizes: Float[Tensor, "M A 2"]
    vehicles: Bool[Tensor, "M A"]
    stop_lines: Float[Tensor, "M L 2 2"]
    light_states: Int[Tensor, "M S L"]


Found = tuple[Bool[Tensor, "M A S"], Bool[Tensor, "M A S"]]  # infractions, and what is judged


def detect_infractions(
    scene: Scene, agents: Bool[Tensor, "A"], rules: RoadRules, *, first: int = 1
) -> dict[str, tuple[Bool[Tensor, "A S"], Bool[Tensor, "A S"]]]:
    """Detect infractions of agents of a scene, as `find_infractions` does.

    "off road" is judged only where all corners are on the map, where it has an image.

    Args:
        scene: the recorded or simulated scene.
        agents: (A,) the agents whose infractions are detected; the others can be collided with.
        rules: the road rules, moved to the scene's world; infractions of missing rules are not
            detected.
        first: index of the first of the S steps, at least 1.

    Returns:
        For each name, (A, S) whether an agent commits that infraction, and (A, S) whether it is
        judged.

    Raises:
        ValueError: the pose of a present agent is not finite.
        MapError: the rules are of a world from which moving is not exact.
    """
    vehicles = torch.from_numpy(select_group(scene.types, "vehicle")).to(agents.device)
    poses, sizes = scene.poses[:, first - 1 :], scene.sizes
    motion = AgentMotion(
        poses=poses[None],
        present=scene.present[None, :, first - 1 :],
        sizes=sizes[None],
        vehicles=vehicles[None],
        stop_lines=scene.stop_lines[None],
        light_states=scene.light_states[None, first - 1 : -1],
    )
    found = find_infractions(motion, agents[None], move_rules(rules, scene.world))
    if "off road" in found:
        offroad, known = found["off road"]
        on_map = _find_on_map(scene, poses[:, 1:], sizes[:, None].expand(-1, poses.shape[1] - 1, 2))
        found["off road"] = offroad & on_map, known & on_map
    return {name: (marked[0], judged[0]) for name, (marked, judged) in found.items()}


def find_infractions(
    motion: AgentMotion, agents: Bool[Tensor, "M A"], rules: RoadRules
) -> dict[str, Found]:
    """Find infractions of agents: collisions and contacts of all, the others of vehicles alone.

    Simulated scenes and predictions are judged here alike.

    - "collision": its box overlaps another one, and one of the two is a vehicle's; "collision with
      replay": the other one is none of `agents`.
    - "contact": its box overlaps another one, and neither is a vehicle's.
    - "red light": its front crosses a stop line forwards in a step that starts at red; where a
      light's state is known. A vehicle that stands on the line, and whose recorded position is
      noisy, counts once.
    - "off road": a corner is off the drivable area (`OFFROAD_TOLERANCE_M`); where all corners are
      on the raster of distances.
    - "wrong way": it heads along none of the one-way lanes that it is on; where it is on one.

    Args:
        motion: all agents.
        agents: (M, A) the agents whose infractions are found; the others can be collided with.
        rules: the road rules, in the world of the motion.

    Returns:
        For each name, (M, A, S) whether an agent commits that infraction in a step, and (M, A, S)
        whether it is judged.

    Raises:
        ValueError: the pose of a present agent is not finite.
    """
    after, present = motion.poses[:, :, 1:], motion.present[:, :, 1:]
    sizes = motion.sizes[:, :, None].expand(*present.shape, 2)
    counted = present & agents[..., None]
    vehicles = counted & motion.vehicles[..., None]
    found = _find_overlaps(motion, agents, counted)
    lit = (motion.light_states != UNKNOWN).any(dim=2)[:, None]  # (M, 1, S)
    if lit.any() and vehicles.any():
        ran = _find_red_light_running(motion, vehicles & motion.present[:, :, :-1])
        found["red light"] = _drop_repetitions(ran, after), vehicles & lit
    if rules.drivable is not None:
        found["off road"] = detect_offroad(rules.drivable, after, sizes, vehicles)
    if rules.lanes is not None:
        found["wrong way"] = detect_wrong_way(rules.lanes, after, vehicles)
    return found


def _find_overlaps(
    motion: AgentMotion, agents: Bool[Tensor, "M A"], counted: Bool[Tensor, "M A S"]
) -> dict[str, Found]:
    """Find collisions and contacts, for all steps of all scenes at once."""
    shape, (steps, count) = counted.transpose(1, 2).shape, counted.shape[:0:-1]
    poses, present = (x[:, :, 1:].transpose(1, 2) for x in (motion.poses, motion.present))
    sizes = motion.sizes[:, None].expand(-1, steps, -1, -1)
    flat = poses.flatten(0, 1), sizes.flatten(0, 1), present.flatten(0, 1)
    vehicles = motion.vehicles[:, None].expand(shape).flatten(0, 1)
    others = (~agents)[:, None].expand(shape).flatten(0, 1)
    collisions, contacts = detect_collisions(*flat, vehicles)
    marks = {"collision": collisions}
    if not agents.all():
        marks["collision with replay"] = collisions & others[:, None]
    found = {
        name: (pairs.any(dim=-1).view(-1, steps, count).transpose(1, 2) & counted, counted)
        for name, pairs in {**marks, "contact": contacts}.items()
    }
    contact, _ = found["contact"]
    return {**found, "contact": (contact, counted & ~motion.vehicles[..., None])}


def _find_red_light_running(
    motion: AgentMotion, moved: Bool[Tensor, "M A S"]
) -> Bool[Tensor, "M A S"]:
    """Find crossings of stop lines, for all steps of all scenes at once."""
    steps = moved.shape[2]
    poses = motion.poses.transpose(1, 2)  # (M, 1 + S, A, 3)
    ran = detect_red_light_running(
        poses[:, :-1].flatten(0, 1),
        poses[:, 1:].flatten(0, 1),
        motion.sizes[..., 0].repeat_interleave(steps, dim=0),
        moved.transpose(1, 2).flatten(0, 1),
        motion.stop_lines.repeat_interleave(steps, dim=0),
        motion.light_states.flatten(0, 1),
    )
    return ran.view(-1, steps, moved.shape[1]).transpose(1, 2)


def _drop_repetitions(
    ran: Bool[Tensor, "M A S"], poses: Float[Tensor, "M A S 3"]
) -> Bool[Tensor, "M A S"]:
    """Drop crossings at red that are too close to the agent's last one that was kept."""
    kept = torch.zeros_like(ran)
    last: dict[tuple[int, int], Tensor] = {}
    for scene, agent, step in ran.nonzero().tolist():
        place, key = poses[scene, agent, step, :2], (scene, agent)
        if key not in last or (place - last[key]).norm() > MIN_DISTANCE_BETWEEN_RED_LIGHTS_M:
            kept[scene, agent, step], last[key] = True, place
    return kept


def _find_on_map(
    scene: Scene, poses: Float[Tensor, "A S 3"], sizes: Float[Tensor, "A S 2"]
) -> Bool[Tensor, "A S"]:
    """Mark agents with all corners where the map has an image."""
    ground = scene.ground
    matrix, region = ground.image_from_world[0].to(poses), ground.regions[0].to(poses)
    corners = compute_box_corners(poses.nan_to_num(), sizes)
    pixels = apply_matrix(matrix[:, :2], corners) + matrix[:, 2]
    # the texture's border has no coverage
    column, row = torch.minimum(torch.maximum(pixels, region[:2]), region[2:] - 1).long().unbind(-1)
    return (ground.coverage[0, row, column] > 0).all(dim=-1)
