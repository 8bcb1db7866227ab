"""Leave out agents that a view cannot show, for speed; `Config.view_size` says what it shows."""

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from geoaim.prediction.observation import Controlled
from geoaim.prediction.segments import Segments
from geoaim.rendering.ground import View

MAX_VIEWS = 4000  # views that are rendered at once
MAX_BOXES = 500_000  # boxes of all agents in these views
MAX_DISTINCT_VIEWS = 500  # views that are rendered at once where each shows other agents
MARGIN_M = 1.0  # tolerance for rounding errors


def split_views(
    view: View,
    segments: Segments,
    controlled: Controlled,
    states: Float[Tensor, "B N 4"],
    step: int,
) -> Iterator[Controlled]:
    """Split controlled agents into parts whose views can be rendered at once.

    Args:
        view: size and resolution.
        segments: sizes and presence of all agents.
        controlled: the agents whose views to render.
        states: (B, N, 4) x, y, heading, speed of all agents at the step.
        step: index of the step.

    Yields:
        Parts in order; where there are many agents, each part lists the agents that its views may
        show.
    """
    count = states.shape[1]
    if count * min(len(controlled.agent), MAX_VIEWS) <= MAX_BOXES:
        parts = (torch.split(index, MAX_VIEWS) for index in (controlled.segment, controlled.agent))
        yield from (Controlled(*part) for part in zip(*parts, strict=True))
        return
    segment, agent = segments.present[:, :, step].cpu().nonzero().unbind(1)
    largest = float(segments.sizes.norm(dim=2).max())
    reach = (np.hypot(view.height, view.width) * view.resolution + largest) / 2 + MARGIN_M
    positions = _stack_segments(states, reach)
    tree = KDTree(positions[segment, agent])
    cameras = positions[controlled.segment.cpu(), controlled.agent.cpu()]
    most = tree.query_ball_point(cameras, reach, return_length=True).max()
    rows = max(1, min(MAX_DISTINCT_VIEWS, MAX_BOXES // max(1, most)))
    for start in range(0, len(cameras), rows):
        some = slice(start, start + rows)
        found = tree.query_ball_point(cameras[some], reach, return_sorted=True)
        lists = [agent[torch.tensor(near, dtype=torch.long)] for near in found]
        seen = torch.nn.utils.rnn.pad_sequence(lists, batch_first=True, padding_value=-1)
        yield Controlled(controlled.segment[some], controlled.agent[some], seen.to(states.device))


def _stack_segments(states: Float[Tensor, "B N 4"], reach: float) -> Float[np.ndarray, "B N 3"]:
    """Positions, with a third axis on which segments are out of each other's reach."""
    height = 2 * reach * np.arange(len(states))[:, None, None]
    positions = states[..., :2].detach().cpu().double().numpy()
    return np.concatenate([positions, np.broadcast_to(height, (*positions.shape[:2], 1))], axis=2)
