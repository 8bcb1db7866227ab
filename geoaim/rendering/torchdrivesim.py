"""Image maps for torchdrivesim: its renderer interface, drawn by `geoaim.rendering.render`.

    from geoaim.rendering.torchdrivesim import ImageMapRenderer
    renderer = ImageMapRenderer(scene.ground, batch_size=1)
    simulator = torchdrivesim.simulator.Simulator(..., renderer=renderer)

Tested with torchdrivesim 0.2.3, which has to be installed beside geoaim.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torchdrivesim.rendering.base import BirdviewRenderer, RendererConfig
from torchdrivesim.utils import Resolution

from geoaim.rendering.birdview import render
from geoaim.rendering.boxes import OrientedBoxes
from geoaim.rendering.ground import Ground, View
from geoaim.rendering.prefiltering import prefilter_ground


class ImageMapRenderer(BirdviewRenderer):  # type: ignore[misc]
    """Renders an image map for torchdrivesim, differentiable by poses and cameras."""

    def __init__(self, ground: Ground, cfg: RendererConfig | None = None, **base: Any) -> None:
        super().__init__(cfg or RendererConfig(), **{"device": ground.image.device, **base})
        self.ground = ground
        self.prefiltered: dict[float, Ground] = {}  # keys: the resolutions

    def render_frame(  # noqa: PLR0913  (another program's interface)
        self,
        agent_state: dict[str, Tensor],
        agent_attributes: dict[str, Tensor],
        camera_xy: Tensor | None = None,
        camera_sc: Tensor | None = None,
        rendering_mask: dict[str, Tensor] | None = None,
        res: Resolution | None = None,
        traffic_controls: Mapping[str, Any] | None = None,
        fov: float | None = None,
        waypoints: Tensor | None = None,
        waypoints_rendering_mask: Tensor | None = None,
    ) -> Tensor:
        """Render agents, traffic controls and waypoints; see torchdrivesim for the arguments."""
        egocentric = camera_xy is None and camera_sc is None
        poses = torch.cat([state[..., :3] for state in agent_state.values()], dim=-2)
        cameras = poses if egocentric else _make_cameras(camera_xy, camera_sc)
        layers = dict(self._make_agents(agent_state, agent_attributes, rendering_mask, cameras))
        if traffic_controls is not None:
            layers |= dict(self._make_controls(traffic_controls, cameras))
        if waypoints is not None:
            layers["goal_waypoint"] = self._make_waypoints(waypoints, waypoints_rendering_mask)
        levels = self.rendering_levels
        shown = [name for name in layers if levels[name] >= 0]
        boxes = [layers[name] for name in sorted(shown, key=lambda name: -levels[name])]
        pictures = self._render(cameras.flatten(0, 1), boxes, res, fov)
        return pictures.view(*cameras.shape[:2], *pictures.shape[1:]) if egocentric else pictures

    def render_static_meshes(
        self,
        camera_xy: Tensor | None = None,
        camera_sc: Tensor | None = None,
        res: Resolution | None = None,
        fov: float | None = None,
    ) -> Tensor:
        """Render the map alone."""
        if camera_xy is None and camera_sc is None:
            one = torch.ones_like(self.world_center[..., 0])
            camera_xy, camera_sc = self.world_center, torch.stack([one, torch.zeros_like(one)], -1)
        cameras = _make_cameras(camera_xy, camera_sc).reshape(-1, 3)
        return self._render(cameras, [], res, fov).permute(0, 2, 3, 1)

    def render_mesh(self, mesh: Any, res: Resolution, cameras: Any) -> Tensor:
        """Raise ValueError: the map is an image and has no meshes."""
        raise ValueError("an image map draws no meshes; use render_frame or render_static_meshes")

    def add_static_meshes(self, meshes: list[Any]) -> None:
        """Raise ValueError: the map is an image and has no meshes."""
        raise ValueError("an image map draws no meshes; paint them into its image")

    def to(self, device: torch.device) -> "ImageMapRenderer":
        """Move the renderer to another device in place."""
        super().to(device)
        self.ground, self.prefiltered = self.ground.to(device), {}
        return self

    def expand(self, n: int) -> "ImageMapRenderer":
        """Make a renderer that repeats each batch element `n` times."""
        return self._copy(self.world_center.repeat_interleave(n, dim=0))

    def select_batch_elements(self, idx: Tensor) -> "ImageMapRenderer":
        """Make a renderer of some elements of the batch."""
        return self._copy(self.world_center[idx])

    def _copy(self, centres: Tensor) -> "ImageMapRenderer":
        return ImageMapRenderer(
            self.ground,
            self.cfg,
            batch_size=len(centres),
            world_center=centres,
            color_map=dict(self.color_map),
            rendering_levels=dict(self.rendering_levels),
            res=self.res,
            fov=2.0 / self.scale,
        )

    def _render(
        self,
        cameras: Float[Tensor, "V 3"],
        layers: list[OrientedBoxes],
        res: Resolution | None,
        fov: float | None,
    ) -> Float[Tensor, "V 3 H W"]:
        size = res or self.res
        view = View(size.height, size.width, (fov or 2.0 / self.scale) / min(size))
        if view.resolution not in self.prefiltered or self.ground.image.requires_grad:
            self.prefiltered = {view.resolution: prefilter_ground(self.ground, view.resolution)}
        pictures = 255 * render(view, cameras, self.prefiltered[view.resolution], layers)
        return pictures.flip(-1) if self.cfg.left_handed_coordinates else pictures

    def _make_agents(
        self,
        states: dict[str, Tensor],
        sizes: dict[str, Tensor],
        masks: dict[str, Tensor] | None,
        cameras: Tensor,
    ) -> Iterator[tuple[str, OrientedBoxes]]:
        """Make a layer of boxes of each agent type, and one of the ego if it is highlighted."""
        views = cameras.shape[1]
        for name, state in states.items():
            parts = [(name, slice(None))]
            if name == "vehicle" and self.cfg.highlight_ego_vehicle:
                parts = [("ego", slice(0, 1)), (name, slice(1, None))]
            for colour, part in parts:
                count = state[:, part].shape[1]
                mask = None if masks is None else masks[name][:, :, part].flatten(0, 1).bool()
                triangles = None
                if self.cfg.render_agent_direction and self.rendering_levels["direction"] >= 0:
                    triangles = self._get_colours(["direction"]).expand(count, 3)
                poses = state[:, part, :3].repeat_interleave(views, dim=0)
                part_sizes = sizes[name][:, part, :2].repeat_interleave(views, dim=0)
                colours = self._get_colours([colour]).expand(count, 3)
                yield colour, OrientedBoxes(poses, part_sizes, colours, mask, triangles)

    def _make_controls(
        self, controls: Mapping[str, Any], cameras: Tensor
    ) -> Iterator[tuple[str, OrientedBoxes]]:
        """Make a layer of boxes of each kind of traffic control; lights have colours of states."""
        views = cameras.shape[1]
        for name, control in controls.items():
            lights = name == "traffic_light"
            names = [f"{name}_{state}" for state in control.allowed_states] if lights else [name]
            box, state, mask = (
                value.repeat_interleave(views, dim=0)
                for value in (control.pos, control.state, control.mask)
            )
            colours = self._get_colours(names)[state if lights else torch.zeros_like(state)]
            yield names[0], OrientedBoxes(box[..., [0, 1, 4]], box[..., 2:4], colours, mask)

    def _make_waypoints(self, waypoints: Tensor, mask: Tensor | None) -> OrientedBoxes:
        points = waypoints.flatten(0, 1)[..., :2]
        poses = torch.cat([points, torch.zeros_like(points[..., :1])], dim=-1)
        count = points.shape[1]
        present = None if mask is None else mask.flatten(0, 1).bool()
        # a square as large as torchdrivesim's disc
        sizes = points.new_full((count, 2), 2.0 * math.sqrt(math.pi))
        colours = self._get_colours(["goal_waypoint"]).expand(count, 3)
        return OrientedBoxes(poses, sizes, colours, present)

    def _get_colours(self, names: list[str]) -> Float[Tensor, "n 3"]:
        table = [self.color_map[name] for name in names]
        return self.ground.image.new_tensor(table) / 255


def _make_cameras(xy: Tensor | None, sine_cosine: Tensor | None) -> Float[Tensor, "... 3"]:
    """Join positions and headings, which torchdrivesim gives by sine and cosine."""
    if xy is None or sine_cosine is None:
        raise ValueError("camera_xy and camera_sc go together; one of them is None")
    heading = torch.atan2(sine_cosine[..., 0], sine_cosine[..., 1])
    return torch.cat([xy, heading[..., None]], dim=-1)
