"""Observations: bird's-eye views of the map, agents and lights around each controlled agent."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from geoaim.prediction.segments import PEDESTRIAN, VEHICLE, Segments
from geoaim.rendering.birdview import render_layers
from geoaim.rendering.boxes import OrientedBoxes
from geoaim.rendering.ground import Ground, View
from geoaim.rendering.lines import LIGHT_BAR_WIDTH_M, make_stop_line_layers
from geoaim.tracks.lights import GREEN, RED, YELLOW

# channels are 0 to 1; a surface whose colour differs by more is another one
MAX_COLOUR_DISTANCE = 0.4
CHANNELS = 7  # ground (3), vehicles, pedestrians, red and yellow lights, green lights


@dataclass(frozen=True)
class ObservationView(View):
    """The bird's-eye view around an agent that a model observes."""

    light_width: float = LIGHT_BAR_WIDTH_M  # width of a light's bar on its stop line, metres


@dataclass(frozen=True, eq=False)
class Controlled:
    """Index of the E agents that a model controls."""

    segment: Int[Tensor, "E"]  # row of the segment
    agent: Int[Tensor, "E"]  # column of the agent in it
    # columns of the agents that its view may show, then -1; None: all
    seen: Int[Tensor, "E n"] | None = None

    @property
    def index(self) -> tuple[Tensor, Tensor]:
        """Row and column of each agent."""
        return self.segment, self.agent


def index_controlled(segments: Segments) -> Controlled:
    """List the segment and the column of every controlled agent, segment by segment."""
    return Controlled(*segments.controlled.nonzero().unbind(1))


def render_observation(
    view: ObservationView,
    ground: Ground,
    segments: Segments,
    controlled: Controlled,
    states: Float[Tensor, "B N 4"],
    step: int,
) -> Float[Tensor, "E 7 H W"]:
    """Render the view of each controlled agent, heading up; the agent itself is not drawn.

    Args:
        view: size, resolution and width of lights.
        ground: the map, or the maps of all places.
        segments: sizes, presence and lights of all agents.
        controlled: the E agents whose views to render.
        states: (B, N, 4) x, y, heading, speed of all agents at the step.
        step: index of the step.

    Returns:
        A view of each of the E controlled agents, in 7 channels between 0 and 1: ground (RGB),
        vehicles, pedestrians, red and yellow lights, green lights.
    """
    poses = _gather_agents(states[..., :3], controlled)  # (E, n, 3)
    cameras = states[controlled.segment, controlled.agent, :3]  # (E, 3)
    layers, sizes = (_gather_agents(x, controlled) for x in (segments.layers, segments.sizes))
    seen = torch.arange(states.shape[1], device=states.device)
    seen = seen[None] if controlled.seen is None else controlled.seen
    visible = _gather_agents(segments.present[:, :, step], controlled)
    visible = visible & (seen != controlled.agent[:, None]) & (seen >= 0)  # (E, n)
    white = sizes.new_ones(3)
    boxes = [
        OrientedBoxes(poses, sizes, white, visible & (layers == layer), white)
        for layer in (VEHICLE, PEDESTRIAN)
    ]
    stop_lines = segments.stop_lines[controlled.segment]
    light_states = segments.light_states[controlled.segment, step]
    groups = [(RED, YELLOW), (GREEN,)]
    boxes += make_stop_line_layers(stop_lines, light_states, groups, width=view.light_width)
    if len(ground.regions) > 1:
        ground = ground.select(segments.places[controlled.segment])
    return render_layers(view, cameras, ground, boxes)


def _gather_agents(values: Shaped[Tensor, "B N ..."], controlled: Controlled) -> Tensor:
    """Values of the agents that each view may show."""
    if controlled.seen is None:
        return values[controlled.segment]
    return values[controlled.segment[:, None], controlled.seen.clamp_min(0)]


def compute_surface_contrast(views: Float[Tensor, "E 7 H W"]) -> Float[Tensor, "E 1 H W"]:
    """Compute the colour distance of each pixel from the ground under the agent, 0 to 1.

    Agents mostly stay on one surface, whatever its colour. Such a distance generalizes from few
    places; colours themselves need many.

    >>> views = torch.zeros(1, 7, 4, 4)
    >>> views[:, :3, 0] = 0.1  # a row that is a little brighter
    >>> compute_surface_contrast(views)[0, 0, :, 0].round(decimals=2)
    tensor([0.4300, 0.0000, 0.0000, 0.0000])
    """
    ground = views[:, :3]
    rows, columns = (slice((side - 1) // 2, side // 2 + 1) for side in ground.shape[2:])
    centre = ground[:, :, rows, columns].mean(dim=(2, 3), keepdim=True)  # (E, 3, 1, 1)
    squared = (ground - centre).square().sum(dim=1, keepdim=True)  # (E, 1, H, W)
    distance = (squared + 1e-8).sqrt() - 1e-4  # gradients stay finite where colours are equal
    return (distance / MAX_COLOUR_DISTANCE).clamp(max=1)
