"""What is on a scene's map at some steps, as boxes that the renderer paints."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.lights import STATES
from geoaim.simulation.birdview import Boxes
from geoaim.simulation.lines import light_boxes, light_layers, path_boxes
from geoaim.simulation.scene import Scene, step_seconds

EGO = (1.0, 0.35, 0.0)
POINTER = (1.0, 1.0, 1.0)
OTHER = (0.55, 0.2, 0.75)
COLOURS: Mapping[str, tuple[float, float, float]] = {
    "car": (0.1, 0.35, 0.9),
    "van": (0.1, 0.35, 0.9),
    "truck": (0.05, 0.2, 0.6),
    "bus": (0.05, 0.2, 0.6),
    "pedestrian": (1.0, 0.85, 0.0),
    "cyclist": (0.0, 0.85, 0.85),
}
KINDS: Mapping[str, tuple[str, ...]] = {
    "vehicle": ("car", "van", "truck", "bus"),
    "pedestrian": ("pedestrian",),
    "cyclist": ("cyclist",),
}
TRAIL = 0.4  # m that a trail is wide


def agents_at(scene: Scene, steps: Int[Tensor, "B"], egos: Int[Tensor, "B"]) -> Boxes:
    """All agents at each of B steps in their types' colours, one of them in the ego's."""
    colours = usual_colours(scene).repeat(len(steps), 1, 1)
    colours[torch.arange(len(steps)), egos] = colours.new_tensor(EGO)
    noses = colours.new_tensor(POINTER).expand_as(colours)
    poses, present = _there(scene, steps)
    return Boxes(poses, scene.sizes, colours, present, noses)


def lights_at(scene: Scene, steps: Int[Tensor, "B"]) -> Boxes:
    """A bar on each stop line in the colour of its light at each of B steps."""
    return light_boxes(scene.stop_lines, scene.light_states[steps])


def trails_at(scene: Scene, steps: Int[Tensor, "B"], *, seconds: float) -> Boxes:
    """Where the agents of each of B steps have been within so many seconds before."""
    count = round(seconds / step_seconds(scene))
    back = torch.arange(-count, 1, device=scene.poses.device)
    before = steps[:, None].to(scene.poses.device) + back
    poses, present = _there(scene, before.clamp_min(0).flatten())
    shape = len(steps), len(back), len(scene.ids)
    present = present.view(shape)
    present = present & present[:, -1:] & (before >= 0)[..., None]
    points = poses[..., :2].reshape(*shape, 2).transpose(1, 2)
    return path_boxes(points, usual_colours(scene), width=TRAIL, present=present.transpose(1, 2))


def layers_at(scene: Scene, steps: Int[Tensor, "B"], egos: Int[Tensor, "B"]) -> dict[str, Boxes]:
    """For `render_layers`: the ego, each of `KINDS`, all others, and lights of each state."""
    everyone, states = agents_at(scene, steps, egos), scene.light_states[steps]
    present = _there(scene, steps)[1]
    ego = torch.zeros_like(present)
    ego[torch.arange(len(steps)), egos] = True
    kind_of = {kind: name for name, kinds in KINDS.items() for kind in kinds}
    names = [kind_of.get(kind, "other") for kind in scene.types]
    masks = {"ego": ego}
    for name in (*KINDS, "other"):
        masks[name] = ~ego & ego.new_tensor([other == name for other in names])
    layers = {name: replace(everyone, present=present & mask) for name, mask in masks.items()}
    groups = [(number,) for number in range(len(STATES))]
    return layers | dict(zip(STATES, light_layers(scene.stop_lines, states, groups), strict=True))


def usual_colours(scene: Scene) -> Float[Tensor, "N 3"]:
    """The colour of each agent by its type."""
    return scene.sizes.new_tensor([COLOURS.get(kind, OTHER) for kind in scene.types])


def _there(
    scene: Scene, steps: Int[Tensor, "B"]
) -> tuple[Float[Tensor, "B N 3"], Bool[Tensor, "B N"]]:
    """Where agents are at steps, and whether they are there."""
    return scene.poses[:, steps].transpose(0, 1), scene.present[:, steps].t()
