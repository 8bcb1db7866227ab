"""A scene's agents, trails and lights at some steps, as boxes that the renderer paints."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.rendering.boxes import OrientedBoxes
from geoaim.rendering.lines import make_path_boxes, make_stop_line_boxes, make_stop_line_layers
from geoaim.rendering.scene import Scene
from geoaim.tracks.agent_types import AGENT_GROUPS, OTHER, find_group, get_colour
from geoaim.tracks.lights import STATES

EGO_COLOUR = (1.0, 0.35, 0.0)


def make_agent_boxes(
    scene: Scene, steps: Int[Tensor, "B"], ego: Int[Tensor, "B"] | None = None
) -> OrientedBoxes:
    """Make boxes of all agents, coloured by type, with white triangles at their fronts.

    Args:
        scene: the scene whose agents are drawn.
        steps: (B,) index of each view's step.
        ego: (B,) row of the agent in each view that has the ego's colour; None: no agent has it.

    Returns:
        (B, N) boxes.
    """
    colours = get_agent_colours(scene).repeat(len(steps), 1, 1)
    if ego is not None:
        colours[torch.arange(len(steps)), ego] = colours.new_tensor(EGO_COLOUR)
    heading_colours = torch.ones_like(colours)
    poses, present = _get_poses(scene, steps)
    return OrientedBoxes(poses, scene.sizes, colours, present, heading_colours)


def make_light_boxes(scene: Scene, steps: Int[Tensor, "B"]) -> OrientedBoxes:
    """Make a bar on each stop line in the colour of its light at each of B steps."""
    return make_stop_line_boxes(scene.stop_lines, scene.light_states[steps])


def make_trail_boxes(scene: Scene, steps: Int[Tensor, "B"], *, duration: float) -> OrientedBoxes:
    """Make the trails of the agents that are present at each step.

    Args:
        scene: the scene whose agents are drawn; its steps are evenly spaced.
        steps: (B,) index of the step of each view, at which trails end.
        duration: duration of the trails, seconds.

    Returns:
        (B, N S) boxes of the S segments of each trail, coloured by type.
    """
    count = round(duration / scene.dt)
    offsets = torch.arange(-count, 1, device=scene.poses.device)
    trail_steps = steps[:, None].to(scene.poses.device) + offsets  # (B, S)
    poses, present = _get_poses(scene, trail_steps.clamp_min(0).flatten())
    shape = len(steps), len(offsets), len(scene.ids)
    present = present.view(shape)
    present = present & present[:, -1:] & (trail_steps >= 0)[..., None]
    points = poses[..., :2].reshape(*shape, 2).transpose(1, 2)  # (B, N, S, 2)
    colours, present = get_agent_colours(scene), present.transpose(1, 2)
    return make_path_boxes(points, colours, width=0.4, present=present)


def make_layers(
    scene: Scene, steps: Int[Tensor, "B"], ego: Int[Tensor, "B"]
) -> dict[str, OrientedBoxes]:
    """Make named layers for `render_layers`.

    Args:
        scene: the scene whose agents and lights are drawn.
        steps: (B,) index of each view's step.
        ego: (B,) row of the ego in each view.

    Returns:
        (B, N) boxes with the keys ego, vehicle, pedestrian, cyclist and other; (B, L) with the keys
        green, yellow and red.
    """
    boxes = make_agent_boxes(scene, steps, ego)
    present = _get_poses(scene, steps)[1]
    is_ego = torch.zeros_like(present)
    is_ego[torch.arange(len(steps)), ego] = True
    groups = [find_group(agent_type) for agent_type in scene.types]
    masks = {"ego": is_ego}
    for name in (*AGENT_GROUPS, OTHER):
        masks[name] = ~is_ego & is_ego.new_tensor([group == name for group in groups])
    layers = {name: replace(boxes, present=present & mask) for name, mask in masks.items()}
    states = [(state,) for state in range(len(STATES))]
    bars = make_stop_line_layers(scene.stop_lines, scene.light_states[steps], states)
    return layers | dict(zip(STATES, bars, strict=True))


def get_agent_colours(scene: Scene) -> Float[Tensor, "N 3"]:
    """Get the colour (RGB, 0 to 1) of each agent's type."""
    return scene.sizes.new_tensor([get_colour(kind) for kind in scene.types])


def _get_poses(
    scene: Scene, steps: Int[Tensor, "B"]
) -> tuple[Float[Tensor, "B N 3"], Bool[Tensor, "B N"]]:
    return scene.poses[:, steps].transpose(0, 1), scene.present[:, steps].t()
