"""What agents see: the ground, who is around, and lights, around each of them, heading up."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from geoaim.lights import GREEN, RED, UNKNOWN, YELLOW
from geoaim.prediction.segments import PERSON, VEHICLE, Segments
from geoaim.simulation.birdview import Boxes, render_layers
from geoaim.simulation.ground import Ground, View
from geoaim.simulation.lines import light_boxes

CHANNELS = 7  # ground, vehicles, people, lights that stop, lights that let go


@dataclass(frozen=True, eq=False)
class Egos:
    """Who is moved, one after the other: numbers of segments, and of agents in them."""

    segment: Int[Tensor, "E"]
    agent: Int[Tensor, "E"]


def egos_of(segments: Segments) -> Egos:
    """All who are controlled."""
    return Egos(*segments.controlled.nonzero().unbind(1))


def egos_see(
    view: View,
    ground: Ground,
    segments: Segments,
    egos: Egos,
    states: Float[Tensor, "S A 4"],
    number: int,
) -> Float[Tensor, "E 7 H W"]:
    """Views of all egos at a step; the ego, always in the middle, is not drawn.

    Args:
        view: size and resolution.
        ground: what lies below.
        segments: sizes, lights, and who is there at the step.
        egos: whose views.
        states: of everybody at the step.
        number: of the step.
    """
    poses = states[egos.segment, :, :3]
    mine = torch.arange(states.shape[1], device=states.device) == egos.agent[:, None]
    there = segments.present[egos.segment, number] & ~mine
    cameras = states[egos.segment, egos.agent, :3]
    planes, sizes = segments.planes[egos.segment], segments.sizes[egos.segment]
    colours = sizes.new_ones(1, 3).expand(states.shape[1], 3)
    layers = [
        Boxes(poses, sizes, colours, there & (planes == plane), colours)
        for plane in (VEHICLE, PERSON)
    ]
    lines, lights = segments.lines[egos.segment], segments.lights[egos.segment, number]
    stops = (lights == RED) | (lights == YELLOW)
    for_lights = [
        light_boxes(lines, torch.where(shown, lights, UNKNOWN))
        for shown in (stops, lights == GREEN)
    ]
    return render_layers(view, cameras, ground, [*layers, *for_lights])
