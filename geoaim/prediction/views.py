"""What agents see: the ground, who is around, and lights, around each of them, heading up."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from geoaim.lights import GREEN, RED, YELLOW
from geoaim.prediction.segments import PERSON, VEHICLE, Segments
from geoaim.simulation.birdview import Boxes, render_layers
from geoaim.simulation.ground import Ground, View
from geoaim.simulation.lines import BAR, light_layers

UNLIKE = 0.4  # distance of colours, each 0 to 1, from which on it is another surface
CHANNELS = 7  # ground, vehicles, people, lights that stop, lights that let go


@dataclass(frozen=True)
class Sight(View):
    """A view of models.

    Attributes:
        bar: metres that a light's bar is wide, on its stop line.
    """

    bar: float = BAR


@dataclass(frozen=True, eq=False)
class Egos:
    """Who is moved, one after the other: numbers of segments, and of agents in them."""

    segment: Int[Tensor, "E"]
    agent: Int[Tensor, "E"]


def egos_of(segments: Segments) -> Egos:
    """All who are controlled."""
    return Egos(*segments.controlled.nonzero().unbind(1))


def egos_see(
    view: Sight,
    ground: Ground,
    segments: Segments,
    egos: Egos,
    states: Float[Tensor, "S A 4"],
    number: int,
) -> Float[Tensor, "E 7 H W"]:
    """Views of all egos at a step; the ego, always in the middle, is not drawn.

    Args:
        view: size and resolution, and how wide lights are.
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
    layers += light_layers(lines, lights, [(RED, YELLOW), (GREEN,)], width=view.bar)
    return render_layers(view, cameras, ground, layers)


def unlike_underfoot(views: Float[Tensor, "E 7 H W"]) -> Float[Tensor, "E 1 H W"]:
    """How unlike the ground is to that under the ego, 0 to 1.

    Who walks on slabs mostly stays on them, whatever slabs look like elsewhere: likeness can be
    learnt from few places, where colours need many.

    >>> views = torch.zeros(1, 7, 4, 4)
    >>> views[:, :3, 0] = 0.1  # a row that is a little brighter
    >>> unlike_underfoot(views)[0, 0, :, 0].round(decimals=2)
    tensor([0.4300, 0.0000, 0.0000, 0.0000])
    """
    ground = views[:, :3]
    rows, columns = (slice((side - 1) // 2, side // 2 + 1) for side in ground.shape[2:])
    here = ground[:, :, rows, columns].mean(dim=(2, 3), keepdim=True)
    apart = (ground - here).square().sum(dim=1, keepdim=True)
    smooth = (apart + 1e-8).sqrt() - 1e-4  # gradients stay finite where colours are equal
    return (smooth / UNLIKE).clamp(max=1)
