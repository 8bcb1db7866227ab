"""Straight lines as boxes that the renderer paints: lights at stop lines, trails, routes."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.simulation.birdview import Boxes

LIGHTS = ((0.1, 0.8, 0.2), (1.0, 0.8, 0.0), (0.9, 0.1, 0.1))  # green, yellow, red
BAR = 1.0  # m that a light's bar is wide, on its stop line


def line_boxes(
    ends: Float[Tensor, "B N 2 2"],
    colours: Float[Tensor, "... N C"],
    *,
    width: float,
    present: Bool[Tensor, "B N"] | None = None,
) -> Boxes:
    """Lines so many metres wide from end to end; those without length are absent.

    >>> ends = torch.tensor([[[[0.0, 0.0], [3.0, 4.0]]]])
    >>> line_boxes(ends, torch.ones(1, 3), width=0.5).sizes
    tensor([[[5.0000, 0.5000]]])
    """
    start, end = ends.unbind(-2)
    long = (end - start).square().sum(dim=-1) != 0
    present = long if present is None else present & long
    along = torch.where(present[..., None], end - start, torch.ones_like(start))
    heading = torch.atan2(along[..., 1], along[..., 0])
    poses = torch.cat([(start + end) / 2, heading[..., None]], dim=-1)
    length = along.norm(dim=-1)
    sizes = torch.stack([length, torch.full_like(length, width)], dim=-1)
    return Boxes(poses, sizes, colours, present)


def path_boxes(
    points: Float[Tensor, "B N S 2"],
    colours: Float[Tensor, "N C"],
    *,
    width: float,
    present: Bool[Tensor, "B N S"] | None = None,
) -> Boxes:
    """Paths through points, line by line; a line is there where both of its points are."""
    start, end = points[:, :, :-1], points[:, :, 1:]
    if present is not None:
        present = (present[:, :, :-1] & present[:, :, 1:]).flatten(1)
    ends = torch.stack([start, end], dim=-2).flatten(1, 2)
    every = colours.repeat_interleave(start.shape[2], dim=0)
    lines = line_boxes(ends, every, width=width, present=present)
    longer = lines.sizes + lines.sizes.new_tensor([width, 0.0])  # no gap at bends
    return replace(lines, sizes=longer)


def light_layers(
    lines: Float[Tensor, "... L 2 2"],
    states: Int[Tensor, "B L"],
    groups: Sequence[tuple[int, ...]],
    *,
    width: float = BAR,
) -> list[Boxes]:
    """For `render_layers`: the bars of `light_boxes`, a layer for each group of states."""
    bars = light_boxes(lines, states, width=width)
    assert bars.present is not None
    return [
        replace(bars, present=bars.present & torch.isin(states, states.new_tensor(group)))
        for group in groups
    ]


def light_boxes(
    lines: Float[Tensor, "... L 2 2"], states: Int[Tensor, "B L"], *, width: float = BAR
) -> Boxes:
    """A bar on each stop line in the colour of its light; none where the state is not known, -1.

    Lines are the same in all views, or each view's own.
    """
    colours = lines.new_tensor(LIGHTS)[states.long().clamp_min(0)]
    ends = lines.expand(len(states), *lines.shape[-3:])
    return line_boxes(ends, colours, width=width, present=states >= 0)
