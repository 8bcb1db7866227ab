"""Infractions of the agents of a scene, by name."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.simulation.ground import apply_matrix
from geoaim.simulation.infractions import (
    detect_collisions,
    detect_offroad,
    detect_red_light_running,
    detect_wrong_way,
)
from geoaim.simulation.overlap import compute_box_corners
from geoaim.simulation.road_rules import RoadRules
from geoaim.simulation.scene import Scene
from geoaim.tracks.agent_types import select_group
from geoaim.tracks.lights import UNKNOWN

MIN_DISTANCE_BETWEEN_RED_LIGHTS_M = 2.0  # closer crossings of one agent are noise of its position


def detect_infractions(
    scene: Scene, agents: Bool[Tensor, "A"], rules: RoadRules, *, first: int = 1
) -> dict[str, tuple[Bool[Tensor, "S A"], Bool[Tensor, "S A"]]]:
    """Detect infractions of agents: collisions and contacts of all, the others of vehicles alone.

    - "collision": its box overlaps another one, and one of the two is a vehicle's; "collision with
      replay": the other one is none of `agents`.
    - "contact": its box overlaps another one, and neither is a vehicle's.
    - "red light": its front crosses a stop line forwards in a step that starts at red; where a
      light's state is known. A vehicle that stands on the line, and whose recorded position is
      noisy, counts once.
    - "off road": a corner is off the drivable area (`OFFROAD_TOLERANCE_M`); where all corners are
      on the map, where it has an image, and on the raster of distances.
    - "wrong way": it heads along none of the one-way lanes that it is on; where it is on one.

    Args:
        scene: the recorded or simulated scene.
        agents: (A,) the agents whose infractions are detected; the others can be collided with.
        rules: the road rules; infractions of missing rules are not detected.
        first: index of the first of the S steps, at least 1.

    Returns:
        For each name, (S, A) whether an agent commits that infraction, and (S, A) whether it is
        judged.

    Raises:
        ValueError: the pose of a present agent is not finite.
    """
    poses = scene.poses.transpose(0, 1)[first - 1 :]  # (1 + S, A, 3)
    present = scene.present.t()[first - 1 :]
    last_poses, poses = poses[:-1], poses[1:]
    last_present, present = present[:-1], present[1:]
    sizes = scene.sizes.expand(len(poses), -1, -1)
    counted = present & agents  # (S, A)
    types = torch.from_numpy(select_group(scene.types, "vehicle")).to(counted.device)
    vehicles = counted & types
    collisions, contacts = detect_collisions(poses, sizes, present, types)
    found = {"collision": (collisions.any(dim=-1) & counted, counted)}
    if not agents.all():
        found["collision with replay"] = (collisions & ~agents).any(dim=-1) & counted, counted
    found["contact"] = contacts.any(dim=-1) & counted, counted & ~types
    states = scene.light_states[first - 1 : -1]
    lit = (states != UNKNOWN).any(dim=1, keepdim=True)
    if lit.any():
        moved = last_present & vehicles
        lights = scene.stop_lines, states
        ran = detect_red_light_running(last_poses, poses, sizes[..., 0], moved, *lights)
        found["red light"] = _drop_repetitions(ran, poses), vehicles & lit
    if rules.drivable is not None:
        offroad, known = detect_offroad(rules.drivable, poses, sizes, vehicles)
        found["off road"] = offroad, known & _find_on_map(scene, poses, sizes)
    if rules.lanes is not None:
        found["wrong way"] = detect_wrong_way(rules.lanes, poses, vehicles)
    return found


def _drop_repetitions(
    ran: Bool[Tensor, "S A"], poses: Float[Tensor, "S A 3"]
) -> Bool[Tensor, "S A"]:
    """Drop crossings at red that are too close to the agent's last one that was kept."""
    kept = torch.zeros_like(ran)
    last: dict[int, Tensor] = {}
    for step, agent in ran.nonzero().tolist():
        place = poses[step, agent, :2]
        if agent not in last or (place - last[agent]).norm() > MIN_DISTANCE_BETWEEN_RED_LIGHTS_M:
            kept[step, agent], last[agent] = True, place
    return kept


def _find_on_map(
    scene: Scene, poses: Float[Tensor, "S A 3"], sizes: Float[Tensor, "S A 2"]
) -> Bool[Tensor, "S A"]:
    """Mark agents with all corners where the map has an image."""
    ground = scene.ground
    matrix, region = ground.image_from_world[0].to(poses), ground.regions[0].to(poses)
    corners = compute_box_corners(poses.nan_to_num(), sizes)
    pixels = apply_matrix(matrix[:, :2], corners) + matrix[:, 2]
    # the texture's border has no coverage
    column, row = torch.minimum(torch.maximum(pixels, region[:2]), region[2:] - 1).long().unbind(-1)
    return (ground.coverage[0, row, column] > 0).all(dim=-1)
