"""Segments as items of `torch.utils.data.DataLoader`, to train somebody's own network on."""

from dataclasses import dataclass

import torch
from torch import Tensor

from geoaim.prediction.observation import Controlled, ObservationView, render_observation
from geoaim.prediction.segments import Segments, pick
from geoaim.rendering.ground import Ground
from geoaim.simulation.kinematics import agent_from_world, wrap_angle


@dataclass(frozen=True, eq=False)
class SegmentItems:
    """Items of segments: states in the frame of one agent, and its rendered view.

    The agent, the ego, is the first controlled one that is there at the last observed step. Its
    frame has the origin where it is then, and x forward.

        train = SegmentItems(dataset.train, dataset.ground, DEFAULT_CONFIGS["vehicle"].view)
        for batch in torch.utils.data.DataLoader(train, batch_size=32, shuffle=True):
            futures = network(batch["past"], batch["view"])

    Args:
        segments: the segments, such as `dataset.train` of `make_dataset`.
        ground: their maps, such as `dataset.ground`.
        view: size and resolution of the view.
        history: observed steps.
    """

    segments: Segments
    ground: Ground
    view: ObservationView
    history: int = 10

    def __len__(self) -> int:
        return len(self.segments)

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        """Make an item.

        Args:
            index: row of the segment.

        Returns:
            "past" (N, history, 4) and "future" (N, T - history, 4): x, y, heading, speed in the
            ego's frame, 0 while absent; "present" (N, T); "sizes" (N, 2); "layers" (N,); "ego",
            its column; "pose" (4,) of the ego in the world; and "view" (7, H, W), as of
            `render_observation`.

        Raises:
            IndexError: there is no such segment.
            ValueError: no controlled agent is there at the last observed step.
        """
        if not -len(self) <= index < len(self):
            raise IndexError(f"index {index} of {len(self)} segments")
        index %= len(self)
        one, last = pick(self.segments, slice(index, index + 1)), self.history - 1
        there = (one.controlled & one.present[:, :, last])[0]
        if not there.any():
            raise ValueError(f"segment {index}: no controlled agent is there at step {last}")
        ego = there.int().argmax()
        pose = one.states[0, ego, last]
        position = agent_from_world(pose, one.states[0, ..., :2])
        heading = wrap_angle(one.states[0, ..., 2] - pose[2])
        local = torch.cat([position, heading[..., None], one.states[0, ..., 3:]], dim=-1)
        local = torch.where(one.present[0, ..., None], local, 0.0)
        shown = Controlled(torch.zeros_like(ego)[None], ego[None])
        given = self.view, self.ground, one, shown, one.states[:, :, last], last
        return {
            "past": local[:, : self.history],
            "future": local[:, self.history :],
            "present": one.present[0],
            "sizes": one.sizes[0],
            "layers": one.layers[0],
            "ego": ego,
            "pose": pose,
            "view": render_observation(*given)[0],
        }
