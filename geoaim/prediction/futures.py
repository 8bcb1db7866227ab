"""Sampled futures of a scene, and how they are drawn on its map."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from torch import Tensor

from geoaim.base.displays import Display
from geoaim.base.errors import TracksError
from geoaim.base.world import World
from geoaim.prediction.sureness import describe_left_out
from geoaim.rendering.lines import LIGHT_COLOURS
from geoaim.rendering.scene import Scene
from geoaim.tracks.agent_types import get_colour
from geoaim.tracks.tracks import count_agents

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FUTURE_COLOUR, TRUTH_COLOUR = (1.0, 0.45, 0.0), (0.95, 0.95, 0.95)
MAX_LISTED = 8  # agents that an error lists
MARGIN_M = 15.0  # distance from the paths to the edges of a picture
LIGHT_NAMES = ("green light", "yellow light", "red light")  # names by light state


@dataclass(frozen=True, eq=False, repr=False)
class Futures(Display):
    """K sampled joint futures of the N agents of a scene over T steps.

    Attributes:
        states: (K, N, T, 4) x, y (metres in the scene's world), heading, speed; NaN where absent.
        scene: map, agents and lights.
        start: index of the scene's last observed step.
        dt: time between steps, s.
        predicted: agents that the model moves; None: those whose samples differ.
        left_out: agents of the model's kind that are there at `start` and that it does not move:
            why not, by id.
    """

    states: Float[Tensor, "K N T 4"]
    scene: Scene
    start: int
    dt: float
    predicted: Bool[Tensor, "N"] | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def world(self) -> World | None:
        """The plane of the metres: the scene's."""
        return self.scene.world

    @property
    def time(self) -> float:
        """Time of the last observed step, s."""
        return float(self.scene.times[self.start])

    def select(self, ids: Sequence[str]) -> "Futures":
        """Keep the futures of some agents; those of all others are NaN.

        Raises:
            TracksError: one of them is not predicted.
        """
        able = [self.scene.ids[row] for row in self.mark_predicted().nonzero()[:, 0].tolist()]
        missing = sorted(set(ids) - set(able))
        if missing:
            listed = ", ".join(able[:MAX_LISTED]) + (", ..." if len(able) > MAX_LISTED else "")
            raise TracksError(
                f"no future of {', '.join(missing)} at {self.time:g} s; there are those of {listed}"
            )
        kept = torch.tensor([name in ids for name in self.scene.ids], device=self.states.device)
        return replace(self, states=torch.where(kept[:, None, None], self.states, torch.nan))

    def mark_predicted(self) -> Bool[Tensor, "N"]:
        """Mark agents that the model moves and that are there, also those that it lets stand.

        Where these are not known, agents whose samples differ; of one sample, all.
        """
        positions = self.states[..., :2]
        known = torch.isfinite(positions).flatten(2).any(dim=2).any(dim=0)
        if self.predicted is not None:
            return known & self.predicted
        same = ((positions - positions[:1]).nan_to_num() == 0).flatten(2).all(dim=2).all(dim=0)
        return known if len(positions) == 1 else known & ~same

    def summarize(self) -> dict[str, str]:
        """Summarize the samples, the predicted time and agents, and why others are left out."""
        samples, _, steps, _ = self.states.shape
        types = self.scene.types
        chosen = [types[row] for row in self.mark_predicted().nonzero()[:, 0].tolist()]
        lines = {
            "samples": str(samples),
            "time": f"{steps * self.dt:g} s after {self.time:g} s, {steps} steps",
            "predicted": count_agents(chosen) if chosen else "no agent",
        }
        return lines | ({"left out": describe_left_out(self.left_out)} if self.left_out else {})

    def fit_limits(self) -> Float[Tensor, "2 2"]:
        """Lowest and highest x and y of a picture with all futures, as far as the map reaches."""
        scene = self.scene
        positions = torch.cat([self.states[..., :2].flatten(0, 2), scene.poses[:, self.start, :2]])
        positions = positions[torch.isfinite(positions).all(dim=1)]
        first, last = scene.ground.bounds[0].to(positions)
        low = (positions.amin(dim=0) - MARGIN_M).clamp(first, last - MARGIN_M)
        high = (positions.amax(dim=0) + MARGIN_M).clamp(low + MARGIN_M, last)
        return torch.stack([low, high])

    def _draw(self, axes: "Axes") -> None:
        from geoaim.base.labels import label_points
        from geoaim.base.map_axes import move_to_axes

        self.scene.draw_ground(axes, self.fit_limits().double().numpy())
        self.draw_step(axes, None)
        seconds = self.states.shape[2] * self.dt
        axes.set_title(f"{len(self.states)} futures of {seconds:g} s after {self.time:g} s")
        axes.set_aspect("equal")
        part: Any = axes.figure
        part.figure.draw_without_rendering()  # names are placed in the final layout
        rows = self.mark_predicted().nonzero()[:, 0].tolist()
        places = self.scene.poses[rows, self.start, :2].double().cpu().numpy()
        places = move_to_axes(axes, places, self.world)
        for text in label_points(axes, places, [self.scene.ids[row] for row in rows]):
            text.set(fontsize=7, clip_on=True)

    def draw_step(self, axes: "Axes", step: int | None) -> None:
        """Draw agents and lights without the map; paths are those of predicted agents.

        Args:
            axes: axes in metres of the map's world.
            step: step of the futures up to which paths are drawn; None: agents at the start, whole
                paths, and in white what was recorded.
        """
        from geoaim.base.map_axes import draw_lines, move_to_axes

        rows, end = self.mark_predicted().cpu(), self.states.shape[2] if step is None else step + 1
        now, states = self.scene.poses[:, self.start].cpu(), self.states.cpu()
        if step is None:
            recorded = self.scene.poses[:, self.start : self.start + 1 + end].cpu()
            lines = move_to_axes(axes, recorded[rows][..., :2].numpy(), self.world)
            draw_lines(axes, lines, TRUTH_COLOUR, width=3.0, label="recorded", outlined=True)
        first = now[None, rows, None, :2].expand(len(states), -1, -1, -1)
        paths = torch.cat([first, states[:, rows, :end, :2]], dim=2).flatten(0, 1)
        lines = move_to_axes(axes, paths.numpy(), self.world)
        draw_lines(axes, lines, FUTURE_COLOUR, label=f"{len(states)} futures")
        self._draw_lights(axes)
        for poses in [now] if step is None else states[:, :, step, :3]:
            self._draw_boxes(axes, poses.double().numpy())
        limits = move_to_axes(axes, self.fit_limits().double().numpy(), self.world)
        (left, bottom), (right, top) = limits.tolist()
        axes.set(xlim=(left, right), ylim=(bottom, top))

    def _draw_lights(self, axes: "Axes") -> None:
        from geoaim.base.map_axes import draw_lines, move_to_axes

        states = self.scene.light_states[self.start].cpu().numpy()
        for state, name in enumerate(LIGHT_NAMES):
            lines = move_to_axes(axes, self.scene.stop_lines.cpu().numpy(), self.world)
            lines = lines[states == state]
            if len(lines):
                draw_lines(axes, lines, LIGHT_COLOURS[state], width=3.5, label=name)

    def _draw_boxes(self, axes: "Axes", poses: Float[Array, "N 3"]) -> None:
        """Draw the agents at x, y and heading, with one entry in the legend for each type."""
        from matplotlib.collections import PolyCollection

        from geoaim.base.map_axes import move_to_axes

        unit = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        sizes, named = self.scene.sizes.cpu().numpy(), axes.get_legend_handles_labels()[1]
        for kind in dict.fromkeys(self.scene.types):
            rows = [row for row, other in enumerate(self.scene.types) if other == kind]
            rows = [row for row in rows if np.isfinite(poses[row]).all()]
            cosine, sine = np.cos(poses[rows, 2]), np.sin(poses[rows, 2])
            axis = np.stack([cosine, sine, -sine, cosine], axis=1).reshape(-1, 2, 2)
            boxes = poses[rows, None, :2] + (unit * sizes[rows, None]) @ axis
            moved = move_to_axes(axes, boxes, self.world)
            drawn = PolyCollection(list(moved), facecolor=get_colour(kind), zorder=3)
            drawn.set(edgecolor="white", linewidth=0.4)
            if rows and kind not in named:
                drawn.set_label(kind)
            axes.add_collection(drawn)
