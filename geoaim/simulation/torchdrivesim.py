"""Image maps for torchdrivesim: its renderer interface, drawn by `geoaim.simulation.render`.

    from geoaim.simulation.torchdrivesim import ImageMapRenderer
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

from geoaim.simulation.birdview import OrientedBoxes, render
from geoaim.simulation.ground import Ground, View, move_ground, prefilter_ground

WAYPOINT = 2.0 * math.sqrt(math.pi)  # m: side of the square as large as torchdrivesim's disc


class ImageMapRenderer(BirdviewRenderer):  # type: ignore[misc]
    """A renderer of torchdrivesim over one image map, with gradients by poses and cameras.

    Args:
        ground: the map, in the simulator's coordinates, with three channels from 0 to 1.
        cfg: torchdrivesim's own configuration; the direction's triangle, the ego's colour and
            left-handed coordinates are heeded.
        more: what `BirdviewRenderer` takes besides: batch_size, res, fov, color_map, ...

    Raises:
        ValueError: for meshes to be drawn; the map is an image.
    """

    def __init__(self, ground: Ground, cfg: RendererConfig | None = None, **more: Any) -> None:
        super().__init__(cfg or RendererConfig(), **{"device": ground.image.device, **more})
        self.ground = ground
        self.fitted: dict[float, Ground] = {}  # by resolution

    def render_frame(
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
        """As torchdrivesim documents it: colours from 0 to 255, one camera an agent by default."""
        _check_cameras(camera_xy, camera_sc)
        egocentric = camera_xy is None
        if camera_xy is None or camera_sc is None:
            poses = torch.cat([state[..., :3] for state in agent_state.values()], dim=-2)
            camera_xy, turn = poses[..., :2], poses[..., 2]
        else:
            turn = torch.atan2(camera_sc[..., 0], camera_sc[..., 1])
        cameras = torch.cat([camera_xy, turn[..., None]], dim=-1)
        layers = dict(self._agents(agent_state, agent_attributes, rendering_mask, cameras))
        if traffic_controls is not None:
            layers |= dict(self._controls(traffic_controls, cameras))
        if waypoints is not None:
            layers["goal_waypoint"] = self._waypoints(waypoints, waypoints_rendering_mask)
        levels = self.rendering_levels
        shown = [name for name in layers if levels[name] >= 0]
        order = sorted(shown, key=lambda name: -levels[name])
        pictures = self._pictures(cameras.flatten(0, 1), [layers[n] for n in order], res, fov)
        return pictures.view(*cameras.shape[:2], *pictures.shape[1:]) if egocentric else pictures

    def render_static_meshes(
        self,
        camera_xy: Tensor | None = None,
        camera_sc: Tensor | None = None,
        res: Resolution | None = None,
        fov: float | None = None,
    ) -> Tensor:
        """The map alone, (Nc, H, W, C); north up around the world's centre by default."""
        _check_cameras(camera_xy, camera_sc)
        if camera_xy is None or camera_sc is None:
            camera_xy = self.world_center
            turn = torch.full_like(camera_xy[..., 0], math.pi / 2)
        else:
            turn = torch.atan2(camera_sc[..., 0], camera_sc[..., 1])
        cameras = torch.cat([camera_xy, turn[..., None]], dim=-1).reshape(-1, 3)
        return self._pictures(cameras, [], res, fov).permute(0, 2, 3, 1)

    def render_mesh(self, mesh: Any, res: Resolution, cameras: Any) -> Tensor:
        """Refused: there is no mesh in an image map."""
        raise ValueError("an image map draws no meshes; use render_frame or render_static_meshes")

    def add_static_meshes(self, meshes: list[Any]) -> None:
        """Refused: there is no mesh in an image map."""
        raise ValueError("an image map draws no meshes; paint them into its image")

    def to(self, device: torch.device) -> "ImageMapRenderer":
        """Move the renderer to another device in place."""
        super().to(device)
        self.ground, self.fitted = move_ground(self.ground, device), {}
        return self

    def expand(self, n: int) -> "ImageMapRenderer":
        """A renderer for so many times the batch."""
        return self._of_centres(self.world_center.repeat_interleave(n, dim=0))

    def select_batch_elements(self, idx: Tensor) -> "ImageMapRenderer":
        """A renderer for some of the batch."""
        return self._of_centres(self.world_center[idx])

    def _of_centres(self, centres: Tensor) -> "ImageMapRenderer":
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

    def _pictures(
        self,
        cameras: Tensor,
        layers: list[OrientedBoxes],
        res: Resolution | None,
        fov: float | None,
    ) -> Float[Tensor, "V 3 H W"]:
        size = res or self.res
        view = View(size.height, size.width, (fov or 2.0 / self.scale) / min(size))
        if view.resolution not in self.fitted or self.ground.image.requires_grad:
            self.fitted = {view.resolution: prefilter_ground(self.ground, view.resolution)}
        pictures = 255 * render(view, cameras, self.fitted[view.resolution], layers)
        return pictures.flip(-1) if self.cfg.left_handed_coordinates else pictures

    def _agents(
        self,
        states: dict[str, Tensor],
        sizes: dict[str, Tensor],
        masks: dict[str, Tensor] | None,
        cameras: Tensor,
    ) -> Iterator[tuple[str, OrientedBoxes]]:
        for name, state in states.items():
            whole = slice(None)
            parts = [(name, whole)]
            if name == "vehicle" and self.cfg.highlight_ego_vehicle:
                parts = [("ego", slice(0, 1)), (name, slice(1, None))]
            for kind, some in parts:
                mask = None if masks is None else masks[name][:, :, some].flatten(0, 1).bool()
                noses = None
                if self.cfg.render_agent_direction and self.rendering_levels["direction"] >= 0:
                    noses = self._colours(["direction"]).expand(state[:, some].shape[1], 3)
                views = cameras.shape[1]
                yield (
                    kind,
                    OrientedBoxes(
                        state[:, some, :3].repeat_interleave(views, dim=0),
                        sizes[name][:, some, :2].repeat_interleave(views, dim=0),
                        self._colours([kind]).expand(state[:, some].shape[1], 3),
                        mask,
                        noses,
                    ),
                )

    def _controls(
        self, controls: Mapping[str, Any], cameras: Tensor
    ) -> Iterator[tuple[str, OrientedBoxes]]:
        views = cameras.shape[1]
        for name, control in controls.items():
            lights = name == "traffic_light"
            kinds = [f"{name}_{state}" for state in control.allowed_states] if lights else [name]
            where = control.pos.repeat_interleave(views, dim=0)
            state = control.state.repeat_interleave(views, dim=0)
            there = control.mask.repeat_interleave(views, dim=0)
            colours = self._colours(kinds)[state if lights else torch.zeros_like(state)]
            poses = where[..., [0, 1, 4]]
            yield kinds[0], OrientedBoxes(poses, where[..., 2:4], colours, there)

    def _waypoints(self, waypoints: Tensor, mask: Tensor | None) -> OrientedBoxes:
        points = waypoints.flatten(0, 1)[..., :2]
        poses = torch.cat([points, torch.zeros_like(points[..., :1])], dim=-1)
        count = points.shape[1]
        there = None if mask is None else mask.flatten(0, 1).bool()
        sizes = points.new_full((count, 2), WAYPOINT)
        return OrientedBoxes(poses, sizes, self._colours(["goal_waypoint"]).expand(count, 3), there)

    def _colours(self, names: list[str]) -> Float[Tensor, "n 3"]:
        table = [self.color_map[name] for name in names]
        return self.ground.image.new_tensor(table) / 255


def _check_cameras(xy: Tensor | None, sc: Tensor | None) -> None:
    if (xy is None) != (sc is None):
        raise ValueError("camera_xy and camera_sc go together; one of them is None")
