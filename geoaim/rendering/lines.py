"""Straight lines as boxes that the renderer paints: lights on stop lines, trails, paths."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.rendering.boxes import OrientedBoxes

LIGHT_COLOURS = ((0.1, 0.8, 0.2), (1.0, 0.8, 0.0), (0.9, 0.1, 0.1))  # green, yellow, red
LIGHT_BAR_WIDTH_M = 1.0  # width of the bar that shows a light on its stop line


def make_line_boxes(
    ends: Float[Tensor, "B N 2 2"],
    colours: Float[Tensor, "... C"],
    *,
    width: float,
    present: Bool[Tensor, "B N"] | None = None,
) -> OrientedBoxes:
    """Make boxes of lines; lines of length 0 are absent.

    Args:
        ends: (B, N, 2, 2) both ends of each line, metres.
        colours: (B, N, C), (N, C) or (C,) colours of the lines, 0 to 1.
        width: width of the lines, metres.
        present: (B, N) which lines exist; None: all do.

    Returns:
        (B, N) boxes, each as long as its line and centred on it.

    >>> ends = torch.tensor([[[[0.0, 0.0], [3.0, 4.0]]]])
    >>> make_line_boxes(ends, torch.ones(1, 3), width=0.5).sizes
    tensor([[[5.0000, 0.5000]]])
    """
    start, end = ends.unbind(-2)
    has_length = (end - start).square().sum(dim=-1) != 0
    present = has_length if present is None else present & has_length
    direction = torch.where(present[..., None], end - start, torch.ones_like(start))
    heading = torch.atan2(direction[..., 1], direction[..., 0])
    poses = torch.cat([(start + end) / 2, heading[..., None]], dim=-1)
    length = direction.norm(dim=-1)
    sizes = torch.stack([length, torch.full_like(length, width)], dim=-1)
    return OrientedBoxes(poses, sizes, colours, present)


def make_path_boxes(
    points: Float[Tensor, "B N S 2"],
    colours: Float[Tensor, "... C"],
    *,
    width: float,
    present: Bool[Tensor, "B N S"] | None = None,
) -> OrientedBoxes:
    """Make boxes of the segments of paths.

    Args:
        points: (B, N, S, 2) S points along each of N paths in B views, metres.
        colours: (B, N, C), (N, C) or (C,) colours of the paths, 0 to 1.
        width: width of the paths, metres.
        present: (B, N, S) which points exist; a segment needs both of its ends. None: all do.

    Returns:
        (B, N (S - 1)) boxes, one for each segment, longer by the width, so that bends have no gaps.
    """
    start, end = points[:, :, :-1], points[:, :, 1:]
    if present is not None:
        present = (present[:, :, :-1] & present[:, :, 1:]).flatten(1)
    ends = torch.stack([start, end], dim=-2).flatten(1, 2)
    if colours.ndim > 1:
        colours = colours.repeat_interleave(start.shape[2], dim=-2)
    lines = make_line_boxes(ends, colours, width=width, present=present)
    return replace(lines, sizes=lines.sizes + lines.sizes.new_tensor([width, 0.0]))


def make_stop_line_boxes(
    lines: Float[Tensor, "... L 2 2"],
    states: Int[Tensor, "B L"],
    *,
    width: float = LIGHT_BAR_WIDTH_M,
) -> OrientedBoxes:
    """Make a bar on each stop line in the colour of its light.

    Args:
        lines: (L, 2, 2) both ends of the lines, metres; or (B, L, 2, 2).
        states: (B, L) states in each of B views: 0 green, 1 yellow, 2 red; -1, unknown, has no bar.
        width: width of the bars, metres.

    Returns:
        (B, L) boxes, one for each line.
    """
    colours = lines.new_tensor(LIGHT_COLOURS)[states.long().clamp_min(0)]
    ends = lines.expand(len(states), *lines.shape[-3:])
    return make_line_boxes(ends, colours, width=width, present=states >= 0)


def make_stop_line_layers(
    lines: Float[Tensor, "... L 2 2"],
    states: Int[Tensor, "B L"],
    groups: Sequence[tuple[int, ...]],
    *,
    width: float = LIGHT_BAR_WIDTH_M,
) -> list[OrientedBoxes]:
    """Make a layer of stop lines (`make_stop_line_boxes`) for each group of light states."""
    bars = make_stop_line_boxes(lines, states, width=width)
    assert bars.present is not None
    return [
        replace(bars, present=bars.present & torch.isin(states, states.new_tensor(group)))
        for group in groups
    ]
